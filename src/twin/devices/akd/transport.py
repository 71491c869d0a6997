"""Frames to and from the CAN bus in mid-run: nothing here raises."""

from __future__ import annotations

import errno
from collections.abc import Callable, Iterator

import can

from twin.devices.akd import frames
from twin.devices.akd.conditions import (
    ADAPTER_GONE,
    BUS_OFF,
    ERROR_PASSIVE,
    GARBLED,
    FaultReports,
)
from twin.devices.akd.network import BUS_ERRORS
from twin.devices.akd.slcan_bus import QueuedBus

_ERROR_BUS_OFF, _ERROR_CONTROLLER = 0x040, 0x004
_PASSIVE = 0x30
"""Bits of SocketCAN's error frames: identifier, and passive flags in data byte 1."""

_MOST = 400
"""Frames taken at one time; a flood must not hold up the loop."""
_BLOCKED = 5
"""Frames in a row that find no room to be sent before the bus counts as off."""


class CanTransport:
    """Frames out and in, and the faults of the bus that the adapter shows.

    Args:
        bus: The open bus, any of python-can; a `QueuedBus` sends at ``send_queued`` only.
        where: How it is called in messages.
        reports: Where faults are reported.
        now: Monotonic time in s.
    """

    def __init__(
        self, bus: can.BusABC, where: str, reports: FaultReports, now: Callable[[], float]
    ) -> None:
        self.up = True
        """Whether the adapter still works."""
        self._bus = bus
        self._queued = bus if isinstance(bus, QueuedBus) else None
        self._where = where
        self._reports = reports
        self._now = now
        self._blocked = 0
        self._unreadable = 0

    def send(self, identifier: int, data: bytes) -> None:
        """Hand a frame to the adapter."""
        if not self.up:
            return
        try:
            self._bus.send(
                can.Message(arbitration_id=identifier, is_extended_id=False, data=data), timeout=0
            )
            self._blocked = 0
        except BUS_ERRORS as error:
            if getattr(error, "error_code", getattr(error, "errno", None)) != errno.ENOBUFS:
                self._gone(error)
                return
            self._blocked += 1
            if self._blocked >= _BLOCKED:
                self._report_off("nobody acknowledges: no room to send")

    def send_queued(self) -> None:
        """Send what the bus has queued; other buses have sent every frame already."""
        if self.up and self._queued is not None:
            try:
                self._queued.send_queued()
            except BUS_ERRORS as error:
                self._gone(error)

    def receive(self, wait: float = 0.0) -> Iterator[tuple[int, bytes]]:
        """Frames that have arrived, identifier and data; waits s for the first of them."""
        for _ in range(_MOST):
            if not self.up:
                return
            try:
                message = self._bus.recv(wait)
            except BUS_ERRORS as error:
                self._gone(error)
                return
            if message is None:
                break
            if message.is_error_frame:
                self._error(message)
            elif message.is_rx and not (message.is_remote_frame or message.is_extended_id):
                yield message.arbitration_id, bytes(message.data)
            wait = 0.0
        unreadable = self._queued.unreadable_lines if self._queued is not None else 0
        if unreadable > self._unreadable:
            lines = f"{unreadable - self._unreadable} lines cannot be read"
            self._reports.report(GARBLED, self._where, lines, self._now())
            self._unreadable = unreadable

    def send_heartbeat(self, host: int) -> None:
        """Send the heartbeat of the host's node."""
        self.send(frames.HEARTBEAT + host, bytes((frames.OPERATIONAL,)))

    def close(self) -> None:
        """Close the bus, whatever state it is in."""
        self.up = False
        try:
            self._bus.shutdown()
        except BUS_ERRORS:
            return

    def _error(self, message: can.Message) -> None:
        if message.arbitration_id & _ERROR_BUS_OFF:
            self._report_off("the adapter has left the bus")
        elif message.arbitration_id & _ERROR_CONTROLLER and _passive(bytes(message.data)):
            detail = "many errors on the line"
            self._reports.report(ERROR_PASSIVE, self._where, detail, self._now())

    def _report_off(self, detail: str) -> None:
        self._reports.report(BUS_OFF, self._where, detail, self._now())

    def _gone(self, error: Exception) -> None:
        self.up = False
        self._reports.report(ADAPTER_GONE, self._where, str(error), self._now())


def _passive(data: bytes) -> bool:
    return len(data) > 1 and bool(data[1] & _PASSIVE)
