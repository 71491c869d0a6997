"""Readers of traces in columns: tables with a header, and what CanKing prints."""

from __future__ import annotations

import csv
import re
from base64 import b64decode
from binascii import Error as Base64Error
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime
from itertools import chain, islice

from twin.devices.akd.trace_files.frames import (
    LARGEST_STANDARD,
    LOOKAHEAD_LINES,
    Notes,
    TracedFrame,
    classic_frame,
)

_COLUMN_PATTERNS = {
    "time": r"(abs)?time(stamp)?s?(epoch|s|ms|us|µs|ns|sec|seconds|abs|rel)?",
    "identifier": r"(can|msg|message|arb)?(id|identifier)(hex|dec)?|arbitrationid|addr(ess)?",
    "extended": r"(is)?ext(ended)?|xtd|ide",
    "remote": r"remote|rtr",
    "error": r"er(ror)?",
    "way": r"dir(ection)?|rxtx|tx",
    "channel": r"bus|chan(nel)?|chn|can(bus|channel)?|network",
    "flags": r"flags",
    "fd": r"(is)?fdf?|edl",
    "length": r"len(gth)?|dlc",
    "kind": r"type",
    "data": r"data(bytes)?(hex)?|payload",
}
"""Columns of a table of frames, by their names in small letters without signs and spaces."""
_BYTE_COLUMN = re.compile(r"(?:d|b|data|byte)(\d)")
_TRUE_WORDS = {"1", "true", "yes", "x", "t"}
_KVASER_REMOTE, _KVASER_EXTENDED, _KVASER_ERROR, _KVASER_SENT = 0x01, 0x04, 0x20, 0xC0
"""Flags of a frame of Kvaser's CANlib, a number in the column of flags."""
_LOGGER_EXTENDED, _LOGGER_SENT = 1, 8
"""Bits of the type of a frame of the loggers CL1000 and CL2000."""
_TIME_UNITS_S = {"ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}
"""Units of times in the name of their column, in s."""


def _column_places(line: str) -> tuple[dict[str, int], list[int], str]:
    """Places of the columns of a header, those of single bytes, and what separates columns."""
    separator = max(",;\t", key=line.count)
    names = [re.sub(r"[^a-z0-9µ]", "", cell.lower()) for cell in line.split(separator)]
    found = {
        role: k
        for role, pattern in reversed(_COLUMN_PATTERNS.items())
        for k, name in reversed(list(enumerate(names)))
        if re.fullmatch(pattern, name)
    }
    return found, [k for k, name in enumerate(names) if _BYTE_COLUMN.fullmatch(name)], separator


def is_table(line: str) -> bool:
    """Whether a line is a header that names time, identifier and data."""
    found, single, _ = _column_places(line)
    return {"time", "identifier"} <= set(found) and ("data" in found or bool(single))


def read_table(lines: Iterable[str], notes: Notes) -> Iterator[TracedFrame | None]:
    """A table with a header: python-can's, SavvyCAN's (GVRET), Kvaser's, and others like them."""
    rows = iter(lines)
    header, logger = "", False
    for line in rows:
        logger |= line.startswith("# Logger type:")
        if is_table(line):
            header = line
            break
    places, single, separator = _column_places(header)
    if not header:
        notes.remarks.append("has no header that names time, identifier and data")
        return
    split = (
        [cell.strip().strip('"') for cell in line.rstrip("\r\n").split(separator)]
        for line in rows
        if line.strip()
    )
    cells = list(islice(split, LOOKAHEAD_LINES))
    if not logger:
        places.pop("kind", None)
    name = header.split(separator)[places["time"]].lower()
    packed = "arbitration_id" in header  # python-can: bytes in base64
    if packed:
        notes.form = "python-can's table"
    whole = all("." not in row[places["time"]] for row in cells[:100] if len(row) > places["time"])
    scale = next((each for unit, each in _TIME_UNITS_S.items() if unit in name), 1.0)
    if whole and re.fullmatch(r"\W*time\W*stamp\W*", name) and not packed:
        scale = 1e-6  # GVRET
    elif whole and not packed and re.fullmatch(r"\W*time\W*", name):
        notes.remarks.append("its times are whole numbers without a unit: taken as seconds")
    at = places["identifier"]
    given = [each for row in cells for k in single for each in row[k : k + 1]]
    data_base = 10 if any(len(each) > 2 for each in given if each.isdecimal()) else 16
    base = 16 if packed else _base([row[at] for row in cells if len(row) > at], header, data_base)
    if base == 10 and not _looks_hexadecimal(given):
        data_base = 10
    for row in chain(cells, split):
        try:
            time = row[places["time"]]
            seconds = _logger_time(time) if logger else scale * _number_of(time)
            yield _table_row(row, places, single, seconds, (base, data_base), packed=packed)
        except (IndexError, ValueError, Base64Error):
            yield None


def _table_row(
    row: list[str],
    places: dict[str, int],
    single: list[int],
    time: float,
    bases: tuple[int, int],
    *,
    packed: bool,
) -> TracedFrame | None:
    def cell(role: str) -> str:
        return row[places[role]].strip().lower() if role in places else ""

    if cell("fd") in _TRUE_WORDS:
        return None
    flags = int(cell("flags")) if cell("flags").isdecimal() else 0
    kind = int(cell("kind") or 0)
    error = cell("error") in _TRUE_WORDS or bool(flags & _KVASER_ERROR)
    remote = cell("remote") in _TRUE_WORDS or bool(flags & _KVASER_REMOTE)
    extended = cell("extended") in _TRUE_WORDS or bool(
        flags & _KVASER_EXTENDED or kind & _LOGGER_EXTENDED
    )
    if packed:
        data = b64decode(row[places["data"]], validate=True)
    elif single:
        given = sum(1 for k in single if row[k : k + 1] not in ([], [""]))
        count = int(cell("length")) if "length" in places else given
        data = bytes(int(row[k], bases[1]) for k in single[:count] if row[k])
        if len(data) != count and not remote:
            return None
    else:
        data = bytes.fromhex(re.sub(r"0x|[|,]", "", cell("data")))
    text = cell("identifier").removesuffix("h")
    identifier = int(text.rstrip("x"), bases[0])
    return classic_frame(
        time,
        identifier & ((1 << 29) - 1),
        b"" if remote else data,
        extended=extended or identifier > LARGEST_STANDARD,
        remote=int(cell("length") or 0) if remote else None,
        error=error,
        sent=cell("way")[:1] in {"t", "1"} or bool(flags & _KVASER_SENT or kind & _LOGGER_SENT),
        channel=cell("channel") or None,
    )


def _number_of(text: str) -> float:
    """A time: a number, with a point or a comma, a time of day, or a date with one."""
    text = text.strip().replace(",", ".")
    try:
        return float(text)
    except ValueError:
        day = f"1970-01-01 {text}" if text[2:3] == ":" else text
        date = datetime.fromisoformat(day)
        return (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp()


def _logger_time(text: str) -> float:
    """The time of a logger, s: at most year, month, day, hour, minute, second, and always ms."""
    digits = re.sub(r"\D", "", text).rjust(17, "0")
    month, day, hour, minute, second = (int(digits[k : k + 2]) for k in range(4, 14, 2))
    date = datetime(int(digits[:4]) or 1970, month or 1, day or 1, tzinfo=UTC)
    return date.timestamp() + 3600 * hour + 60 * minute + second + int(digits[14:]) / 1000


def _looks_hexadecimal(cells: Iterable[str]) -> bool:
    return any(re.search(r"[a-fA-Fx]", each) or re.match(r"0\d", each) for each in cells)


def _base(identifiers: list[str], header: str, of_data: int = 16) -> int:
    """The base of identifiers: 16 where they or the header say so, or where 10 does not fit.

    Args:
        identifiers: As they stand in the file.
        header: Names of the columns.
        of_data: The base of the bytes, 10 if they are no hexadecimal ones.
    """
    some = identifiers[:2000]
    if _looks_hexadecimal(some) or re.search(r"id\W*\(?hex", header, re.IGNORECASE):
        return 16
    if of_data == 10:
        return 10
    digits = [each for each in some if each.isdecimal()]
    as_hex = max((int(each, 16) for each in digits), default=0)
    return 10 if as_hex > LARGEST_STANDARD >= max((int(each) for each in digits), default=0) else 16


SALEAE_HEADER = re.compile(r"name,type,start_time,duration,(?=.*\bidentifier\b)")
"""The first line of a table of Saleae Logic 2 with frames of CAN, of which each field is a row."""


def read_saleae(lines: Iterable[str], _: Notes) -> Iterator[TracedFrame | None]:
    """Reader of Saleae's table: rows of the type ``identifier_field``, ``data_field``, ..."""
    fields: list[dict[str, str]] = []
    for row in chain(csv.DictReader(lines), [{"type": "identifier_field"}]):
        if row.get("type") in {"identifier_field", "can_error"}:
            if fields:
                yield _saleae_frame(fields)
            fields = [row]
        elif fields:
            fields.append(row)


def _saleae_frame(fields: list[dict[str, str]]) -> TracedFrame | None:
    """The frame of an identifier's row and those after it, or of an error's; None if one is bad."""
    first = fields[0]
    try:
        time, channel = _number_of(first["start_time"]), first["name"]
        if first["type"] == "can_error":
            return classic_frame(time, 0, b"", error=True, channel=channel)
        lengths = [each["num_data_bytes"] for each in fields if each["type"] == "control_field"]
        length = int(lengths[0], 0) if lengths else 0
        return classic_frame(
            time,
            int(first["identifier"], 0),
            bytes(int(each["data"], 0) for each in fields if each["type"] == "data_field"),
            extended=first.get("extended") == "true",
            remote=length if first.get("remote_frame") == "true" else None,
            channel=channel,
            stated=length,
        )
    except (AttributeError, KeyError, TypeError, ValueError):
        return None


def read_kvaser(lines: Iterable[str], _: Notes) -> Iterator[TracedFrame | None]:
    """Reader of Kvaser's CanKing: channel, identifier, flag, length, data, time, direction."""
    rows = (line.split() for line in lines if re.match(r"\s*\d+\s", line))
    first = list(islice(rows, LOOKAHEAD_LINES))
    base = _base([row[1] for row in first if len(row) > 1], "")
    for row in chain(first, rows):
        try:
            flag = "" if row[2].isdecimal() else row[2].upper()
            rest = row[3 if flag else 2 :]
            length, remote = int(rest[0]), "R" in flag
            data = b"" if remote else bytes(int(each, base) for each in rest[1 : 1 + length])
            time, way = rest[1 + len(data) : 3 + len(data)]
            identifier = int(row[1], base)
            yield classic_frame(
                float(time),
                identifier,
                data,
                extended="X" in flag or identifier > LARGEST_STANDARD,
                remote=length if remote else None,
                error="E" in flag,
                sent=way.upper().startswith("T"),
                channel=row[0],
                stated=length,
            )
        except (IndexError, ValueError):
            yield None
