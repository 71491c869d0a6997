"""The emulated bus for a host in the same process, as a bus of python-can without real time."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import can
from can.exceptions import CanOperationError

from twin.emulator.can_bus import TIME_RESOLUTION_S, EmulatedBus
from twin.emulator.drive_objects import Frame

_ERROR_REPORTS = ((0x040, bytes(8)), (0x004, bytes((0, 0x30, 0, 0, 0, 0, 0, 0))))
"""How SocketCAN's error frames say that an adapter is off the bus, and that it is error passive."""


class DirectBus(can.BusABC):
    """Bus that a host opens to be on an emulated bus without real time; for tests and fault tables.

    Waiting for a frame lets the bus's time pass in steps. Give the host ``now`` and ``sleep`` of
    this object as its clock.

    Args:
        bus: What is emulated.
        step: Longest step in s.
    """

    def __init__(self, bus: EmulatedBus, step: float = 0.0005) -> None:
        super().__init__(channel="emulated")
        self.plugged = True
        """False: the adapter is lost."""
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
            self._bus.step(max(TIME_RESOLUTION_S, min(self._step, left)))

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Put a frame on the bus at once; ``timeout`` is not needed.

        Raises:
            CanOperationError: The adapter is lost.
        """
        self._check()
        self._bus.from_host(Frame(msg.arbitration_id, bytes(msg.data), msg.is_remote_frame))

    def send_queued(self) -> None:
        """Every frame has been sent already."""

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next frame, or None after a timeout in s of bus time.

        The library's own would count the timeout in real time.

        Raises:
            CanOperationError: The adapter is lost.
        """
        self._check()
        self._wait(timeout or 0.0, self._collected)
        return self._inbox.popleft() if self._inbox else None

    def _collected(self) -> bool:
        """Whether anything is there, now that it has been looked for."""
        faults, before = self._bus.faults, self._told
        self._told = (faults.bus_off, faults.error_passive)
        for (identifier, data), now, then in zip(_ERROR_REPORTS, self._told, before, strict=True):
            if now and not then:
                self._inbox.append(message(identifier, data, error=True))
        self._inbox.extend(
            message(each.cob_id, each.data, remote=each.remote, extended=each.extended)
            for each in self._bus.to_host()
        )
        return bool(self._inbox)

    def _check(self) -> None:
        if not self.plugged:
            raise CanOperationError("the adapter is unplugged")


def message(
    identifier: int,
    data: bytes,
    *,
    error: bool = False,
    remote: bool = False,
    extended: bool = False,
) -> can.Message:
    """A frame as python-can has it."""
    return can.Message(
        arbitration_id=identifier,
        data=None if remote else data,
        is_extended_id=error or extended,
        is_error_frame=error,
        is_remote_frame=remote,
    )
