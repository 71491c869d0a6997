"""Readers of CAN traces of other programs, each by the form of its lines.

`read_frames` finds out by the first bytes and lines of a file which program wrote it; the ending of
its name decides only where they say nothing. A line that is no frame costs itself. Formats in
packed bytes are read by python-can, but for captures. Text is read here: python-can takes both
kinds of times of an ``.asc`` for absolute, has no reader for some of these forms, and gives up at
the first line that it does not know. Nothing here imports python-can before it is needed.
"""

from __future__ import annotations

import gzip
import io
import math
import re
import zlib
from collections.abc import Callable, Iterable, Iterator
from itertools import chain, islice
from pathlib import Path
from typing import BinaryIO, cast

from twin.base.errors import one_line
from twin.base.foreign import HEAD_BYTES, encoding_of, file_kind, with_article
from twin.devices.akd.trace_files import captures, packed, tables, text
from twin.devices.akd.trace_files.candump import (
    LOG_LINE,
    TERMINAL_LINE,
    read_candump_log,
    read_candump_terminal,
    without_colours,
)
from twin.devices.akd.trace_files.frames import Notes, TracedFrame

__all__ = ["Notes", "TracedFrame", "read_frames"]

_FORM_LINES = 60
"""Lines at the beginning of a text by which its form is known."""


def read_frames(file: Path, notes: Notes) -> Iterator[TracedFrame]:
    """The classic frames of a file, in its order.

    Args:
        file: The file, which may be compressed by gzip.
        notes: Collects remarks about the file.
    """
    number = 0
    try:
        with _open_packed(file) as raw:
            for message in _frames(file, raw, notes):
                number += 1
                yield message
    except Exception as error:  # noqa: BLE001  readers raise whatever a broken file makes them
        notes.remarks.append(f"cannot be read on after frame {number}: {one_line(error)}")


def _open_packed(file: Path) -> BinaryIO:
    with file.open("rb") as raw:
        packed = raw.read(2) == b"\x1f\x8b"
    return cast("BinaryIO", gzip.open(file)) if packed else file.open("rb")


def _frames(file: Path, raw: BinaryIO, notes: Notes) -> Iterator[TracedFrame]:
    head = cast("io.BufferedReader", raw).read1(HEAD_BYTES + 16)  # of a cut file what there is
    raw.seek(0)
    kind = file_kind(head)
    if kind in _PACKED_READERS:
        notes.form, reader = _PACKED_READERS[kind]
        yield from _classic(reader(raw, file, notes), notes)
    elif kind:
        notes.remarks.append(f"is {with_article(kind)}, no trace of a CAN bus")
    else:
        ending = (file.with_suffix("") if file.suffix == ".gz" else file).suffix.lower()
        with io.TextIOWrapper(raw, encoding_of(head), errors="replace") as lines:
            plain = _until_broken(lines, notes)
            beginning = list(islice(plain, _FORM_LINES))
            notes.form, text_reader = _form(beginning, ending)
            yield from _classic(text_reader(chain(beginning, plain), notes), notes)


def _until_broken(lines: Iterable[str], notes: Notes) -> Iterator[str]:
    """The lines of a text, up to where it is cut or what is packed is broken.

    A last line without its end is left out: a part of a line may look like a whole one.
    """
    number = 0
    try:
        for number, line in enumerate(lines, 1):
            if not line.endswith("\n") and line.strip():
                notes.remarks.append(f"ends within line {number}, which is left out")
                return
            yield line
    except (EOFError, OSError, zlib.error) as error:
        notes.remarks.append(f"cannot be read on after line {number}: {one_line(error)}")


def _classic(frames: Iterable[TracedFrame | None], notes: Notes) -> Iterator[TracedFrame]:
    """Only the frames at a finite time; others, and lines that are none (None), are counted."""
    for frame in frames:
        if frame is None or not math.isfinite(frame.timestamp):
            notes.left_out += 1
        else:
            yield frame


_Packed = Callable[[BinaryIO, Path, Notes], Iterator[TracedFrame | None]]
_Text = Callable[[Iterable[str], Notes], Iterator[TracedFrame | None]]
_PACKED_READERS: dict[str, tuple[str, _Packed]] = {
    "CAN trace of Vector (.blf)": ("BLF", packed.read_blf),
    "SQLite database": ("python-can's database", packed.read_database),
    "measurement file (.mf4)": ("MF4", packed.read_mf4),
    "pcapng capture": ("pcapng", captures.read_capture),
    "pcap capture": ("pcap", captures.read_capture),
}
"""Readers of packed files by what their first bytes say."""
_TEXT_READERS: dict[str, tuple[Callable[[str], object], _Text]] = {
    "candump -L": (LOG_LINE.match, read_candump_log),
    "BUSMASTER": (re.compile(r"\*\*\*BUSMASTER").match, text.read_busmaster),
    "PCAN-View": (
        re.compile(r";\$FILEVERSION|\s*\d+\)\s+\d|\s*\d+\s+\d+\.\d+\s+(DT|RR|ST)\s").match,
        text.read_trc,
    ),
    "Vector's ASC": (
        re.compile(r"\s*(base\s+(hex|dec)\b|begin triggerblock|date\s+\w+\s+\w+\s)", re.I).match,
        text.read_asc,
    ),
    "CanKing": (re.compile(r"\s*Chn\s+Identifier\s+Flg", re.I).match, tables.read_kvaser),
    "python-can's print": (text.PRINTED_LINE.match, text.read_printed),
    "Saleae's table": (tables.SALEAE_HEADER.match, tables.read_saleae),
    "a serial adapter": (text.SLCAN_LINE.match, text.read_slcan),
    "candump on a terminal": (TERMINAL_LINE.match, read_candump_terminal),
    "a table of frames": (tables.is_table, tables.read_table),
}
"""Forms of text: how one of their first lines is known, and their readers."""
_BY_ENDING = {".asc": "Vector's ASC", ".trc": "PCAN-View", ".csv": "a table of frames"}


def _form(beginning: list[str], ending: str) -> tuple[str, _Text]:
    """The form that a text has by its first lines, else by the ending of its name."""
    plain = [without_colours(line) for line in beginning]
    for form, (known, reader) in _TEXT_READERS.items():
        if any(known(line) for line in plain):
            return form, reader
    form = _BY_ENDING.get(ending, "candump -L")
    return form, _TEXT_READERS[form][1]
