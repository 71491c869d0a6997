"""An emulated Lumio screen: its data and their times in each protocol, and faults on purpose.

Written from the layouts alone, sharing no code with the decoders.
"""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, ClassVar, NamedTuple

if TYPE_CHECKING:
    from twin.devices.lumio.config import Calibration


class Protocol(StrEnum):
    """Protocol of the screen."""

    MICROTOUCH = "microtouch"
    ELO = "elo"
    HID_0006 = "hid-0006"
    HID_0007 = "hid-0007"
    HID_TIMED = "hid-timed"


class Spot(NamedTuple):
    """A contact on the screen.

    Attributes:
        x: Along the screen's first axis, 0..1.
        y: Along its second axis, downwards, 0..1.
        id: Its number, from 1.
        down: Whether it touches; False in the frame of its lift-off.
    """

    x: float
    y: float
    id: int = 1
    down: bool = True


def microtouch(spots: Sequence[Spot]) -> list[bytes]:
    """Format Tablet of the first contact: 14 bit in two sevens, y counting upwards."""
    if not spots:
        return []
    x, y = _counts(spots[0].x, 16383), 16383 - _counts(spots[0].y, 16383)
    head = 0b1100_0000 if spots[0].down else 0b1000_0000
    return [bytes([head, x % 128, x // 128, y % 128, y // 128])]


def elo(spots: Sequence[Spot]) -> list[bytes]:
    """SmartSet of the first contact, as in a stream of touches."""
    if not spots:
        return []
    status = 2 if spots[0].down else 4
    x, y = _counts(spots[0].x, 4095), _counts(spots[0].y, 4095)
    body = bytes([0x55, 0x54, status, x % 256, x // 256, y % 256, y // 256, 0, 0])
    return [body + bytes([(sum(body) + 0xAA) % 256])]


def hid_0006(spots: Sequence[Spot]) -> list[bytes]:
    """Reports of four contacts each, the first telling how many there are."""
    reports = []
    for begin in range(0, len(spots), 4):
        blocks = b"".join(_status(s) + bytes([s.id]) + _pair(s) for s in spots[begin : begin + 4])
        number = len(spots) if begin == 0 else 0
        reports.append(blocks.ljust(24, b"\0") + bytes([number]))
    return reports


def hid_0007(spots: Sequence[Spot]) -> list[bytes]:
    """One report per contact."""
    return [_status(s) + b"\0" + _pair(s) + bytes([s.id, 0]) for s in spots]


def hid_timed(spots: Sequence[Spot], scan: int = 0) -> list[bytes]:
    """Reports of two contacts each, with the scan time in 100 us."""
    reports = []
    for begin in range(0, len(spots), 2):
        blocks = b"".join(
            bytes([spot.down, spot.id]) + _pair(spot) for spot in spots[begin : begin + 2]
        )
        number = len(spots) if begin == 0 else 0
        time = (scan % (1 << 16)).to_bytes(2, "little")
        reports.append(blocks.ljust(12, b"\0") + bytes([number]) + time)
    return reports


PACKET_ENCODERS: dict[Protocol, Callable[[Sequence[Spot]], list[bytes]]] = {
    Protocol.MICROTOUCH: microtouch,
    Protocol.ELO: elo,
    Protocol.HID_0006: hid_0006,
    Protocol.HID_0007: hid_0007,
    Protocol.HID_TIMED: hid_timed,
}
"""The packets of a frame, by protocol."""


def beyond(packet: bytes, protocol: Protocol) -> bytes:
    """The packet with its first coordinate beyond the range; Format Tablet's names the far corner.

    It cannot say more.
    """
    changed = bytearray(packet)
    if protocol is Protocol.ELO:
        changed[3:5] = b"\xff\x7f"
        changed[9] = (sum(changed[:9]) + 0xAA) % 256
    elif protocol is Protocol.MICROTOUCH:
        changed[1:] = b"\x7f\x7f\x7f\x7f"
    else:
        changed[2:4] = b"\xf8\xff"
    return bytes(changed)


def _counts(share: float, top: int) -> int:
    """Whole counts of a range 0..top on the native grid of 4096 x 4096."""
    cell = min(4095, max(0, round(share * 4095)))
    return round(cell * top / 4095)


def _status(spot: Spot) -> bytes:
    return b"\x31" if spot.down else b"\x30"


def _pair(spot: Spot) -> bytes:
    # On USB the native grid appears as multiples of 8, up to 32760 of 32767.
    return b"".join((_counts(v, 4095) * 8).to_bytes(2, "little") for v in (spot.x, spot.y))


class ScreenFault(StrEnum):
    """Faults that can be injected, for a time.

    Bytes: TRUNCATE cuts packets short; SPLIT sends them in two parts 3 ms apart; MERGE sends two
    at once; GARBLE flips a bit of each; NOISE sends random bytes between packets; CHECKSUM
    falsifies the last byte; FLOOD fills the line with random bytes; OUT_OF_RANGE names a place
    beyond the screen (Format Tablet has no such value: it names the far corner).

    Contacts: PEN_UP lifts the ball off; MISSING_PEN_UP takes it away without saying so; DROPOUT
    does the same for a moment; TWO_CONTACTS adds a finger, which a protocol of one contact reports
    in turn with the ball (assumed); SWAP_AXES exchanges x and y; FREEZE repeats the last place;
    JUMP puts the ball elsewhere in one frame only; DRIFT lets places walk away along x.

    Times: LATER lets every frame arrive later than the one before; REPEAT sends the last frame
    again and again, its scan time included; TIME_STILL lets the scan time alone stand still.
    """

    TRUNCATE = "truncate"
    SPLIT = "split"
    MERGE = "merge"
    GARBLE = "garble"
    NOISE = "noise"
    CHECKSUM = "checksum"
    FLOOD = "flood"
    OUT_OF_RANGE = "out of range"
    PEN_UP = "pen-up"
    MISSING_PEN_UP = "missing pen-up"
    DROPOUT = "dropout"
    TWO_CONTACTS = "two contacts"
    SWAP_AXES = "swap axes"
    FREEZE = "freeze"
    JUMP = "jump"
    DRIFT = "drift"
    LATER = "later"
    REPEAT = "repeat"
    TIME_STILL = "time still"


class Damage:
    """Applies the faults in force to contacts and to packets.

    Args:
        protocol: What the packets are of.
        seed: Of everything random.
    """

    FINGER = Spot(0.9, 0.9, 2)
    """Where the second contact is."""
    DRIFT = 0.3
    """Share of the screen's first axis per second by which places walk away: 0.21 m/s."""
    LATER = 0.2
    """Seconds per second by which the dead time grows."""

    def __init__(self, protocol: Protocol, seed: int) -> None:
        self._protocol = protocol
        self._random = random.Random(seed)
        self._until: dict[ScreenFault, float] = {}
        self._begun: dict[ScreenFault, float] = {}
        """When each of those that are or were in force was first asked for, s."""
        self._last: tuple[Spot, ...] = ()
        self._kept = b""
        self._turn = False
        self._bytes: dict[ScreenFault, Callable[[bytes], bytes]] = {
            ScreenFault.TRUNCATE: lambda packet: packet[: self._random.randrange(1, len(packet))],
            ScreenFault.GARBLE: self._garble,
            ScreenFault.CHECKSUM: lambda packet: packet[:-1] + bytes([packet[-1] ^ 0x5A]),
            ScreenFault.OUT_OF_RANGE: lambda packet: beyond(packet, self._protocol),
            ScreenFault.NOISE: lambda packet: self.noise(self._random.randrange(1, 4)) + packet,
        }

    def inject(self, fault: ScreenFault, until: float) -> None:
        """Put a fault in force until a time in s."""
        self._until[fault] = until

    def clear(self) -> None:
        """End all of it."""
        self._until.clear()
        self._begun.clear()
        self._last, self._kept = (), b""

    def active(self, time: float, *faults: ScreenFault) -> bool:
        """Whether a fault, or one of several, is in force at a time in s."""
        return any(time < self._until.get(fault, -1.0) for fault in faults)

    def lasting(self, time: float, fault: ScreenFault) -> float:
        """Since how many s a fault has been in force at a time in s; 0 where it is not."""
        if not self.active(time, fault):
            return 0.0
        return time - self._begun.setdefault(fault, time)

    def noise(self, count: int) -> bytes:
        """Random bytes."""
        return self._random.randbytes(count)

    def contacts(self, time: float, spots: Sequence[Spot]) -> tuple[Spot, ...]:
        """What the screen believes to touch it."""
        seen = tuple(spots)
        if self.active(time, ScreenFault.FREEZE):
            seen = self._last
        self._last = seen
        if self._until.pop(ScreenFault.JUMP, -1.0) > time and seen:
            ball = seen[0]
            seen = (ball._replace(x=(ball.x + 0.45) % 1, y=(ball.y + 0.45) % 1), *seen[1:])
        way = self.DRIFT * self.lasting(time, ScreenFault.DRIFT)
        seen = tuple(spot._replace(x=spot.x + way) for spot in seen)
        if self.active(time, ScreenFault.SWAP_AXES):
            seen = tuple(spot._replace(x=spot.y, y=spot.x) for spot in seen)
        if self.active(time, ScreenFault.PEN_UP) or self.hides_lift(time):
            seen = ()
        if self.active(time, ScreenFault.TWO_CONTACTS):
            if self._protocol in {Protocol.MICROTOUCH, Protocol.ELO}:
                self._turn = not self._turn
                return (self.FINGER._replace(id=1),) if self._turn else seen
            seen = (*seen, self.FINGER)
        return seen

    def hides_lift(self, time: float) -> bool:
        """Whether a lift-off goes unreported."""
        return self.active(time, ScreenFault.MISSING_PEN_UP, ScreenFault.DROPOUT)

    def packet(self, time: float, packet: bytes) -> list[bytes]:
        """Bytes that are sent for a packet: none, itself, or parts some time apart."""
        for fault, change in self._bytes.items():
            if self.active(time, fault):
                packet = change(packet)
        if self.active(time, ScreenFault.MERGE) and not self._kept:
            self._kept = packet
            return []
        packet, self._kept = self._kept + packet, b""
        if self.active(time, ScreenFault.SPLIT) and len(packet) > 1:
            cut = self._random.randrange(1, len(packet))
            return [packet[:cut], packet[cut:]]
        return [packet]

    def _garble(self, packet: bytes) -> bytes:
        changed = bytearray(packet)
        changed[self._random.randrange(len(packet))] ^= 1 << self._random.randrange(8)
        return bytes(changed)


FRAME_INTERVAL_S = 0.01736
"""Seconds between frames, as recorded from a screen of product 202E:0006."""
SCREEN_DEAD_TIME_S = 0.042
"""Seconds from a touch to its arrival, as the thesis measured."""
SCAN_TICK = 1e-4
"""Seconds of one count of a scan time."""
SPLIT_GAP = 0.003
"""Seconds between the parts of a packet that is split on purpose."""

Ball = Callable[[], Sequence[tuple[float, float]]]
"""Where the screen is touched now, m in plate axes; empty where it is not."""


@dataclass(eq=False)
class ScreenLine:
    """Looks at the ball once per frame and sends what a screen would, a dead time later.

    It has neither port nor thread: ``step`` returns the data that are due.

    Attributes:
        ball: What touches the screen now, m in plate axes, empty for nothing; called once per
            frame.
        protocol: The protocol it sends.
        baud: Bits per second of a serial protocol, ten bits per byte.
        frame: Seconds between frames.
        dead_time: Seconds from looking to arrival.
        spread: Standard deviation of the dead time in s.
        jitter: Standard deviation in s of when a frame is taken, about its clock; at most half a
            frame counts.
        lost: Share of the frames that are never sent.
        calibration: How it is mounted: plate to screen units.
        seed: Of everything random in the faults injected.
    """

    ball: Ball
    _: KW_ONLY
    protocol: Protocol = Protocol.MICROTOUCH
    baud: int = 9600
    frame: float = FRAME_INTERVAL_S
    dead_time: float = SCREEN_DEAD_TIME_S
    spread: float = 0.0
    jitter: float = 0.0
    lost: float = 0.0
    calibration: Calibration | None = None
    seed: int = 0

    TICK: ClassVar = 0.003
    """Shortest time in s between two portions of a packet."""

    def __post_init__(self) -> None:
        """Begin with nothing on the line."""
        # the command line names protocols without numpy
        from twin.devices.lumio.config import Calibration  # noqa: PLC0415

        self.damage = Damage(self.protocol, self.seed)
        serial = self.protocol in {Protocol.MICROTOUCH, Protocol.ELO}
        self._byte = 10 / self.baud if serial else 0.0
        self._random = random.Random(f"frames of {self.seed}")
        self._early = 0.0
        """Seconds by which the next frame is taken before its clock's time."""
        self._calibration = self.calibration or Calibration.nominal()
        self._next: float | None = None
        self._queue: deque[tuple[float, bytes]] = deque()
        self._free = 0.0
        self._down: tuple[Spot, ...] = ()
        self._sent: list[bytes] = []
        self._scan = 0

    def clear(self) -> None:
        """End all damage, and drop what is on its way."""
        self.damage.clear()
        self._queue.clear()
        self._free = 0.0

    def step(self, now: float) -> list[bytes]:
        """Look if a frame is due; the portions of bytes that are due by now, in order."""
        frame = now if self._next is None else self._next
        if now >= frame - self._early:
            if self._random.random() >= self.lost:
                self._look(now)
            frame += self.frame * max(1, int((now - frame) / self.frame))
            drawn = self._random.gauss(0.0, self.jitter)
            self._early = max(-self.frame / 2, min(self.frame / 2, drawn))
        self._next = frame
        sent = []
        while self._queue and self._queue[0][0] <= now:
            sent.append(self._queue.popleft()[1])
        return sent

    def _look(self, now: float) -> None:
        """Take a frame and schedule the packets that it makes the screen send."""
        shares = (self._calibration.screen(*place) for place in self.ball())
        seen = [
            Spot(x, y, name)
            for name, (x, y) in enumerate(shares, start=1)
            if 0 <= x <= 1 and 0 <= y <= 1
        ]
        later = self.damage.LATER * self.damage.lasting(now, ScreenFault.LATER)
        arrival = now + max(0.0, self._random.gauss(self.dead_time, self.spread)) + later
        spots = self.damage.contacts(now, seen)
        lifted = () if self.damage.hides_lift(now) else self._lifted(spots)
        self._down = spots
        for packet in self._packets(now, (*spots, *lifted)):
            for number, part in enumerate(self.damage.packet(now, packet)):
                self._schedule(arrival + number * SPLIT_GAP, part)
        if self.damage.active(now, ScreenFault.FLOOD):
            rate = self.baud / 10 if self._byte else 100_000
            self._schedule(arrival, self.damage.noise(int(self.frame * rate)))

    def _packets(self, now: float, spots: Sequence[Spot]) -> list[bytes]:
        """The packets of a frame; a scan time is the time at which the contacts were looked at."""
        if self.damage.active(now, ScreenFault.REPEAT):
            return self._sent
        if self.protocol is Protocol.HID_TIMED:
            if not self.damage.active(now, ScreenFault.TIME_STILL):
                self._scan = int(now / SCAN_TICK)
            self._sent = hid_timed(spots, self._scan)
        else:
            self._sent = PACKET_ENCODERS[self.protocol](spots)
        return self._sent

    def _lifted(self, spots: Sequence[Spot]) -> tuple[Spot, ...]:
        """One last report of every contact that touched in the last frame and no longer does."""
        names = {spot.id for spot in spots}
        return tuple(spot._replace(down=False) for spot in self._down if spot.id not in names)

    def _schedule(self, arrival: float, packet: bytes) -> None:
        """Queue a packet so that its last byte arrives at a time, the line permitting."""
        begin = max(self._free, arrival - len(packet) * self._byte)
        step = max(1, int(self.TICK / self._byte)) if self._byte else len(packet)
        for at in range(0, len(packet), step):
            part = packet[at : at + step]
            self._queue.append((begin + (at + len(part)) * self._byte, part))
        self._free = begin + len(packet) * self._byte
