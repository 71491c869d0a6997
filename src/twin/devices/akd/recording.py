"""Frames of a CAN bus in use: passed on as they are sent and received, and written into files.

The formats are those of python-can by the file's ending, and candump's text (`.log`) in parts of
bounded size. `traces` reads them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import can

from twin.devices.akd import TRACE_FILE
from twin.devices.akd.trace_files.frames import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG
from twin.devices.akd.traces import SEAL_FILE, part_of, parts

Hear = Callable[[can.Message], None]
"""Called with every frame, its time in s and whether it was received; must not wait."""


class TracedBus(can.BusABC):
    """A bus that also hands every frame, sent or received, to a function.

    Args:
        bus: The open bus.
        hear: Who is given the frames.
        clock: Time in s of frames that carry none of their own.
    """

    def __init__(self, bus: can.BusABC, hear: Hear, clock: Callable[[], float] = time.time) -> None:
        super().__init__(channel=bus.channel_info)
        self._bus, self._hear, self._clock = bus, hear, clock

    def __getattr__(self, name: str) -> Any:
        """What only some buses have, as those that queue frames."""
        return getattr(self._bus, name)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame, or queue it as the bus does."""
        self._bus.send(msg, timeout)
        msg.timestamp, msg.is_rx = self._clock(), False
        self._hear(msg)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next frame; a time of a different clock is replaced by the time of this one."""
        message = self._bus.recv(timeout)
        if message is not None and message.is_rx:
            now = self._clock()
            if not message.timestamp or abs(message.timestamp - now) > 1.0:
                message.timestamp = now
            self._hear(message)
        return message

    def shutdown(self) -> None:
        """Close the bus."""
        super().shutdown()
        self._bus.shutdown()


_SENT_FLAG = 1 << 32
"""Flag of a frame that was sent, above those of SocketCAN."""

FRAME_COLUMNS = ("time", "identifier", "length", "low", "high")
"""The numbers that ``to_row`` returns."""


def to_row(message: can.Message) -> tuple[float, float, float, float, float]:
    """A classic frame as numbers: time in s, identifier with flags, length, two halves of data."""
    mark = message.arbitration_id | message.is_extended_id * EXTENDED_FLAG
    mark |= message.is_remote_frame * REMOTE_FLAG | message.is_error_frame * ERROR_FLAG
    data = message.data[:8]
    halves = int.from_bytes(data[:4], "little"), int.from_bytes(data[4:], "little")
    return (message.timestamp, mark | (not message.is_rx) * _SENT_FLAG, message.dlc, *halves)


def from_row(time: float, mark: float, length: float, low: float, high: float) -> can.Message:
    """The frame that ``to_row`` made numbers of."""
    data = int(low).to_bytes(4, "little") + int(high).to_bytes(4, "little")
    flags = int(mark)
    return can.Message(
        timestamp=time,
        arbitration_id=flags & (ERROR_FLAG - 1),
        is_extended_id=bool(flags & EXTENDED_FLAG),
        is_remote_frame=bool(flags & REMOTE_FLAG),
        is_error_frame=bool(flags & ERROR_FLAG),
        is_rx=not flags & _SENT_FLAG,
        dlc=int(length),
        data=None if flags & REMOTE_FLAG else data[: int(length)],
    )


class TraceWriter:
    """Writes frames into a file, or, bounded, into parts of which the first and two last stay.

    Args:
        file: The file; its folder is made if missing.
        channel: What the bus is called in it.
        part: Bytes of a part; None for one file without bound.
    """

    def __init__(self, file: Path, channel: str, part: int | None = None) -> None:
        self._file, self._channel, self._part = file, channel, part
        self._number = 0
        for old in parts(file):
            old.unlink()
        if file.name == TRACE_FILE:
            file.with_name(SEAL_FILE).unlink(missing_ok=True)
        file.parent.mkdir(parents=True, exist_ok=True)
        self._logger = can.Logger(file, channel=channel)

    def write(self, messages: Iterable[can.Message]) -> None:
        """Append frames; text is handed to the system before this returns."""
        for message in messages:
            message.channel = self._channel
            if message.is_error_frame and isinstance(self._logger, can.CanutilsLogWriter):
                # python-can would write each as a bus error, also one of bus-off
                mark, data = ERROR_FLAG | message.arbitration_id, message.data.hex().upper()
                line = f"({message.timestamp:f}) {self._channel} {mark:08X}#{data}\n"
                self._logger.file.write(line)
                continue
            self._logger(message)
        text = getattr(self._logger, "file", None)
        if text is not None:
            text.flush()
        if self._part and part_of(self._file, self._number).stat().st_size > self._part:
            self._logger.stop()
            self._number = 2 if self._number == 1 else 1  # the older of both is written over
            self._logger = can.Logger(part_of(self._file, self._number), channel=self._channel)

    def close(self) -> None:
        """End the file."""
        self._logger.stop()


@contextmanager
def append_trace(
    _: Sequence[str], file: Path, part: int | None
) -> Iterator[Callable[[Mapping[str, Any]], None]]:
    """Write a trace; what is given ``FRAME_COLUMNS``, shape (K,) each, appends their frames."""
    with closing(TraceWriter(file, "can0", part)) as writer:
        yield lambda block: writer.write(map(from_row, *(each.tolist() for each in block.values())))
