"""Readers of the two forms of candump: the log (-L, -l) and the lines on a terminal.

python-can reads the log alone, and of it error frames as data frames with a 29-bit identifier.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from datetime import datetime

from twin.devices.akd.trace_files.frames import (
    ERROR_FLAG,
    LARGEST_STANDARD,
    Notes,
    TracedFrame,
    classic_frame,
)

_TIME_PATTERN = r"(?:\((?:(\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d+)|(-?\d+\.?\d*))\)\s+)?"
"""A date or seconds in brackets, if there is a time."""
LOG_LINE = re.compile(
    rf"\s*{_TIME_PATTERN}(?:([^\s#]+)\s+)?([0-9A-Fa-f]{{3}}|[0-9A-Fa-f]{{8}})#"
    r"(?:([Rr])(\d?)|((?:[0-9A-Fa-f]{2}\.?){0,8}))(?:_[0-9A-Fa-f])?(?:\s+([RrTt]))?\s*$"
)
_DROPPED_FRAMES = re.compile(r"DROPCOUNT: dropped (\d+) CAN frame")
"""A line of ``candump -d``: frames that the socket lost."""
_MIN_SMALL_SHARE, _MIN_LARGEST_SHARE, _MIN_HALVED_SHARE = 0.1, 0.5, 0.1
"""Least share of small times, of times that equal the largest, and of times less than half of the
one before, among differences of time."""


class _Dropped:
    """Counts the frames that candump reports as dropped."""

    def __init__(self) -> None:
        self.count = 0

    def is_in(self, line: str) -> bool:
        """Whether a line is such a report; it is then counted."""
        match = _DROPPED_FRAMES.match(line)
        self.count += int(match[1]) if match else 0
        return match is not None

    def note(self, notes: Notes) -> None:
        """Add a remark if there were any."""
        if self.count:
            notes.remarks.append(f"candump reports {self.count} dropped frames (DROPCOUNT)")


_PLAIN_TIME = re.compile(r"\(\d+\.\d{6}")
_SHORT_TIME = re.compile(r"\s*\(\d{3}\.\d{6,9}\)")
"""A time since the first frame or the one before (-tz, -td), which has leading zeros."""
_PLAIN_HEAD = re.compile(r" +(\S+) ([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})")
"""The beginning of a line of a log as candump prints it, and what then stands before the data."""
_RECEIVED_MARKS = {"": True, "R": True, "T": False}
"""Whether a frame was received, by what stands behind its data."""


def read_candump_log(lines: Iterable[str], notes: Notes) -> Iterator[TracedFrame | None]:
    """Reader of ``candump -L``: ``(1.5) can0 701#05 R``, with times as on a terminal.

    Data frames in the form that candump itself prints are read without a regular expression for the
    whole line, in half the time.
    """
    dropped, short = _Dropped(), True
    heads = dict[str, tuple[str, int, bool, bool] | None]()
    frames = list[TracedFrame | None]()
    for line in lines:
        before, _, after = line.partition("#")
        time, _, head = before.partition(")")
        text, _, way = after.rstrip().partition(" ")
        known = heads[head] if head in heads else heads.setdefault(head, _read_head(head))
        data = _read_bytes(text)
        if known and data is not None and way in _RECEIVED_MARKS and _PLAIN_TIME.fullmatch(time):
            channel, number, extended, error = known
            received = _RECEIVED_MARKS[way]
            frame: TracedFrame | None = TracedFrame(
                float(time[1:]), number, data, extended, False, error, received, len(data), channel
            )
        elif match := LOG_LINE.match(line):
            frame = _log_frame(match)
        elif line.strip() and not dropped.is_in(line):
            frame = None
        else:
            continue
        short = short and (frame is None or _SHORT_TIME.match(line) is not None)
        frames.append(frame)
    _settle_times(frames, notes, short=short)
    dropped.note(notes)
    yield from frames


def _settle_times(frames: list[TracedFrame | None], notes: Notes, *, short: bool = True) -> None:
    """Number frames if most have no times, and add up times that count from the frame before.

    Args:
        frames: The frames, those without a time at NaN; changed in place.
        notes: Is given a remark on each change.
        short: Whether times may count from the frame before.
    """
    there = [each for each in frames if each is not None]
    timed = [each for each in there if not math.isnan(each.timestamp)]
    if 2 * len(timed) < len(there):
        notes.timed = False
        notes.remarks.append("has no times: frames are numbered in their place")
        for number, each in enumerate(there):
            each.timestamp = float(number)
    elif short and _are_differences([each.timestamp for each in timed]):
        notes.remarks.append("has times from frame to frame (candump -td): they are added up")
        passed = 0.0
        for each in timed:
            each.timestamp = passed = passed + each.timestamp


def _seconds_of(day: str | None, seconds: str | None) -> float:
    """A time in s by its date or its seconds; NaN without both, or with a date that is none."""
    if day is None:
        return float(seconds or math.nan)
    try:
        return datetime.fromisoformat(day).timestamp()
    except ValueError:
        return math.nan


def _read_head(text: str) -> tuple[str, int, bool, bool] | None:
    """Channel and identifier, as ``_read_identifier`` has it; None if a text is anything else."""
    match = _PLAIN_HEAD.fullmatch(text)
    if match is None:
        return None
    number, extended, error = _read_identifier(match[2])
    valid = extended or error or number <= LARGEST_STANDARD
    return (match[1], number, extended, error) if valid else None


def _read_bytes(text: str) -> bytes | None:
    """At most eight bytes of pairs of hexadecimal digits; None if a text is anything else."""
    try:
        found = bytes.fromhex(text)
    except ValueError:
        return None
    return found if 2 * len(found) == len(text) <= 16 else None


def _read_identifier(text: str) -> tuple[int, bool, bool]:
    """An identifier of three or eight digits: number, whether of 29 bits, whether of an error."""
    number, long = int(text, 16), len(text) == 8
    error = long and bool(number & ERROR_FLAG)
    return number & (ERROR_FLAG - 1), long and not error, error


def _log_frame(match: re.Match[str]) -> TracedFrame | None:
    """The frame of a line of any form that python-can or candump write."""
    day, seconds, channel, text, remote, asked, data, way = match.groups()
    number, extended, error = _read_identifier(text)
    return classic_frame(
        _seconds_of(day, seconds),
        number,
        bytes.fromhex((data or "").replace(".", "")),
        extended=extended,
        remote=int(asked or 0) if remote else None,
        error=error,
        sent=way in {"T", "t"},
        channel=channel,
    )


_COLOUR_CODES = re.compile(r"\x1b\[[0-9;]*m")
"""Escape sequences that colour a line on a terminal (candump -c)."""


def without_colours(line: str) -> str:
    """A line without the marks that colour it on a terminal."""
    return _COLOUR_CODES.sub("", line)


TERMINAL_LINE = re.compile(
    rf"\s*{_TIME_PATTERN}(?:(\S+)\s+)?"
    r"(?:([RT]X)\s\S\s\S\s+)?([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})\s+[\[{](\d\d|[0-9A-F])[\]}]\s*(.*)$"
)


def read_candump_terminal(lines: Iterable[str], notes: Notes) -> Iterator[TracedFrame | None]:
    """Reader of candump's output on a terminal: ``(1.5)  can0  RX - -  701   [1]  05``.

    The channel may be missing, as where parts of lines were copied. Times may be absolute (-ta,
    -tA), since the first frame (-tz), from frame to frame (-td, which are added up), or missing:
    then frames are numbered.
    """
    frames, dropped = list[TracedFrame | None](), _Dropped()
    for line in lines:
        # a line with a tab before it (candump -e) explains the error frame above
        if not line.strip() or line.startswith("\t") or dropped.is_in(line):
            continue
        row = TERMINAL_LINE.match(without_colours(line))
        frames.append(row and _terminal_frame(row))
    _settle_times(frames, notes)
    dropped.note(notes)
    yield from frames


def _are_differences(times: list[float]) -> bool:
    """Whether times count from the frame before, not from the first.

    Both begin with 0, unless a part is cut out of a trace. Times from the first frame grow: hardly
    any is smaller than the one before or than half of the largest so far, and few are the largest.
    Differences are so often. In a part that does not begin with 0 only times of less than half of
    the one before are differences: two recordings in one file have one such step.
    """
    before, largest, small, halved = 0.0, 0.0, 0, 0
    for time in times:
        small += time < before or time < 0.5 * largest
        halved += time < 0.5 * before
        before, largest = time, max(largest, time)
    if times[:1] != [0.0]:
        return halved > max(1.0, _MIN_HALVED_SHARE * len(times))
    many = small > _MIN_SMALL_SHARE * len(times)
    even = largest > 0.0 and times.count(largest) > _MIN_LARGEST_SHARE * len(times)
    return many or even


def _terminal_frame(row: re.Match[str]) -> TracedFrame | None:
    """The frame of a line, with the time that it has."""
    day, seconds, channel, way, identifier, length, rest = row.groups()
    time = _seconds_of(day, seconds)
    if len(length) > 1:  # of CAN FD
        return None
    number, extended, error = _read_identifier(identifier)
    size = min(8, int(length, 16))  # {9} and more: candump -8
    remote = size if "remote request" in rest else None
    data = b"" if remote is not None else _terminal_bytes(rest, size)
    if data is None:
        return None
    return classic_frame(
        time,
        number,
        data,
        extended=extended,
        remote=remote,
        error=error,
        sent=way == "TX",
        channel=channel,
    )


def _terminal_bytes(text: str, size: int) -> bytes | None:
    """So many bytes at the beginning of a text; None if there are fewer.

    They are hexadecimal, binary (candump -i), or hexadecimal with the last one first (candump -S).
    """
    words = text.split(maxsplit=size)[:size]
    if size > 1 and words and words[0].count("`") == size - 1:
        words = words[0].split("`")[::-1]
    try:
        if words and len(words[0]) == 8:
            data = bytes(int(word, 2) for word in words)
        else:
            data = bytes.fromhex(" ".join(words))
    except ValueError:
        return None
    return data if len(data) == size else None
