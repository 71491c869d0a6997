"""The CAN bus: opened by name, sent to and read in mid-run, where nothing raises.

Of serial-line adapters (LAWICEL protocol) python-can's own bus reads byte by byte, waits a
millisecond when nothing is there, ends a drain at every acknowledgement, and never polls the
adapter's status flags. The one here differs in just that, and writes all frames of a period in one
piece; opening, bit rate and closing are the library's.
"""

from __future__ import annotations

import errno
import logging
import os
import select
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from typing import Any

import can
from can import BusABC, Message
from can.exceptions import CanOperationError
from can.interfaces.slcan import slcanBus

from twin.base.errors import nearest, one_line, plural
from twin.devices.akd import conditions as c
from twin.devices.akd import protocol
from twin.devices.akd.conditions import DriveError
from twin.devices.akd.config import BusConfig
from twin.devices.common import FaultReports, claim, error_number, in_words

BUS_ERRORS = (can.CanError, OSError)
"""Errors of python-can and the drivers below it when an adapter is lost."""

ERROR_PASSIVE_FRAME = (0x004, bytes((0, 0x30, 0, 0, 0, 0, 0, 0)))
BUS_ERROR_FRAME = (0x080, bytes(8))
BUS_OFF_FRAME = (0x040, bytes(8))
"""Error frames, identifier and data, as SocketCAN writes them."""

_FLAG_PASSIVE, _FLAG_BUS_ERROR = 0x20, 0x80
_LAST_IDENTIFIER, _LAST_EXTENDED = 0x7FF, 0x1FFFFFFF


class PromptSlcanBus(slcanBus):
    """A LAWICEL adapter on a serial port that queues frames; bus errors arrive as error frames.

    The port is opened exclusively: who asks for a lock on it, as this program does, is refused.
    Classic frames are read, remote requests and those of 29 bits, too; other lines are counted in
    ``unreadable_lines``. Every ``POLL`` seconds the adapter's status flags are requested.
    """

    POLL = 0.05
    """Pause in s between two requests for the status flags."""
    REFUSALS = 6
    """Refused transmissions in a row (BELL) that mean bus-off."""

    def __init__(self, channel: str, bitrate: int, **options: Any) -> None:
        self.unreadable_lines = 0
        self._unsent: list[str] = []
        self._polled = 0.0
        self._refused = 0
        # Claimed before the library opens it: its first bytes would close the channel of its user.
        self._claim, path = ExitStack(), channel.partition("@")[0]
        if "://" not in path:
            self._claim.callback(os.close, claim(path, os.O_RDWR))
        try:
            super().__init__(channel, bitrate=bitrate, timeout=0, **options)
        except BaseException:
            self._claim.close()
            raise

    def _write(self, string: str) -> None:
        """Write a command; a frame, as ``send`` writes it, waits for the next command or period."""
        self._unsent.append(string)
        if not string.startswith("t"):
            self.send_queued()

    def send_queued(self) -> None:
        """Write what waits in one piece: one transfer for all frames of a period.

        Raises:
            CanOperationError: If the adapter does not take every byte at once.
        """
        if not self._unsent:
            return
        # Not through pyserial: its write waits, and times out even for bytes it has written.
        data = b"".join(line.encode("ascii") + self.LINE_TERMINATOR for line in self._unsent)
        self._unsent.clear()
        try:
            written = os.write(self.serialPortOrig.fileno(), data)
        except OSError as error:
            raise CanOperationError(f"adapter cannot be written: {error}") from error
        if written < len(data):
            raise CanOperationError("the adapter accepts no more bytes")

    def shutdown(self) -> None:
        """Close the channel and the port; an adapter that was lost is only forgotten."""
        BusABC.shutdown(self)
        with suppress(CanOperationError):
            self._write("C")
        self.serialPortOrig.close()
        self._claim.close()

    def _recv_internal(self, timeout: float | None) -> tuple[Message | None, bool]:
        self.send_queued()
        self._poll_flags()
        message = self._next_message()
        if message is None and self._fill_buffer(timeout):
            message = self._next_message()
        return message, True

    def _poll_flags(self) -> None:
        now = time.monotonic()
        if now - self._polled > self.POLL:
            self._polled = now
            self._write("F")

    def _fill_buffer(self, timeout: float | None) -> bool:
        try:
            if timeout != 0:
                select.select([self.serialPortOrig.fileno()], [], [], timeout)
            waiting = self.serialPortOrig.in_waiting
            self._buffer += self.serialPortOrig.read(waiting) if waiting else b""
        except OSError as error:
            raise CanOperationError(f"adapter cannot be read: {error}") from error
        return waiting > 0

    def _next_message(self) -> Message | None:
        while True:
            ends = [at for at in (self._buffer.find(b"\r"), self._buffer.find(b"\a")) if at >= 0]
            if not ends:
                return None
            end = min(ends)
            line, mark = bytes(self._buffer[:end]), self._buffer[end]
            del self._buffer[: end + 1]
            message = self._refusal() if mark == self._ERROR[0] else self._decode(line)
            if message is not None:
                return message

    def _decode(self, line: bytes) -> Message | None:
        kind = line[:1]
        if kind in b"zZ":  # also the empty line: both acknowledge
            self._refused = 0
            return None
        try:
            if kind == b"F" and len(line) == 3:
                return self._flags(int(line[1:], 16))
            extended, remote = kind in b"TR", kind in b"rR"
            end, last = (9, _LAST_EXTENDED) if extended else (4, _LAST_IDENTIFIER)
            identifier, data = int(line[1:end], 16), line[end + 1 :]
            length = int(line[end : end + 1])
            # Python also reads 1_2 and -12 as numbers; no adapter writes them
            plain = line.isalnum() and identifier <= last and length <= 8
            digits = 0 if remote else 2 * length
            if kind in b"tTrR" and plain and len(data) in {digits, digits + 4}:
                return Message(
                    timestamp=time.time(),
                    arbitration_id=identifier,
                    is_extended_id=extended,
                    is_remote_frame=remote,
                    dlc=length,
                    data=None if remote else bytes.fromhex(data[:digits].decode("ascii")),
                )
        except ValueError:
            pass
        self.unreadable_lines += 1
        return None

    def _refusal(self) -> Message | None:
        self._refused += 1
        off = self._refused == self.REFUSALS
        return _error_message(*BUS_OFF_FRAME) if off else None

    @staticmethod
    def _flags(flags: int) -> Message | None:
        if flags & _FLAG_PASSIVE:
            return _error_message(*ERROR_PASSIVE_FRAME)
        return _error_message(*BUS_ERROR_FRAME) if flags & _FLAG_BUS_ERROR else None


def _error_message(identifier: int, data: bytes) -> Message:
    return Message(
        timestamp=time.time(),
        arbitration_id=identifier,
        is_extended_id=True,
        is_error_frame=True,
        data=data,
    )


_PASSIVE_BITS = 0x30
"""Bits of data byte 1 of SocketCAN's error frames that say that an adapter is error passive."""
_MAX_FRAMES_AT_ONCE = 400
"""Frames taken at one time; a flood must not hold up the loop."""
_BLOCKED_FRAMES_LIMIT = 5
"""Frames in a row that find no room to be sent before the bus counts as off."""


def _foreign(message: can.Message) -> str:
    """Why a frame is none of CANopen's that is answered here, in words; empty if it may be one."""
    identifier = f"{message.arbitration_id:X}h"
    if message.is_extended_id:
        return f"{identifier} of 29 bits"
    if message.is_remote_frame:
        return f"remote request for {identifier}"
    return f"{identifier} of CAN FD" if message.is_fd else ""


class CanTransport:
    """Frames out and in, and the faults of the bus that the adapter shows.

    Args:
        bus: The open bus, any of python-can. One that has ``send_queued`` sends at that only: not
            named ``flush``, as python-can's buses of that name discard what has been received.
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
        self._send_queued = getattr(bus, "send_queued", None)
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
            if self._blocked >= _BLOCKED_FRAMES_LIMIT:
                self._report_off("nobody acknowledges: no room to send")

    def send_queued(self) -> None:
        """Send what the bus has queued; other buses have sent every frame already."""
        if self.up and self._send_queued is not None:
            try:
                self._send_queued()
            except BUS_ERRORS as error:
                self._gone(error)

    def receive(self, wait: float = 0.0) -> Iterator[tuple[int, bytes]]:
        """Frames that have arrived, identifier and data; waits s for the first of them."""
        for _ in range(_MAX_FRAMES_AT_ONCE):
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
            elif foreign := _foreign(message):
                self._reports.report(c.FOREIGN_FRAME, self._where, foreign, self._now())
            elif message.is_rx:
                yield message.arbitration_id, bytes(message.data)
            wait = 0.0
        unreadable = getattr(self._bus, "unreadable_lines", 0)
        if unreadable > self._unreadable:
            lines = f"{plural(unreadable - self._unreadable, 'line')} cannot be read"
            self._reports.report(c.GARBLED, self._where, lines, self._now())
            self._unreadable = unreadable

    def send_heartbeat(self, host: int) -> None:
        """Send the heartbeat of the host's node."""
        self.send(protocol.HEARTBEAT + host, bytes((protocol.OPERATIONAL,)))

    def close(self) -> None:
        """Close the bus, whatever state it is in."""
        self.up = False
        try:
            self._bus.shutdown()
        except BUS_ERRORS:
            return

    def _error(self, message: can.Message) -> None:
        if message.arbitration_id & BUS_OFF_FRAME[0]:
            self._report_off("the adapter has left the bus")
        elif message.arbitration_id & ERROR_PASSIVE_FRAME[0] and any(
            flags & _PASSIVE_BITS for flags in message.data[1:2]
        ):
            detail = "many errors on the line"
            self._reports.report(c.ERROR_PASSIVE, self._where, detail, self._now())

    def _report_off(self, detail: str) -> None:
        self._reports.report(c.BUS_OFF, self._where, detail, self._now())

    def _gone(self, error: Exception) -> None:
        self.up = False
        self._reports.report(c.ADAPTER_GONE, self._where, str(error), self._now())


# The library logs to stderr what becomes one line here.
logging.getLogger("can").addHandler(logging.NullHandler())


def open_bus(config: BusConfig) -> can.BusABC:
    """Open a bus through python-can.

    Raises:
        DriveError: If there is no such interface or channel, or it may not or cannot be used.
    """
    if config.interface not in can.VALID_INTERFACES:
        near = nearest(config.interface, sorted(can.VALID_INTERFACES))
        raise _bad(config, f"unknown CAN interface {config.interface!r}{near}")
    try:
        # On Windows a serial port has no file descriptor: the library's own slcan has to do.
        if config.interface == "slcan" and sys.platform != "win32":
            return PromptSlcanBus(config.channel, config.bitrate, **config.options)
        # SocketCAN's bit rate is set by the operating system, and python-can warns if it is given.
        options = dict(config.options)
        if config.interface not in {"socketcan", "virtual"}:
            options["bitrate"] = config.bitrate
        return can.Bus(interface=config.interface, channel=config.channel, **options)
    except Exception as error:  # drivers of adapters raise anything, even NameError
        raise _bad(config, _reason(config, error)) from error


def _reason(config: BusConfig, error: Exception) -> str:
    known = in_words("bus", error_number(error), channel=config.channel)
    if known is not None:
        return known
    if isinstance(error, (can.CanInterfaceNotImplementedError, ImportError, NameError)):
        return f"the driver of {config.interface} is not installed ({one_line(error)})"
    return one_line(error)


def _bad(config: BusConfig, detail: str) -> DriveError:
    return DriveError(c.BAD_BUS, f"CAN {config}", detail)
