"""Serial-line CAN adapters (LAWICEL protocol) without waiting, and with their bus errors.

python-can's own bus reads byte by byte, waits a millisecond when nothing is there, ends a drain at
every acknowledgement, and never asks the adapter how the bus is. This one differs in just that,
and writes all frames of a period in one piece; opening, bit rate and closing are the library's.
"""

from __future__ import annotations

import os
import select
import time
from contextlib import suppress
from typing import Any

from can import BusABC, Message
from can.exceptions import CanOperationError
from can.interfaces.slcan import slcanBus

ERROR_PASSIVE_FRAME = (0x004, bytes((0, 0x30, 0, 0, 0, 0, 0, 0)))
BUS_ERROR_FRAME = (0x080, bytes(8))
BUS_OFF_FRAME = (0x040, bytes(8))
"""Error frames, identifier and data, as SocketCAN writes them."""

_FLAG_PASSIVE, _FLAG_BUS_ERROR = 0x20, 0x80


class PromptSlcanBus(slcanBus):
    """A LAWICEL adapter on a serial port; bus errors arrive as error frames.

    Only classic data frames with 11-bit identifiers are taken; other lines are counted in
    ``garbled``. Every ``ASK`` seconds the adapter is asked for its status flags.
    """

    ASK = 0.05
    """Pause in s between two questions for the status flags."""
    REFUSALS = 6
    """Refused transmissions in a row (BELL) that mean bus-off."""

    def __init__(self, channel: str, bitrate: int, **options: Any) -> None:
        self.garbled = 0
        self._bytes = bytearray()
        self._waiting: list[str] = []
        self._asked = 0.0
        self._unanswered = False
        self._refused = 0
        super().__init__(channel, bitrate=bitrate, timeout=0, **options)

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
        """Hand a frame to the adapter with the next ``flush`` or ``recv``."""
        self._waiting.append(f"t{msg.arbitration_id:03X}{msg.dlc}{msg.data.hex().upper()}")

    def flush(self) -> None:
        """Write what waits to be sent in one piece: one transfer for all frames of a period."""
        if self._waiting:
            lines, self._waiting = "\r".join(self._waiting), []
            self._write(lines)

    def shutdown(self) -> None:
        """Close the channel and the port; an adapter that has gone is let go."""
        BusABC.shutdown(self)
        with suppress(CanOperationError):
            self.flush()
            self._write("C")
        self.serialPortOrig.close()

    def _recv_internal(self, timeout: float | None) -> tuple[Message | None, bool]:
        self.flush()
        self._ask()
        message = self._next()
        if message is None and self._fill(timeout):
            message = self._next()
        return message, True

    def _ask(self) -> None:
        now = time.monotonic()
        if now - self._asked > self.ASK:
            self._asked = now
            self._write("F")

    def _fill(self, timeout: float | None) -> bool:
        try:
            if timeout != 0:
                select.select([self.serialPortOrig.fileno()], [], [], timeout)
            waiting = self.serialPortOrig.in_waiting
            self._bytes += self.serialPortOrig.read(waiting) if waiting else b""
        except OSError as error:
            raise CanOperationError(f"adapter cannot be read: {error}") from error
        return waiting > 0

    def _next(self) -> Message | None:
        while True:
            ends = [at for at in (self._bytes.find(b"\r"), self._bytes.find(b"\a")) if at >= 0]
            if not ends:
                return None
            end = min(ends)
            line, mark = bytes(self._bytes[:end]), self._bytes[end]
            del self._bytes[: end + 1]
            message = self._refusal() if mark == self._ERROR[0] else self._line(line)
            if message is not None:
                return message

    def _line(self, line: bytes) -> Message | None:
        kind = line[:1]
        if kind in b"zZ":  # also the empty line: both acknowledge
            self._refused = 0
            return None
        try:
            if kind == b"F" and len(line) == 3:
                return self._flags(int(line[1:], 16))
            identifier, length, data = int(line[1:4], 16), int(line[4:5]), line[5:]
            if kind == b"t" and length <= 8 and len(data) in {2 * length, 2 * length + 4}:
                return Message(
                    timestamp=time.time(),
                    arbitration_id=identifier,
                    is_extended_id=False,
                    data=bytes.fromhex(data[: 2 * length].decode("ascii")),
                )
        except ValueError:
            pass
        self.garbled += 1
        return None

    def _refusal(self) -> Message | None:
        self._refused += 1
        return _error(*BUS_OFF_FRAME) if self._refused == self.REFUSALS else None

    @staticmethod
    def _flags(flags: int) -> Message | None:
        if flags & _FLAG_PASSIVE:
            return _error(*ERROR_PASSIVE_FRAME)
        return _error(*BUS_ERROR_FRAME) if flags & _FLAG_BUS_ERROR else None


def _error(identifier: int, data: bytes) -> Message:
    return Message(
        timestamp=time.time(),
        arbitration_id=identifier,
        is_extended_id=True,
        is_error_frame=True,
        data=data,
    )
