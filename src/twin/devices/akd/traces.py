"""Files of the frames of a CAN bus: their names, parts and checksums, and their frames in order.

`recording` writes them, `trace_files` has the readers of each format. Nothing here imports
python-can, which takes 0.2 s.
"""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

from twin.base.errors import LogError, plural
from twin.base.shipped import nearest_neighbour
from twin.base.writing import write_whole
from twin.devices.akd import TRACE_FILE
from twin.devices.akd.trace_files import Notes, TracedFrame, read_frames

PART_BYTES = 20_000_000
"""Bytes of a part of a bounded trace: about two minutes of two drives at 500 Hz."""
SEAL_FILE = "trace.sha256"
"""File with the checksums of the parts of a run's trace, in the same folder."""
_SEAL_LINE = re.compile(r"([0-9a-f]{64})  (trace(?:-[12])?\.log)")
"""A line of these."""
WRITTEN_SUFFIXES = (".asc", ".blf", ".csv", ".log", ".trc")
"""Endings of traces that are written; each but .blf, packed already, may be followed by .gz."""
_MAX_DISORDER_S = 0.01
"""Time in s by which frames of two clocks may lie in a wrong order."""
_CLOCK_STEPS = 3
"""How often a clock may be set back in a trace; more often its times are unreliable."""


def _format(file: Path) -> str:
    """The ending of a file, of one that is compressed the one before that."""
    return file.with_suffix("").suffix if file.suffix == ".gz" else file.suffix


def check_ending(file: Path) -> None:
    """Make sure that a trace can be written into a file of this name.

    Raises:
        LogError: If its ending is none that is known.
    """
    if _format(file) not in WRITTEN_SUFFIXES or file.name.endswith(".blf.gz"):
        endings = ", ".join(WRITTEN_SUFFIXES)
        raise LogError(
            f"--trace {file}: its ending must be one of {endings}, all but .blf also with .gz"
        )


def part_of(file: Path, number: int) -> Path:
    """The file of a part of a trace; the first has number 0 and the name of the trace."""
    return file.with_name(f"{file.stem}-{number}{file.suffix}") if number else file


def parts(file: Path) -> list[Path]:
    """The parts of a trace that are there: the first, and in any order the last two."""
    numbers = range(3 if file.name == TRACE_FILE else 1)
    return [each for number in numbers if (each := part_of(file, number)).is_file()]


def seal(file: Path) -> None:
    """Write the SHA-256 of each part of a finished trace, in the form of ``sha256sum``."""
    lines = [f"{_sha256(each)}  {each.name}\n" for each in parts(file)]
    write_whole(file.with_name(SEAL_FILE), "".join(lines))


def find_altered_parts(file: Path) -> list[str]:
    """A line for each part of a run's trace that is not what ``seal`` found; none without it."""
    if file.name != TRACE_FILE:
        return []
    try:
        lines = file.with_name(SEAL_FILE).read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return []
    found = {each.name: each for each in parts(file)}
    known = [match.groups() for line in lines if (match := _SEAL_LINE.fullmatch(line))]
    if not known or len(known) < len(lines):
        return [f"{SEAL_FILE}: is damaged: whether the trace is whole is not known"]
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
        channel: Its name.
        frames: Each with its time in s.
        remarks: Parts that are unreadable, left out or changed, in a line each.
        timed: Whether the file has times; if not, frames have their numbers instead.
    """

    channel: str
    frames: list[TracedFrame] = field(repr=False)
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
    remarks = find_altered_parts(path)
    frames: list[TracedFrame] = []
    files = parts(path)
    if not files:
        simulated = (path.parent / "run.parquet").is_file()
        why = "; only a run with --rig keeps one" if simulated else ""
        raise LogError(f"{path}: no such trace{nearest_neighbour(path) or why}")
    timed = True
    for file in files:
        notes = Notes()
        frames.extend(read_frames(file, notes))
        remarks += [f"{file.name}: {each}" for each in notes.remarks]
        if notes.left_out:
            lines = plural(notes.left_out, "line")
            remarks.append(
                f"{file.name}: left out: {lines} without a classic frame of {notes.form}"
            )
        timed &= notes.timed
    if not frames:
        empty = not any(file.stat().st_size for file in files)
        reasons = "; ".join(each.removeprefix(f"{path.name}: ") for each in remarks)
        why = reasons or ("it is empty" if empty else "it has none")
        raise LogError(f"{path}: no frame can be read: {why}")
    counts = Counter(_name(each) for each in frames)
    chosen = channel or counts.most_common(1)[0][0]
    if chosen not in counts:
        raise LogError(f"--channel {chosen}: not in {path}; there are {', '.join(counts)}")
    if len(counts) > 1:
        others = ", ".join(f"{name} ({n})" for name, n in counts.items() if name != chosen)
        remarks.append(
            f"channel {chosen} is shown ({plural(counts[chosen], 'frame')}); others: {others}"
        )
        frames = [each for each in frames if _name(each) == chosen]
    if timed:
        _set_in_order(frames, remarks, alone=len(files) == 1)
    return Trace(chosen, frames, remarks, timed)


def _set_in_order(frames: list[TracedFrame], remarks: list[str], *, alone: bool) -> None:
    """Set frames in the order of their times, as far as these are reliable.

    Frames of two clocks may be a little out of order, and whole parts of a file as well: they are
    sorted. Where times go back into a part that came before, the order of the lines is more
    reliable: after a clock that steps back the later frames are moved on by the step, and where
    times go back again and again, each frame has at least the time of those before it.

    Args:
        frames: The frames of one channel; changed in place.
        remarks: Is given a line on each change.
        alone: Whether all are of one file, so that their order means something.
    """
    times = [each.timestamp for each in frames]
    steps = [k for k in range(1, len(times)) if times[k - 1] - times[k] > _MAX_DISORDER_S]
    spans = [
        (min(times[a:b]), max(times[a:b])) for a, b in pairwise((0, *steps, len(times))) if b > a
    ]
    spans.sort()
    apart = all(before[1] <= after[0] + _MAX_DISORDER_S for before, after in pairwise(spans))
    if not steps or apart or not alone:
        if steps and alone:
            back = max(times[k - 1] - times[k] for k in steps)
            remarks.append(f"time goes back, by up to {back:.3g} s: frames are sorted by time")
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
        how = "frames stay in the order of their lines, and their times are unreliable"
    often = "once" if len(steps) == 1 else f"{len(steps)} times"
    remarks.append(
        f"time goes back {often}, by up to {back:.3g} s of {most - min(times):.3g}: {how}"
    )
    if len(steps) <= _CLOCK_STEPS:
        frames.sort(key=lambda each: each.timestamp)


def _name(message: TracedFrame) -> str:
    return str(message.channel if message.channel is not None else "can")
