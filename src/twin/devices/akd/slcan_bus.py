"""Serial-line CAN adapters (LAWICEL protocol) without waiting, and with their bus errors.

python-can's own bus reads byte by byte, waits a millisecond when nothing is there, ends a drain at
every acknowledgement, and never polls the adapter's status flags. This one differs in just that,
and writes all frames of a period in one piece; opening, bit rate and closing are the library's.
"""

from __future__ import annotations

import errno
import os
import select
import time
from contextlib import suppress
from typing import Any, Protocol, runtime_checkable

from can import BusABC, Message
from can.exceptions import CanOperationError
from can.interfaces.slcan import slcanBus

ERROR_PASSIVE_FRAME = (0x004, bytes((0, 0x30, 0, 0, 0, 0, 0, 0)))
BUS_ERROR_FRAME = (0x080, bytes(8))
BUS_OFF_FRAME = (0x040, bytes(8))
"""Error frames, identifier and data, as SocketCAN writes them."""

_FLAG_PASSIVE, _FLAG_BUS_ERROR = 0x20, 0x80
_LAST_IDENTIFIER = 0x7FF


@runtime_checkable
class QueuedBus(Protocol):
    """A bus that queues frames until ``send_queued``, and reads lines of text.

    Not named ``flush``: python-can's buses of that name discard what has been received.
    """

    @property
    def unreadable_lines(self) -> int:
        """Lines received so far that are no frame and no answer."""

    def send_queued(self) -> None:
        """Send all queued frames.

        Raises:
            can.CanError: If the adapter cannot take them.
        """


class PromptSlcanBus(slcanBus):
    """A LAWICEL adapter on a serial port that queues frames; bus errors arrive as error frames.

    The port is opened exclusively: who asks for a lock on it, as this program does, is refused.
    Only classic data frames with 11-bit identifiers are read; other lines are counted in
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
        # Claimed before the library opens it: its first bytes would close another one's channel.
        self._claim = _claimed(channel)
        try:
            super().__init__(channel, bitrate=bitrate, timeout=0, **options)
        except BaseException:
            self._release()
            raise

    def _write(self, string: str) -> None:
        # Not through pyserial, whose write waits, and times out even for bytes it has written.
        data = string.encode("ascii") + self.LINE_TERMINATOR
        try:
            written = os.write(self.serialPortOrig.fileno(), data)
        except OSError as error:
            raise CanOperationError(f"adapter cannot be written: {error}") from error
        if written < len(data):
            raise CanOperationError("adapter takes no more bytes")

    def send(self, msg: Message, timeout: float | None = None) -> None:
        """Queue a frame for the next ``send_queued`` or ``recv``.

        Raises:
            CanOperationError: If it is no classic data frame with an 11-bit identifier.
        """
        if msg.is_extended_id or msg.is_remote_frame or msg.is_fd or msg.is_error_frame:
            raise CanOperationError(f"not a data frame with an 11-bit identifier: {msg}")
        self._unsent.append(f"t{msg.arbitration_id:03X}{msg.dlc}{msg.data.hex().upper()}")

    def send_queued(self) -> None:
        """Write all queued frames in one piece: one transfer for all frames of a period.

        Raises:
            CanOperationError: If the adapter does not take every byte at once.
        """
        if self._unsent:
            lines, self._unsent = "\r".join(self._unsent), []
            self._write(lines)

    def shutdown(self) -> None:
        """Close the channel and the port; an adapter that has gone is let go."""
        BusABC.shutdown(self)
        with suppress(CanOperationError):
            self.send_queued()
            self._write("C")
        self.serialPortOrig.close()
        self._release()

    def _release(self) -> None:
        if self._claim is not None:
            os.close(self._claim)
            self._claim = None

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
            identifier, length, data = int(line[1:4], 16), int(line[4:5]), line[5:]
            # Python also reads 1_2 and -12 as numbers; no adapter writes them
            plain = line.isalnum() and identifier <= _LAST_IDENTIFIER and length <= 8
            if kind == b"t" and plain and len(data) in {2 * length, 2 * length + 4}:
                return Message(
                    timestamp=time.time(),
                    arbitration_id=identifier,
                    is_extended_id=False,
                    data=bytes.fromhex(data[: 2 * length].decode("ascii")),
                )
        except ValueError:
            pass
        self.unreadable_lines += 1
        return None

    def _refusal(self) -> Message | None:
        self._refused += 1
        return _error(*BUS_OFF_FRAME) if self._refused == self.REFUSALS else None

    @staticmethod
    def _flags(flags: int) -> Message | None:
        if flags & _FLAG_PASSIVE:
            return _error(*ERROR_PASSIVE_FRAME)
        return _error(*BUS_ERROR_FRAME) if flags & _FLAG_BUS_ERROR else None


def _claimed(channel: str) -> int | None:
    """A descriptor that keeps the port for this process; None where a channel is no file.

    Raises:
        OSError: If it cannot be opened, or another program has claimed it.
    """
    import fcntl  # noqa: PLC0415  POSIX only, as this bus

    path = channel.partition("@")[0]
    if "://" in path:
        return None
    handle = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(handle)
        raise OSError(errno.EBUSY, "port is locked") from error
    return handle


def _error(identifier: int, data: bytes) -> Message:
    return Message(
        timestamp=time.time(),
        arbitration_id=identifier,
        is_extended_id=True,
        is_error_frame=True,
        data=data,
    )
