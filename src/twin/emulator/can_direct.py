"""The emulated bus as a python-can bus in the caller's own thread: time passes only when told."""

from __future__ import annotations

from collections import deque

import can
from can.exceptions import CanOperationError

from twin.emulator.can_bus import EmulatedBus
from twin.emulator.can_frame import Frame
from twin.emulator.can_virtual import ErrorState, message

_INSTANT = 1e-9
"""Seconds that count as no time."""


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
        self.channel_info = "emulated"
        self.plugged = True
        """False: the adapter is gone."""
        self._bus = bus
        self._step = step
        self._inbox: deque[can.Message] = deque()
        self._state = ErrorState(bus.faults)

    def now(self) -> float:
        """Bus time in s."""
        return self._bus.time

    def sleep(self, seconds: float) -> None:
        """Let the bus's time pass."""
        end = self._bus.time + seconds
        while (left := end - self._bus.time) > 0:
            # A step too small to count would let whoever waits for a deadline wait for ever.
            self._bus.step(max(_INSTANT, min(self._step, left)))

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Put a frame on the bus at once; ``timeout`` is not needed."""
        self._check()
        self._bus.from_host(Frame(msg.arbitration_id, bytes(msg.data), msg.is_remote_frame))

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next frame, or None after a timeout in s of bus time.

        The library's own would count the timeout in real time.
        """
        self._check()
        end = self._bus.time + (timeout or 0.0)
        self._collect()
        while not self._inbox and (left := end - self._bus.time) > 0:
            self._bus.step(max(_INSTANT, min(self._step, left)))
            self._collect()
        return self._inbox.popleft() if self._inbox else None

    def _collect(self) -> None:
        self._inbox.extend(self._state.news())
        self._inbox.extend(message(each.cob_id, each.data) for each in self._bus.to_host())

    def _check(self) -> None:
        if not self.plugged:
            raise CanOperationError("the adapter is gone")
