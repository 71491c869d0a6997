"""What can go wrong in a touch screen or on its line, to be injected on purpose; seeded."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from enum import StrEnum

from twin.emulator.screen_bytes import Protocol, Spot, beyond


class ScreenFault(StrEnum):
    """What can be injected, for a time.

    Bytes: TRUNCATE cuts packets short; SPLIT sends them in two parts 3 ms apart; MERGE sends two
    at once; GARBLE flips a bit of each; NOISE sends random bytes between packets; CHECKSUM
    falsifies the last byte; FLOOD fills the line with random bytes; OUT_OF_RANGE names a place
    beyond the screen (Format Tablet has no such value: it names the far corner).

    Contacts: PEN_UP lifts the ball off; MISSING_PEN_UP takes it away without saying so; DROPOUT
    does the same for a moment; TWO_CONTACTS adds a finger, which a protocol of one contact reports
    in turn with the ball (assumed); SWAP_AXES exchanges x and y; FREEZE repeats the last place;
    JUMP puts the ball elsewhere in one frame only.
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


class Damage:
    """Applies the faults in force to contacts and to packets.

    Args:
        protocol: What the packets are of.
        seed: Of everything random.
    """

    FINGER = Spot(0.9, 0.9, 2)
    """Where the second contact is."""

    def __init__(self, protocol: Protocol, seed: int) -> None:
        self._protocol = protocol
        self._random = random.Random(seed)
        self._until: dict[ScreenFault, float] = {}
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
        self._last, self._kept = (), b""

    def active(self, fault: ScreenFault, time: float) -> bool:
        """Whether a fault is in force at a time in s."""
        return time < self._until.get(fault, -1.0)

    def noise(self, count: int) -> bytes:
        """Random bytes."""
        return self._random.randbytes(count)

    def contacts(self, time: float, spots: Sequence[Spot]) -> tuple[Spot, ...]:
        """What the screen believes to touch it."""
        seen = tuple(spots)
        if self.active(ScreenFault.FREEZE, time):
            seen = self._last
        self._last = seen
        if self._until.pop(ScreenFault.JUMP, -1.0) > time and seen:
            ball = seen[0]
            seen = (ball._replace(x=(ball.x + 0.45) % 1, y=(ball.y + 0.45) % 1), *seen[1:])
        if self.active(ScreenFault.SWAP_AXES, time):
            seen = tuple(spot._replace(x=spot.y, y=spot.x) for spot in seen)
        gone = (ScreenFault.PEN_UP, ScreenFault.MISSING_PEN_UP, ScreenFault.DROPOUT)
        if any(self.active(fault, time) for fault in gone):
            seen = ()
        if self.active(ScreenFault.TWO_CONTACTS, time):
            if self._protocol in {Protocol.MICROTOUCH, Protocol.ELO}:
                self._turn = not self._turn
                return (self.FINGER._replace(id=1),) if self._turn else seen
            seen = (*seen, self.FINGER)
        return seen

    def hides_lift(self, time: float) -> bool:
        """Whether a lift-off goes unreported."""
        return self.active(ScreenFault.MISSING_PEN_UP, time) or self.active(
            ScreenFault.DROPOUT, time
        )

    def packet(self, time: float, packet: bytes) -> list[bytes]:
        """What is sent for a packet: nothing, itself, or parts to be sent some time apart."""
        if self.active(ScreenFault.OUT_OF_RANGE, time) and self._protocol is Protocol.MICROTOUCH:
            packet = packet[:1] + b"\x7f\x7f\x7f\x7f"
        for fault, change in self._bytes.items():
            if self.active(fault, time):
                packet = change(packet)
        if self.active(ScreenFault.MERGE, time) and not self._kept:
            self._kept = packet
            return []
        packet, self._kept = self._kept + packet, b""
        if self.active(ScreenFault.SPLIT, time) and len(packet) > 1:
            cut = self._random.randrange(1, len(packet))
            return [packet[:cut], packet[cut:]]
        return [packet]

    def _garble(self, packet: bytes) -> bytes:
        changed = bytearray(packet)
        changed[self._random.randrange(len(packet))] ^= 1 << self._random.randrange(8)
        return bytes(changed)
