"""Traces of a CAN bus: frames handed on while a bus is used, and files of them, of any program.

Written are the formats of python-can by the file's ending, and candump's text (`.log`) in parts of
bounded size. `trace_files` reads all of these, and those of other programs.
"""

from __future__ import annotations

import hashlib
import re
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import can

from twin.base.errors import LogError
from twin.base.writing import write_whole
from twin.devices.akd import TRACE_FILE
from twin.devices.akd.trace_files import Notes, read_frames

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
SEAL = "trace.sha256"
"""Checksums of the parts of a run's trace, beside them."""
_SEALED = re.compile(r"([0-9a-f]{64})  (trace(?:-[12])?\.log)")
"""A line of these."""
WRITTEN = (".asc", ".blf", ".csv", ".log", ".trc")
"""Endings of traces that are written; each but .blf, packed already, may be followed by .gz."""
_DISORDER = 0.01
"""Time in s by which frames of two clocks may lie in a wrong order."""
_CLOCK_STEPS = 3
"""How often a clock may be set back in a trace; more often its times are none."""
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
    flags = int(mark)
    return can.Message(
        timestamp=time,
        arbitration_id=flags & (_ERROR - 1),
        is_extended_id=bool(flags & _EXTENDED),
        is_remote_frame=bool(flags & _REMOTE),
        is_error_frame=bool(flags & _ERROR),
        is_rx=not flags & _SENT,
        dlc=int(length),
        data=None if flags & _REMOTE else data[: int(length)],
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
            file.with_name(SEAL).unlink(missing_ok=True)
        file.parent.mkdir(parents=True, exist_ok=True)
        self._logger = can.Logger(file, channel=channel)

    def write(self, messages: Iterable[can.Message]) -> None:
        """Append frames; text is handed to the system before this returns."""
        for message in messages:
            message.channel = self._channel
            if message.is_error_frame and isinstance(self._logger, can.CanutilsLogWriter):
                # python-can would write each as a bus error, also one that says bus-off
                mark, data = _ERROR | message.arbitration_id, message.data.hex().upper()
                line = f"({message.timestamp:f}) {self._channel} {mark:08X}#{data}\n"
                self._logger.file.write(line)
                continue
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
def append_trace(
    _: Sequence[str], file: Path, part: int | None
) -> Iterator[Callable[[Mapping[str, Any]], None]]:
    """Write a trace; what is given ``COLUMNS``, shape (K,) each, appends their frames."""
    with closing(TraceWriter(file, "can0", part)) as writer:
        yield lambda block: writer.write(map(from_row, *(each.tolist() for each in block.values())))


def _part(file: Path, number: int) -> Path:
    return file.with_name(f"{file.stem}-{number}{file.suffix}") if number else file


def parts(file: Path) -> list[Path]:
    """The parts of a trace that are there: the first, and in any order the last two."""
    numbers = range(3 if file.name == TRACE_FILE else 1)
    return [each for number in numbers if (each := _part(file, number)).is_file()]


def seal(file: Path) -> None:
    """Write the SHA-256 of each part of a finished trace, in the form of ``sha256sum``."""
    lines = [f"{_sha256(each)}  {each.name}\n" for each in parts(file)]
    write_whole(file.with_name(SEAL), "".join(lines))


def altered(file: Path) -> list[str]:
    """A line for each part of a run's trace that is not what ``seal`` found; none without it."""
    if file.name != TRACE_FILE:
        return []
    try:
        lines = file.with_name(SEAL).read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return []
    found = {each.name: each for each in parts(file)}
    known = [match.groups() for line in lines if (match := _SEALED.fullmatch(line))]
    if not known or len(known) < len(lines):
        return [f"{SEAL}: is damaged: whether the trace is whole is not known"]
    remarks = []
    for mark, name in known:
        part = found.pop(name, None)
        if part is None:
            remarks.append(f"{name}: is missing, or damaged with its checksum")
        elif _sha256(part) != mark:
            remarks.append(f"{name}: has changed since it was written, or is damaged")
    remarks += [f"{name}: was not there when the trace was finished" for name in found]
    return remarks


def _sha256(file: Path) -> str:
    with file.open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()


@dataclass
class Trace:
    """The frames of one channel, in the order of their times.

    Attributes:
        channel: What it is called.
        frames: Each with its time in s.
        remarks: What could not be read, or was left out, in a line each.
        timed: Whether the file has times; if not, the frames' numbers stand in their place.
    """

    channel: str
    frames: list[can.Message] = field(repr=False)
    remarks: list[str]
    timed: bool = True


def read_trace(path: Path, channel: str | None = None) -> Trace:
    """The frames of a trace.

    Args:
        path: A file of any form that `trace_files` knows.
        channel: Which channel; the one with most frames by default.

    Raises:
        LogError: If nothing in it can be read.
    """
    remarks = altered(path)
    frames: list[can.Message] = []
    files = parts(path)
    if not files:
        raise LogError(f"{path}: no such trace")
    timed = True
    for file in files:
        notes = Notes()
        frames.extend(read_frames(file, notes))
        remarks += [f"{file.name}: {each}" for each in notes.remarks]
        if notes.left_out:
            what = f"lines that are no classic frame of {notes.form}"
            remarks.append(f"{file.name}: left out: {notes.left_out} {what}")
        timed &= notes.timed
    if not frames:
        empty = not any(file.stat().st_size for file in files)
        why = f": {'; '.join(remarks) or ('it is empty' if empty else 'it has none')}"
        raise LogError(f"{path}: no frame can be read{why}")
    counts = Counter(_name(each) for each in frames)
    chosen = channel or counts.most_common(1)[0][0]
    if chosen not in counts:
        raise LogError(f"--channel {chosen}: not in {path}; there are {', '.join(counts)}")
    if len(counts) > 1:
        others = ", ".join(f"{name} ({n})" for name, n in counts.items() if name != chosen)
        remarks.append(f"channel {chosen} is told ({counts[chosen]} frames); others: {others}")
        frames = [each for each in frames if _name(each) == chosen]
    if timed:
        _set_in_order(frames, remarks, alone=len(files) == 1)
    return Trace(chosen, frames, remarks, timed)


def _set_in_order(frames: list[can.Message], remarks: list[str], *, alone: bool) -> None:
    """Set frames in the order of their times, where these may be believed.

    Frames of two clocks may be a little out of order, and whole parts of a file as well: they are
    sorted. Where times go back into what was already there, the order of the lines is the better
    witness: after a clock that steps back the later frames are moved on, and times that go back
    again and again do not go on for as long.

    Args:
        frames: The frames of one channel; changed in place.
        remarks: Is given a line of what was done.
        alone: Whether they are of one file, whose order says anything.
    """
    times = [each.timestamp for each in frames]
    steps = [k for k in range(1, len(times)) if times[k - 1] - times[k] > _DISORDER]
    spans = [
        (min(times[a:b]), max(times[a:b])) for a, b in pairwise((0, *steps, len(times))) if b > a
    ]
    spans.sort()
    apart = all(before[1] <= after[0] + _DISORDER for before, after in pairwise(spans))
    if not steps or apart or not alone:
        if steps and alone:
            back = max(times[k - 1] - times[k] for k in steps)
            remarks.append(
                f"time goes back, by up to {back:.3g} s; frames are told in order of time"
            )
        frames.sort(key=lambda each: each.timestamp)
        return
    back, most = max(times[k - 1] - times[k] for k in steps), max(times)
    if len(steps) <= _CLOCK_STEPS:
        moved = 0.0
        for k, each in enumerate(frames):
            moved += times[k - 1] - times[k] if k in steps else 0.0
            each.timestamp += moved
        how = "later frames are moved on by as much"
    else:
        newest = times[0]
        for each in frames:
            each.timestamp = newest = max(newest, each.timestamp)
        how = "frames are told in the order of their lines, and their times are not to be believed"
    often = "once" if len(steps) == 1 else f"{len(steps)} times"
    remarks.append(
        f"time goes back {often}, by up to {back:.3g} s of {most - min(times):.3g}: {how}"
    )
    if len(steps) <= _CLOCK_STEPS:
        frames.sort(key=lambda each: each.timestamp)


def _name(message: can.Message) -> str:
    return str(message.channel if message.channel is not None else "can")
