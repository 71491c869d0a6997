"""What a Lumio screen sends and when: frames, packets, their pace; no port, no thread."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence

from twin.devices.lumio.calibration import Calibration
from twin.emulator.screen_bytes import ENCODERS, Protocol, Spot
from twin.emulator.screen_faults import Damage, ScreenFault

Ball = Callable[[], Sequence[tuple[float, float]]]

FRAME = 0.01736
"""Seconds between frames, as recorded from a screen of product 202E:0006."""
DEAD_TIME = 0.042
"""Seconds from a touch to its arrival, as the thesis measured."""
SPLIT_GAP = 0.003
"""Seconds between the parts of a packet that is split on purpose."""


class ScreenLine:
    """Looks at the ball once a frame and sends what a screen would, a dead time later.

    Args:
        ball: What touches the screen now, m in plate axes, empty for nothing; called once a frame.
        protocol: What it speaks.
        baud: Bits a second of a serial protocol, ten bits a byte.
        frame: Seconds between frames.
        dead_time: Seconds from looking to arrival.
        calibration: How it is mounted: plate to screen units.
        seed: Of everything random in the faults injected.
    """

    TICK = 0.003
    """Shortest time in s between two portions of a packet."""

    def __init__(
        self,
        ball: Ball,
        *,
        protocol: Protocol = Protocol.MICROTOUCH,
        baud: int = 9600,
        frame: float = FRAME,
        dead_time: float = DEAD_TIME,
        calibration: Calibration | None = None,
        seed: int = 0,
    ) -> None:
        self.damage = Damage(protocol, seed)
        self.due = 0.0
        """When there is something to do next, s."""
        self._ball = ball
        self.protocol = protocol
        self._byte = 10 / baud if protocol in {Protocol.MICROTOUCH, Protocol.ELO} else 0.0
        self._baud = baud
        self._frame = frame
        self._dead_time = dead_time
        self._calibration = calibration or Calibration.nominal()
        self._next: float | None = None
        self._queue: deque[tuple[float, bytes]] = deque()
        self._free = 0.0
        self._down: tuple[Spot, ...] = ()

    def step(self, now: float) -> list[bytes]:
        """Look if a frame is due; the portions of bytes that are due by now, in order."""
        frame = now if self._next is None else self._next
        if now >= frame:
            self._look(now)
            frame += self._frame * max(1, int((now - frame) / self._frame))
        self._next = frame
        sent = []
        while self._queue and self._queue[0][0] <= now:
            sent.append(self._queue.popleft()[1])
        self.due = min(frame, self._queue[0][0]) if self._queue else frame
        return sent

    def _look(self, now: float) -> None:
        """Take a frame and schedule what it makes the screen send."""
        shares = (self._calibration.screen(*place) for place in self._ball())
        seen = [
            Spot(x, y, name)
            for name, (x, y) in enumerate(shares, start=1)
            if 0 <= x <= 1 and 0 <= y <= 1
        ]
        spots = self.damage.contacts(now, seen)
        lifted = () if self.damage.hides_lift(now) else self._lifted(spots)
        self._down = spots
        for packet in ENCODERS[self.protocol]((*spots, *lifted)):
            for number, part in enumerate(self.damage.packet(now, packet)):
                self._schedule(now + self._dead_time + number * SPLIT_GAP, part)
        if self.damage.active(ScreenFault.FLOOD, now):
            rate = self._baud / 10 if self._byte else 100_000
            self._schedule(now + self._dead_time, self.damage.noise(int(self._frame * rate)))

    def _lifted(self, spots: Sequence[Spot]) -> tuple[Spot, ...]:
        """One last report of every contact that touched a frame ago and does no more."""
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
