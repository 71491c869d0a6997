"""The CAN bus: opened by name, sent to and read in mid-run, where nothing raises.

Of serial-line adapters (LAWICEL protocol) python-can's own bus reads byte by byte, waits a
millisecond when nothing is there, ends a drain at every acknowledgement, and never polls the
adapter's status flags. The one here differs in just that, and writes all frames of a period in one
piece; opening, bit rate and closing are the library's.

Frames are handed on while a bus is used, and traces, files of them of any program, are read.
Written are the formats of python-can by the file's ending, and candump's text (`.log`) in parts of
bounded size. Candump's text is read line by line, so that a broken line costs one frame.
"""

from __future__ import annotations

import errno
import logging
import os
import select
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import can
from can.exceptions import CanOperationError
from can.interfaces.slcan import slcanBus

from twin.devices.akd import TRACE, protocol
from twin.devices.akd import conditions as c
from twin.devices.akd.conditions import DriveError
from twin.devices.akd.config import BusConfig
from twin.devices.common import FaultReports, claim, in_words, one_line
from twin.errors import LogError, nearest

BUS_ERRORS = (can.CanError, OSError)
"""What python-can and the drivers below it raise when an adapter goes."""

ERROR_PASSIVE_FRAME = (0x004, bytes((0, 0x30, 0, 0, 0, 0, 0, 0)))
BUS_ERROR_FRAME = (0x080, bytes(8))
BUS_OFF_FRAME = (0x040, bytes(8))
"""Error frames, identifier and data, as SocketCAN writes them."""

_FLAG_PASSIVE, _FLAG_BUS_ERROR = 0x20, 0x80
_LAST_IDENTIFIER = 0x7FF


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
        # Not through pyserial, whose write waits, and times out even for bytes it has written.
        data = b"".join(line.encode("ascii") + self.LINE_TERMINATOR for line in self._unsent)
        self._unsent.clear()
        try:
            written = os.write(self.serialPortOrig.fileno(), data)
        except OSError as error:
            raise CanOperationError(f"adapter cannot be written: {error}") from error
        if written < len(data):
            raise CanOperationError("adapter takes no more bytes")

    def shutdown(self) -> None:
        """Close the channel and the port; an adapter that has gone is let go."""
        can.BusABC.shutdown(self)
        with suppress(CanOperationError):
            self._write("C")
        self.serialPortOrig.close()
        self._claim.close()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
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

    def _next_message(self) -> can.Message | None:
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

    def _decode(self, line: bytes) -> can.Message | None:
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
                return _message(identifier, bytes.fromhex(data[: 2 * length].decode("ascii")))
        except ValueError:
            pass
        self.unreadable_lines += 1
        return None

    def _refusal(self) -> can.Message | None:
        self._refused += 1
        off = self._refused == self.REFUSALS
        return _message(*BUS_OFF_FRAME, error=True) if off else None

    @staticmethod
    def _flags(flags: int) -> can.Message | None:
        if flags & _FLAG_PASSIVE:
            return _message(*ERROR_PASSIVE_FRAME, error=True)
        return _message(*BUS_ERROR_FRAME, error=True) if flags & _FLAG_BUS_ERROR else None


def _message(identifier: int, data: bytes, *, error: bool = False) -> can.Message:
    return can.Message(
        timestamp=time.time(),
        arbitration_id=identifier,
        is_extended_id=error,
        is_error_frame=error,
        data=data,
    )


_PASSIVE = 0x30
"""Bits of data byte 1 of SocketCAN's error frames that say that an adapter is error passive."""
_MOST = 400
"""Frames taken at one time; a flood must not hold up the loop."""
_BLOCKED = 5
"""Frames in a row that find no room to be sent before the bus counts as off."""


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
            if self._blocked >= _BLOCKED:
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
        unreadable = getattr(self._bus, "unreadable_lines", 0)
        if unreadable > self._unreadable:
            lines = f"{unreadable - self._unreadable} lines cannot be read"
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
            flags & _PASSIVE for flags in message.data[1:2]
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
    known = in_words("bus", _errno(error) or 0, channel=config.channel)
    if known is not None:
        return known
    if isinstance(error, (can.CanInterfaceNotImplementedError, ImportError, NameError)):
        return f"the driver of {config.interface} is not installed ({one_line(error)})"
    return one_line(error)


def _errno(error: BaseException | None) -> int | None:
    """The system's error number, wherever the libraries have wrapped it."""
    while error is not None:
        candidates = getattr(error, "errno", None), getattr(error, "error_code", None), *error.args
        number = next((each for each in candidates if isinstance(each, int)), None)
        if number is not None:
            return number
        error = error.__cause__ or error.__context__
    return None


def _bad(config: BusConfig, detail: str) -> DriveError:
    return DriveError(c.BAD_BUS, f"CAN {config}", detail)


Hear = Callable[[can.Message], None]
"""Is given every frame, with its time in s and whether it was received; must not wait."""


class TracedBus(can.BusABC):
    """A bus whose frames, sent and received, are also handed to somebody.

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
        """The next frame; one that carries the time of another clock is given this one's."""
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


PART = 20_000_000
"""Bytes of a part of a bounded trace: about two minutes of two drives at 500 Hz."""
WRITTEN = (".asc", ".blf", ".csv", ".log", ".trc")
"""Endings of traces that are written; each but .blf, packed already, may be followed by .gz."""
_DISORDER = 0.01
"""Time in s by which frames of two clocks may lie in a wrong order."""
_ERROR, _REMOTE, _EXTENDED, _SENT = 1 << 29, 1 << 30, 1 << 31, 1 << 32
"""Flags above an identifier, as SocketCAN has them; the last is ours."""


COLUMNS = ("time", "identifier", "length", "low", "high")
"""What ``to_row`` makes of a frame."""


def _format(file: Path) -> str:
    """The ending of a file, of one that is compressed the one before that."""
    return file.with_suffix("").suffix if file.suffix == ".gz" else file.suffix


def check_ending(file: Path) -> None:
    """Make sure that a trace can be written into a file of this name.

    Raises:
        LogError: If its ending is none that is known.
    """
    if _format(file) not in WRITTEN or file.name.endswith(".blf.gz"):
        endings = ", ".join(WRITTEN)
        raise LogError(
            f"--trace {file}: its ending must be one of {endings}, all but .blf also with .gz"
        )


def to_row(message: can.Message) -> tuple[float, float, float, float, float]:
    """A classic frame as numbers: time in s, identifier with flags, length, two halves of data."""
    mark = message.arbitration_id | message.is_extended_id * _EXTENDED
    mark |= message.is_remote_frame * _REMOTE | message.is_error_frame * _ERROR
    data = message.data[:8]
    halves = int.from_bytes(data[:4], "little"), int.from_bytes(data[4:], "little")
    return (message.timestamp, mark | (not message.is_rx) * _SENT, message.dlc, *halves)


def from_row(time: float, mark: float, length: float, low: float, high: float) -> can.Message:
    """The frame that ``to_row`` made numbers of."""
    data = int(low).to_bytes(4, "little") + int(high).to_bytes(4, "little")
    return _frame(time, int(mark), data[: int(length)], int(length))


def _frame(time: float, mark: int, data: bytes, length: int) -> can.Message:
    """A frame of its identifier with flags; as long as its data unless that is said."""
    return can.Message(
        timestamp=time,
        arbitration_id=mark & (_ERROR - 1),
        is_extended_id=bool(mark & _EXTENDED),
        is_remote_frame=bool(mark & _REMOTE),
        is_error_frame=bool(mark & _ERROR),
        is_rx=not mark & _SENT,
        dlc=length,
        data=None if mark & _REMOTE else data,
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
        file.parent.mkdir(parents=True, exist_ok=True)
        self._logger = can.Logger(file, channel=channel)

    def write(self, messages: Iterable[can.Message]) -> None:
        """Append frames; text is handed to the system before this returns."""
        for message in messages:
            message.channel = self._channel
            self._logger(message)
        text = getattr(self._logger, "file", None)
        if text is not None:
            text.flush()
        if self._part and _part(self._file, self._number).stat().st_size > self._part:
            self._logger.stop()
            self._number = 2 if self._number == 1 else 1  # the older of both is written over
            self._logger = can.Logger(_part(self._file, self._number), channel=self._channel)

    def close(self) -> None:
        """End the file."""
        self._logger.stop()


@contextmanager
def appended(
    _: Sequence[str], file: Path, part: int | None
) -> Iterator[Callable[[Mapping[str, Any]], None]]:
    """Write a trace; what is given ``COLUMNS``, shape (K,) each, appends their frames."""
    writer = TraceWriter(file, "can0", part)
    try:
        yield lambda block: writer.write(map(from_row, *(each.tolist() for each in block.values())))
    finally:
        writer.close()


def _part(file: Path, number: int) -> Path:
    return file.with_name(f"{file.stem}-{number}{file.suffix}") if number else file


def parts(file: Path) -> list[Path]:
    """The parts of a trace that are there: the first, and in any order the last two."""
    numbers = range(3 if file.name == TRACE else 1)
    return [each for number in numbers if (each := _part(file, number)).is_file()]


@dataclass
class Trace:
    """The frames of one channel, in the order of their times.

    Attributes:
        channel: What it is called.
        frames: Each with its time in s.
        remarks: What could not be read, or was left out, in a line each.
    """

    channel: str
    frames: list[can.Message] = field(repr=False)
    remarks: list[str]


def read_trace(path: Path, channel: str | None = None) -> Trace:
    """The frames of a trace.

    Args:
        path: A file that python-can reads; of other endings it is what ``candump -L`` writes.
        channel: Which channel; the one with most frames by default.

    Raises:
        LogError: If nothing in it can be read.
    """
    remarks: list[str] = []
    frames: list[can.Message] = []
    files = parts(path)
    if not files:
        raise LogError(f"{path}: no such trace")
    for file in files:
        frames.extend(_read(file, remarks))
    if not frames:
        why = f": {remarks[0]}" if remarks else ""
        raise LogError(f"{path}: no frame can be read{why}")
    counts = Counter(_name(each) for each in frames)
    chosen = channel or counts.most_common(1)[0][0]
    if chosen not in counts:
        raise LogError(f"--channel {chosen}: not in {path}; there are {', '.join(counts)}")
    if len(counts) > 1:
        others = ", ".join(f"{name} ({n})" for name, n in counts.items() if name != chosen)
        remarks.append(f"channel {chosen} is told ({counts[chosen]} frames); others: {others}")
        frames = [each for each in frames if _name(each) == chosen]
    back = max((a.timestamp - b.timestamp for a, b in pairwise(frames)), default=0.0)
    if back > _DISORDER and len(files) == 1:
        remarks.append(f"time goes back, by up to {back:.3g} s; frames are told in order of time")
    frames.sort(key=lambda each: each.timestamp)
    return Trace(chosen, frames, remarks)


def _name(message: can.Message) -> str:
    return str(message.channel if message.channel is not None else "can")


def _read(file: Path, remarks: list[str]) -> Iterator[can.Message]:
    """Frames as python-can reads them: past a line that it cannot read, in other files up to it."""
    number = bad = 0
    known = _format(file) in {".asc", ".blf", ".csv", ".db", ".log", ".mf4", ".trc"}
    try:
        with can.LogReader(file) if known else can.CanutilsLogReader(file) as reader:
            whole = False
            while not whole:
                try:
                    for message in reader:
                        if message.is_fd or len(message.data) > message.dlc:  # or half a byte
                            bad += 1
                            continue
                        number += 1
                        yield message
                    whole = True
                except ValueError:
                    if not isinstance(reader, can.CanutilsLogReader):
                        raise
                    bad += 1  # a line, and the reader begins with the next one
            if getattr(reader, "file_size", 0) > file.stat().st_size:  # as the head of a .blf says
                remarks.append(f"{file.name}: cut off, ends after frame {number}")
    except Exception as error:  # noqa: BLE001  readers raise whatever a broken file makes them
        remarks.append(f"{file.name}: cannot be read on after frame {number}: {one_line(error)}")
    if bad:
        remarks.append(
            f"{file.name}: left out: {bad} lines that are no classic frame of candump -L"
        )
