"""An emulated CAN bus: drives, what lies between them and the host's adapter, and who steps it.

The bus itself has no clock. ``DirectBus`` lets its time pass as fast as the host can compute; the
``BusServer`` of ``can_server`` lets it pass in real time.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable, Sequence
from itertools import count

import can
from can.exceptions import CanOperationError

from twin.emulator.can_faults import BusFaults, Frame, Towards
from twin.emulator.drive import EmulatedDrive

_REPORTS = ((0x040, bytes(8)), (0x004, bytes((0, 0x30, 0, 0, 0, 0, 0, 0))))
"""How SocketCAN's error frames say that an adapter is off the bus, and that it is error passive."""
_INSTANT = 1e-9
"""Seconds that count as no time."""


class EmulatedBus:
    """Carries frames at once, in order; arbitration and transmission times are not emulated.

    Args:
        drives: Who is on it; two with one node are allowed, as on a real bus.
    """

    def __init__(self, drives: Sequence[EmulatedDrive]) -> None:
        self.drives = list(drives)
        self.bitrate = 1_000_000
        """What the drives are set to, bit/s; another adapter hears nothing."""
        self.faults = BusFaults()
        """The damage."""
        self.time = 0.0
        """Seconds that have been stepped."""
        self.moved: Callable[[float], None] = lambda _: None
        """Called after each step with its s, to move a plant: read ``drive.rate``, call
        ``drive.motor.sense``."""
        self.heard: Callable[[], None] = lambda: None
        """Called after each frame that the drives have taken in."""
        self.beside: list[tuple[Frame, float]] = []
        """Frames that another master sends, and how often, in s."""
        self._order = count()
        self._later: list[tuple[float, int, Towards, Frame]] = []
        self._host: list[Frame] = []

    def from_host(self, frame: Frame) -> bool:
        """Take a frame from the host's adapter; whether anybody acknowledged it."""
        if self.faults.bus_off or not self.drives:
            return False
        self._carry(frame, Towards.DRIVES)
        return True

    def from_other(self, frame: Frame) -> None:
        """Take a frame of a third participant, as of another master: drives and host hear it."""
        self._carry(frame, Towards.DRIVES)
        self._carry(frame, Towards.HOST)

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
        for frame, every in self.beside:
            if int(self.time / every + 1e-9) > int((self.time - dt) / every + 1e-9):
                self.from_other(frame)
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
        self.heard()


class DirectBus(can.BusABC):
    """What a host opens to be on an emulated bus without real time; for tests and fault tables.

    Waiting for a frame lets the bus's time pass in steps. Give the host ``now`` and ``sleep`` of
    this object as its clock.

    Args:
        bus: What is emulated.
        step: Longest step in s.
    """

    def __init__(self, bus: EmulatedBus, step: float = 0.0005) -> None:
        super().__init__(channel="emulated")
        self.plugged = True
        """False: the adapter is gone."""
        self.unreadable_lines = 0
        """Lines of text that are no frame, as of an adapter on a serial port."""
        self._bus = bus
        self._step = step
        self._inbox: deque[can.Message] = deque()
        self._told = (False, False)

    def now(self) -> float:
        """Bus time in s."""
        return self._bus.time

    def sleep(self, seconds: float) -> None:
        """Let the bus's time pass."""
        self._wait(seconds, lambda: False)

    def _wait(self, seconds: float, done: Callable[[], object]) -> None:
        end = self._bus.time + seconds
        while not done() and (left := end - self._bus.time) > 0:
            # A step too small to count would let whoever waits for a deadline wait for ever.
            self._bus.step(max(_INSTANT, min(self._step, left)))

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Put a frame on the bus at once; ``timeout`` is not needed.

        Raises:
            CanOperationError: The adapter is gone.
        """
        self._check()
        self._bus.from_host(Frame(msg.arbitration_id, bytes(msg.data), msg.is_remote_frame))

    def send_queued(self) -> None:
        """Every frame has been sent already."""

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next frame, or None after a timeout in s of bus time.

        The library's own would count the timeout in real time.

        Raises:
            CanOperationError: The adapter is gone.
        """
        self._check()
        self._wait(timeout or 0.0, self._collected)
        return self._inbox.popleft() if self._inbox else None

    def _collected(self) -> bool:
        """Whether anything is there, now that it has been looked for."""
        faults, before = self._bus.faults, self._told
        self._told = (faults.bus_off, faults.error_passive)
        for (identifier, data), now, then in zip(_REPORTS, self._told, before, strict=True):
            if now and not then:
                self._inbox.append(message(identifier, data, error=True))
        self._inbox.extend(message(each.cob_id, each.data) for each in self._bus.to_host())
        return bool(self._inbox)

    def _check(self) -> None:
        if not self.plugged:
            raise CanOperationError("the adapter is gone")


def message(identifier: int, data: bytes, *, error: bool = False) -> can.Message:
    """A frame as python-can has it."""
    return can.Message(
        arbitration_id=identifier, data=data, is_extended_id=error, is_error_frame=error
    )
