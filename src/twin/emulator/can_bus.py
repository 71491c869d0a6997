"""An emulated CAN bus: drives, and what lies between them and the host's adapter; no clock."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence
from itertools import count

from twin.emulator.can_faults import BusFaults, Towards
from twin.emulator.can_frame import Frame
from twin.emulator.drive import EmulatedDrive


class EmulatedBus:
    """Carries frames at once, in order; arbitration and transmission times are not emulated.

    Args:
        drives: Who is on it; two with one node are allowed, as on a real bus.
        bitrate: What the drives are set to, bit/s; another adapter hears nothing.
        faults: The damage; none by default.
    """

    def __init__(
        self,
        drives: Sequence[EmulatedDrive],
        *,
        bitrate: int = 1_000_000,
        faults: BusFaults | None = None,
    ) -> None:
        self.drives = list(drives)
        self.bitrate = bitrate
        self.faults = faults or BusFaults()
        self.time = 0.0
        """Seconds that have been stepped."""
        self.moved: Callable[[float], None] = _nothing
        """Called after each step with its s, to move a plant: read ``drive.rate``, call
        ``drive.sense``."""
        self._order = count()
        self._later: list[tuple[float, int, Towards, Frame]] = []
        self._host: list[Frame] = []

    def from_host(self, frame: Frame) -> bool:
        """Take a frame from the host's adapter; whether anybody acknowledged it."""
        if self.faults.bus_off or not self.drives:
            return False
        self._carry(frame, Towards.DRIVES)
        return True

    def to_host(self) -> list[Frame]:
        """Frames that have reached the host's adapter since the last call."""
        host, self._host = self._host, []
        return host

    def step(self, dt: float) -> None:
        """Let dt seconds pass for the drives and for delayed frames."""
        self.time += dt
        self.faults.time = self.time
        for drive in self.drives:
            for frame in drive.step(dt):
                self._carry(frame, Towards.HOST)
        while self._later and self._later[0][0] <= self.time:
            _, _, towards, frame = heapq.heappop(self._later)
            self._arrive(frame, towards)
        self.moved(dt)

    def _carry(self, frame: Frame, towards: Towards) -> None:
        for delay, each in self.faults.deliver(frame, towards):
            if delay > 0:
                entry = (self.time + delay, next(self._order), towards, each)
                heapq.heappush(self._later, entry)
            else:
                self._arrive(each, towards)

    def _arrive(self, frame: Frame, towards: Towards) -> None:
        if towards is Towards.HOST:
            self._host.append(frame)
            return
        for drive in self.drives:
            for answer in drive.receive(frame):
                self._carry(answer, Towards.HOST)


def _nothing(_: float) -> None:
    """No plant."""
