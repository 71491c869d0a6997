"""Readers of CAN traces of other programs, each by the form of its lines.

`read_frames` finds out by the first bytes and lines of a file which program wrote it; the ending of
its name decides only where they say nothing. A line that is no frame costs itself. Formats in
packed bytes are read by python-can, text is read here: python-can takes both kinds of times of an
``.asc`` for absolute, has no reader for some of these forms, and gives up at the first line that it
does not know.
"""

from __future__ import annotations

import gzip
import io
import re
import struct
from base64 import b64decode
from binascii import Error as Base64Error
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from datetime import datetime
from itertools import chain, islice, pairwise
from pathlib import Path
from typing import BinaryIO, cast

import can

from twin.base.foreign import HEAD, encoding_of, file_kind, with_article
from twin.devices.common import one_line

_ERROR_FLAG, _REMOTE_FLAG, _EXTENDED_FLAG = 1 << 29, 1 << 30, 1 << 31
"""Flags above an identifier, as SocketCAN has them."""
_BUS_OFF, _BUS_ERROR, _CONTROLLER = 0x040, 0x080, 0x004
"""Classes of error frames, as SocketCAN has them."""
_STANDARD = 0x7FF
"""Largest identifier of 11 bits."""
_BEGINNING = 60
"""Lines at the beginning of a text by which its form is known."""
_DAY = 86400.0
_DAYS_TO_1970 = 25569
"""Days from the beginning of PCAN's calendar to that of Unix."""


@dataclass
class Notes:
    """What a reader has to say of a file.

    Attributes:
        form: What program's form it is.
        timed: Whether its frames have times.
        left_out: How many lines or frames were left out.
        remarks: Other remarks, in a line each.
    """

    form: str = ""
    timed: bool = True
    left_out: int = 0
    remarks: list[str] = field(default_factory=list)


def read_frames(file: Path, notes: Notes) -> Iterator[can.Message]:
    """The classic frames of a file, in its order.

    Args:
        file: The file, which may be compressed by gzip.
        notes: Is given what is to be said of it.
    """
    number = 0
    try:
        with _opened(file) as raw:
            for message in _frames(file, raw, notes):
                number += 1
                yield message
    except Exception as error:  # noqa: BLE001  readers raise whatever a broken file makes them
        notes.remarks.append(f"cannot be read on after frame {number}: {one_line(error)}")


def _opened(file: Path) -> BinaryIO:
    with file.open("rb") as raw:
        packed = raw.read(2) == b"\x1f\x8b"
    return cast("BinaryIO", gzip.open(file)) if packed else file.open("rb")


def _frames(file: Path, raw: BinaryIO, notes: Notes) -> Iterator[can.Message]:
    head = raw.read(HEAD + 16)
    raw.seek(0)
    kind = file_kind(head)
    if kind in _PACKED:
        notes.form, reader = _PACKED[kind]
        yield from _classic(reader(raw, file, notes), notes)
    elif kind:
        notes.remarks.append(f"is {with_article(kind)}, no trace of a CAN bus")
    else:
        ending = (file.with_suffix("") if file.suffix == ".gz" else file).suffix.lower()
        with io.TextIOWrapper(raw, encoding_of(head), errors="replace") as lines:
            beginning = list(islice(lines, _BEGINNING))
            notes.form, text_reader = _form(beginning, ending)
            yield from _classic(text_reader(chain(beginning, lines), notes), notes)


def _classic(frames: Iterable[can.Message | None], notes: Notes) -> Iterator[can.Message]:
    """Only the classic frames; others, and lines that are none (None), are counted."""
    for message in frames:
        if message is None or message.is_fd or len(message.data) > message.dlc:
            notes.left_out += 1
        else:
            yield message


def _message(
    time: float,
    identifier: int,
    data: bytes,
    *,
    extended: bool = False,
    remote: int | None = None,
    error: bool = False,
    sent: bool = False,
    channel: str | None = None,
) -> can.Message | None:
    """A classic frame; None if there is none of more than eight bytes or so large an identifier.

    Args:
        time: In s.
        identifier: Without flags.
        data: Its bytes.
        extended: Whether the identifier has 29 bits.
        remote: Length that a remote frame asks for; None for a frame of data.
        error: Whether it is an error frame.
        sent: Whether the program that wrote the trace sent it.
        channel: What the bus is called.
    """
    if len(data) > 8 or identifier >> 29 or not (extended or error or identifier <= _STANDARD):
        return None
    return can.Message(
        timestamp=time,
        arbitration_id=identifier,
        is_extended_id=extended,
        is_remote_frame=remote is not None,
        is_error_frame=error,
        is_rx=not sent,
        dlc=len(data) if remote is None else remote,
        data=data if remote is None else None,
        channel=channel,
    )


_LOG_LINE = re.compile(
    r"\s*\((-?\d+\.?\d*)\)\s+(\S+)\s+([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#"
    r"(?:([Rr])(\d?)|((?:[0-9A-Fa-f]{2}){0,8}))(?:_[0-9A-Fa-f])?(?:\s+([RrTt]))?\s*$"
)


def _read_candump_log(lines: Iterable[str], _: Notes) -> Iterator[can.Message | None]:
    """What ``candump -L`` writes: ``(1.5) can0 701#05 R``."""
    for line in lines:
        if not line.strip():
            continue
        match = _LOG_LINE.match(line)
        if match is None:
            yield None
            continue
        time, channel, identifier, remote, asked, data, way = match.groups()
        number = int(identifier, 16)
        error = len(identifier) == 8 and bool(number & _ERROR_FLAG)
        yield _message(
            float(time),
            number & (_ERROR_FLAG - 1),
            bytes.fromhex(data or ""),
            extended=len(identifier) == 8 and not error,
            remote=int(asked or 0) if remote else None,
            error=error,
            sent=way in {"T", "t"},
            channel=channel,
        )


_TERMINAL_LINE = re.compile(
    r"\s*(?:\((?:(\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d+)|(-?\d+\.\d+))\)\s+)?(\S+)\s+"
    r"(?:([RT]X)\s\S\s\S\s+)?([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})\s+\[(\d)\]\s*(.*)$"
)


def _read_candump_terminal(lines: Iterable[str], notes: Notes) -> Iterator[can.Message | None]:
    """What candump prints on a terminal: ``(1.5)  can0  RX - -  701   [1]  05``.

    Its times may be those of day (-ta, -tA), since the first frame (-tz), from frame to frame (-td,
    which are added up), or missing: then frames are numbered.
    """
    # a line with a tab before it (candump -e) explains the error frame above
    frames = (line for line in lines if line.strip() and not line.startswith("\t"))
    rows = [_TERMINAL_LINE.match(line) for line in frames]
    times = [_terminal_time(row) for row in rows if row]
    if None in times:
        notes.timed = False
        notes.remarks.append("has no times: frames are numbered in their place")
    known = [time for time in times if time is not None]
    back = sum(after < before for before, after in pairwise(known))
    alike = sum(after == before > 0.0 for before, after in pairwise(known))
    often = back > len(known) / 10 or alike > len(known) / 2
    if differences := bool(known and known[0] == 0.0 and often):
        notes.remarks.append("has times from frame to frame (candump -td): they are added up")
    passed = 0.0
    for number, row in enumerate(rows):
        if row is None:
            yield None
            continue
        time = _terminal_time(row) if notes.timed else float(number)
        passed = passed + (time or 0.0) if differences and notes.timed else time or 0.0
        *_, channel, way, identifier, length, rest = row.groups()
        bytes_ = re.match(r"(?:[0-9A-Fa-f]{2}\s*){0,8}", rest)
        value, size = int(identifier, 16), int(length)
        error = len(identifier) == 8 and bool(value & _ERROR_FLAG)
        remote = size if "remote request" in rest else None
        data = b"" if remote is not None or bytes_ is None else bytes.fromhex(bytes_[0])[:size]
        yield (
            None
            if remote is None and len(data) != size
            else _message(
                passed,
                value & (_ERROR_FLAG - 1),
                data,
                extended=len(identifier) == 8 and not error,
                remote=remote,
                error=error,
                sent=way == "TX",
                channel=channel,
            )
        )


def _terminal_time(row: re.Match[str]) -> float | None:
    if row[1]:
        return datetime.fromisoformat(row[1]).timestamp()
    return float(row[2]) if row[2] else None


def _read_asc(lines: Iterable[str], notes: Notes) -> Iterator[can.Message | None]:
    """What Vector's tools write (.asc), with times from the start or from event to event."""
    base, relative, passed = 16, False, 0.0
    for line in lines:
        if header := re.match(r"\s*base\s+(hex|dec)(?:\s+timestamps\s+(\w+))?", line, re.I):
            base = 10 if header[1].lower() == "dec" else 16
            relative = (header[2] or "").lower() == "relative"
            if relative:
                notes.remarks.append("has times from event to event: they are added up")
            continue
        parts = line.split()
        try:
            time = float(parts[0])
        except (IndexError, ValueError):
            if re.search(r"\s[RT]x\s", line):
                yield None  # else a remark, a date, the beginning or end of a block
            continue
        passed = passed + time if relative else time
        try:
            if len(parts) > 2 and parts[1].upper() == "CANFD":
                yield _asc_long(passed, parts[2:], base)
            elif len(parts) > 2 and parts[1].isdigit():
                yield from _asc_short(passed, parts[1:], base)
        except (IndexError, ValueError):
            yield None


def _asc_identifier(text: str, base: int) -> tuple[int, bool]:
    extended = text[-1:] in {"x", "X"}
    return int(text[:-1] if extended else text, base), extended


def _asc_short(time: float, parts: list[str], base: int) -> Iterator[can.Message | None]:
    """A line of a classic frame: channel, identifier, direction, d or r, length, data."""
    channel = f"{int(parts[0]) - 1}"
    if parts[1].lower() == "errorframe":
        yield _message(time, 0, b"", error=True, channel=channel)
    elif len(parts) > 3 and parts[2].lower() in {"rx", "tx"}:
        identifier, extended = _asc_identifier(parts[1], base)
        kind, sent = parts[3].lower(), parts[2].lower() == "tx"
        length = int(parts[4], base) if kind != "r" or parts[4:5] else 0
        data = bytes(int(each, base) for each in parts[5 : 5 + min(8, length)])
        if kind == "r":
            asked = length if length <= 8 else 0
            yield _message(
                time, identifier, b"", extended=extended, remote=asked, sent=sent, channel=channel
            )
        else:
            whole = kind == "d" and len(data) == min(8, length)
            yield (
                _message(time, identifier, data, extended=extended, sent=sent, channel=channel)
                if whole
                else None
            )


def _asc_long(time: float, parts: list[str], base: int) -> can.Message | None:
    """A line of the longer form (CANFD), which classic frames may have as well.

    Channel, direction, identifier, a name that may be missing, BRS, ESI, DLC, length, data; then
    the frame's duration, its bits and its flags, of which bit 12 says that it is a frame of CAN FD.
    """
    channel, sent = f"{int(parts[0]) - 1}", parts[1].lower() == "tx"
    if parts[2].lower() == "errorframe":
        return _message(time, 0, b"", error=True, channel=channel)
    identifier, extended = _asc_identifier(parts[2], base)
    rest = parts[3:] if re.fullmatch(r"[01]", parts[3]) and len(parts[4]) == 1 else parts[4:]
    rate_switch, length = rest[0] == "1", int(rest[3])
    data = bytes(int(each, base) for each in rest[4 : 4 + length])
    flags = int(rest[6 + length], 16) if len(rest) > 6 + length else 0
    if rate_switch or flags & 1 << 12 or len(data) != length:
        return None
    remote = int(rest[2], 16) if flags & 1 << 4 else None
    return _message(
        time, identifier, data, extended=extended, remote=remote, sent=sent, channel=channel
    )


_TRC_PLACES = {
    "1.0": {"I": 2, "L": 3},
    "1.1": {"T": 2, "I": 3, "L": 4},
    "1.2": {"B": 2, "T": 3, "I": 4, "L": 5},
    "1.3": {"B": 2, "T": 3, "I": 4, "L": 6},
}
"""Places of bus, type, identifier and length in the lines of PCAN-View, by the version."""
_TRC_DATA = {"Rx", "Tx", "DT", "RR"}
_TRC_ERRORS = {"Warng", "Error", "ST", "ER"}


def _read_trc(lines: Iterable[str], _: Notes) -> Iterator[can.Message | None]:
    """What PCAN-View writes (.trc), of any version, with its rows of errors and warnings."""
    version, places, begin = "1.0", _TRC_PLACES["1.0"], 0.0
    for line in lines:
        if line.lstrip().startswith(";"):
            key, __, value = line.strip().lstrip("; $").partition("=")
            if key == "FILEVERSION":
                version = value.strip()
                places = _TRC_PLACES.get(version, places)
            elif key == "STARTTIME" and version != "1.0":
                begin = (float(value) - _DAYS_TO_1970) * _DAY
            elif key == "COLUMNS":
                names = value.strip().split(",")
                places = {name.replace("l", "L"): k for k, name in enumerate(names)}
            continue
        if not line.strip():
            continue
        try:
            yield from _trc_row(line.split(), places, begin)
        except (IndexError, KeyError, ValueError):
            yield None


def _trc_row(
    parts: list[str], places: dict[str, int], begin: float
) -> Iterator[can.Message | None]:
    time = begin + float(parts[places.get("O", 1)]) / 1000
    kind = parts[places["T"]] if "T" in places else "Rx"
    channel = parts[places["B"]] if "B" in places else "1"
    if kind in _TRC_ERRORS or (kind == "Rx" and parts[places["I"]] == "FFFFFFFF"):
        tail = re.findall(r"\b[0-9A-Fa-f]{2}\b", " ".join(parts[places["I"] + 1 :]))
        status = int("".join(tail[:4]) or "0", 16)
        if kind in {"Error", "ER"}:
            yield _message(time, _BUS_ERROR, b"", error=True, channel=channel)
        elif status:  # of a bus that is well there is nothing to say
            what = _BUS_OFF if status & 0x10 else _CONTROLLER
            yield _message(time, what, b"", error=True, channel=channel)
        return
    if kind not in _TRC_DATA:
        if kind in {"FD", "FB", "FE", "BI"}:
            yield None
        return
    identifier, length = parts[places["I"]], int(parts[places["L"]])
    data = parts[places.get("D", places["L"] + 1) :]
    remote = kind == "RR" or data[:1] == ["RTR"]
    given = b"" if remote else bytes(int(each, 16) for each in data[:length])
    sent = parts[places["d"]] == "Tx" if "d" in places else kind == "Tx"
    yield (
        None
        if not remote and len(given) != length
        else _message(
            time,
            int(identifier, 16),
            given,
            extended=len(identifier) > 4,
            remote=length if remote else None,
            sent=sent,
            channel=channel,
        )
    )


_BUSMASTER_LINE = re.compile(
    r"\s*(\d+):(\d+):(\d+):(\d+)\s+(Rx|Tx)\s+(\d+)\s+(?:0x)?(\w+)\s+(\w+)\s+(\d+)((?:\s+\w+)*)\s*$",
    re.IGNORECASE,
)


def _read_busmaster(lines: Iterable[str], notes: Notes) -> Iterator[can.Message | None]:
    """What BUSMASTER writes (.log); parts of a second may lack their leading zeros."""
    base, relative = 16, False
    rows: list[re.Match[str] | None] = []
    for line in lines:
        if line.startswith("***"):
            word = line.strip("* \r\n").upper()
            base = {"HEX": 16, "DEC": 10}.get(word, base)
            relative |= word == "RELATIVE MODE"
        elif line.strip():
            rows.append(_BUSMASTER_LINE.match(line))
    if relative:
        notes.remarks.append("has times from frame to frame: they are added up")
    parts = 10 ** max((len(row[4]) for row in rows if row), default=0)
    passed, last = 0.0, None
    for row in rows:
        if row is None:
            yield None
            continue
        hour, minute, second, part, way, channel, text, kind, length, data = row.groups()
        time = 3600 * int(hour) + 60 * int(minute) + int(second) + int(part) / parts
        if relative or last is None:
            passed += time
        else:
            passed += time - last + (_DAY if time < last - _DAY / 2 else 0.0)  # midnight
        last = time
        try:
            given = bytes(int(each, base) for each in data.split()[: int(length)])
            identifier = int(text, base)
        except ValueError:
            yield None
            continue
        remote = "r" in kind.lower()
        yield (
            None
            if not remote and len(given) != int(length)
            else _message(
                passed,
                identifier,
                b"" if remote else given,
                extended="x" in kind.lower(),
                remote=int(length) if remote else None,
                sent=way.lower() == "tx",
                channel=channel,
            )
        )


_COLUMNS = {
    "time": r"time(stamp)?s?(s|ms|us|µs|sec|seconds|abs|rel)?",
    "identifier": r"(can|msg|message)?(id|identifier)(hex|dec)?|arbitrationid|addr(ess)?",
    "extended": r"(is)?ext(ended)?",
    "remote": r"remote|rtr",
    "error": r"error",
    "way": r"dir(ection)?|rxtx",
    "channel": r"bus|chan(nel)?|chn|can(bus|channel)?",
    "length": r"len(gth)?|dlc",
    "data": r"data(bytes)?(hex)?|payload",
}
"""Columns of a table of frames, by their names in small letters without signs and spaces."""
_BYTE = re.compile(r"(?:d|b|data|byte)(\d)")
_TRUE = {"1", "true", "yes", "x"}


def _column_places(line: str) -> tuple[dict[str, int], list[int], str]:
    """Places of the columns of a header, those of single bytes, and what separates columns."""
    separator = max(",;\t", key=line.count)
    names = [re.sub(r"[^a-z0-9µ]", "", cell.lower()) for cell in line.split(separator)]
    found = {
        role: k
        for role, pattern in reversed(_COLUMNS.items())
        for k, name in reversed(list(enumerate(names)))
        if re.fullmatch(pattern, name)
    }
    return found, [k for k, name in enumerate(names) if _BYTE.fullmatch(name)], separator


def _is_table(line: str) -> bool:
    found, single, _ = _column_places(line)
    return {"time", "identifier"} <= set(found) and ("data" in found or bool(single))


def _read_table(lines: Iterable[str], notes: Notes) -> Iterator[can.Message | None]:
    """A table with a header: python-can's, SavvyCAN's (GVRET), Kvaser's, and others like them."""
    rows = iter(lines)
    header = next((line for line in rows if _is_table(line)), "")
    places, single, separator = _column_places(header)
    if not header:
        notes.remarks.append("has no header that names time, identifier and data")
        return
    cells = [
        [cell.strip().strip('"') for cell in line.rstrip("\r\n").split(separator)]
        for line in rows
        if line.strip()
    ]
    name = header.split(separator)[places["time"]].lower()
    packed = "arbitration_id" in header  # python-can, whose bytes are in base64
    if packed:
        notes.form = "python-can's table"
    whole = all("." not in row[places["time"]] for row in cells[:100] if len(row) > places["time"])
    scale = 1e-3 if "ms" in name else 1e-6 if "us" in name or "µs" in name else 1.0
    if whole and re.fullmatch(r"\W*time\W*stamp\W*", name) and not packed:
        scale = 1e-6  # GVRET
    at = places["identifier"]
    given = [each for row in cells for k in single for each in row[k : k + 1]]
    data_base = 10 if any(len(each) > 2 for each in given if each.isdigit()) else 16
    base = 16 if packed else _base([row[at] for row in cells if len(row) > at], header, data_base)
    if base == 10 and not _looks_hexadecimal(given):
        data_base = 10
    for row in cells:
        try:
            yield _table_row(row, places, single, scale, (base, data_base), packed=packed)
        except (IndexError, ValueError, Base64Error):
            yield None


def _table_row(
    row: list[str],
    places: dict[str, int],
    single: list[int],
    scale: float,
    bases: tuple[int, int],
    *,
    packed: bool,
) -> can.Message | None:
    def cell(role: str) -> str:
        return row[places[role]].strip().lower() if role in places else ""

    if packed:
        data = b64decode(row[places["data"]], validate=True)
    elif single:
        count = int(cell("length")) if "length" in places else len(single)
        data = bytes(int(row[k], bases[1]) for k in single[:count] if row[k])
        if len(data) != count and cell("remote") not in _TRUE:
            return None
    else:
        data = bytes.fromhex(cell("data").removeprefix("0x").replace("|", ""))
    text = cell("identifier").removesuffix("h")
    identifier = int(text.rstrip("x"), bases[0])
    error, remote = cell("error") in _TRUE, cell("remote") in _TRUE
    return _message(
        scale * float(row[places["time"]]),
        identifier & ((1 << 29) - 1),
        b"" if remote else data,
        extended=cell("extended") in _TRUE or identifier > _STANDARD,
        remote=int(cell("length") or 0) if remote else None,
        error=error,
        sent=cell("way")[:1] == "t",
        channel=cell("channel") or None,
    )


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
    digits = [each for each in some if each.isdigit()]
    as_hex = max((int(each, 16) for each in digits), default=0)
    return 10 if as_hex > _STANDARD >= max((int(each) for each in digits), default=0) else 16


def _read_kvaser(lines: Iterable[str], _: Notes) -> Iterator[can.Message | None]:
    """What Kvaser's CanKing prints: channel, identifier, flag, length, data, time, direction."""
    rows = [line.split() for line in lines if re.match(r"\s*\d+\s", line)]
    base = _base([row[1] for row in rows if len(row) > 1], "")
    for row in rows:
        try:
            flag = "" if row[2].isdigit() else row[2].upper()
            rest = row[3 if flag else 2 :]
            length, remote = int(rest[0]), "R" in flag
            data = b"" if remote else bytes(int(each, base) for each in rest[1 : 1 + length])
            time, way = rest[1 + len(data) : 3 + len(data)]
            identifier = int(row[1], base)
            yield (
                None
                if not remote and len(data) != length
                else _message(
                    float(time),
                    identifier,
                    data,
                    extended="X" in flag or identifier > _STANDARD,
                    remote=length if remote else None,
                    error="E" in flag,
                    sent=way.upper().startswith("T"),
                    channel=row[0],
                )
            )
        except (IndexError, ValueError):
            yield None


_SOCKETCAN, _COOKED, _CAN_PROTOCOL = 227, 113, 0x000C
"""Kinds of links: CAN alone, and any device, where a number says that it is CAN."""


def _read_capture(raw: BinaryIO, _: Path, notes: Notes) -> Iterator[can.Message | None]:
    """What Wireshark and tcpdump keep of SocketCAN (.pcap, .pcapng)."""
    for time, link, packet in _packets(raw):
        at = 16 if link == _COOKED else 0
        is_can = link == _SOCKETCAN or (
            link == _COOKED and struct.unpack(">H", packet[14:16])[0] == _CAN_PROTOCOL
        )
        if not is_can or len(packet) < at + 8:
            if not is_can and not notes.remarks:
                notes.remarks.append(f"has packets of another kind of link ({link}) than CAN")
            yield None
            continue
        mark, length = struct.unpack(">IB", packet[at : at + 5])
        if len(packet) > at + 16 and length > 8:
            yield None  # a frame of CAN FD
            continue
        remote, error = bool(mark & _REMOTE_FLAG), bool(mark & _ERROR_FLAG)
        if not remote and len(packet) < at + 8 + length:
            yield None  # cut off
            continue
        extended = bool(mark & _EXTENDED_FLAG)
        yield _message(
            time,
            mark & (_ERROR_FLAG - 1) if extended or error else mark & _STANDARD,
            b"" if remote else packet[at + 8 : at + 8 + length],
            extended=extended,
            remote=length if remote else None,
            error=error,
        )


def _packets(raw: BinaryIO) -> Iterator[tuple[float, int, bytes]]:
    """Time in s, kind of link and bytes of each packet of a capture."""
    magic = raw.read(4)
    if magic != b"\x0a\x0d\x0d\x0a":
        order = "<" if magic[0] in {0xD4, 0x4D} else ">"
        unit = 1e-9 if b"\x3c" in magic[1:3] else 1e-6
        link = struct.unpack(f"{order}16xI", raw.read(20))[0] & 0xFFFF
        while len(head := raw.read(16)) == 16:
            seconds, parts, length, _ = struct.unpack(f"{order}4I", head)
            yield seconds + unit * parts, link, raw.read(length)
        return
    order, links, block = "<", list[tuple[int, float]](), magic + raw.read(8)
    while len(block) == 12:
        kind = struct.unpack(f"{order}I", block[:4])[0]
        if block[:4] == b"\x0a\x0d\x0d\x0a":
            order, links = "<" if block[8:12] == b"\x4d\x3c\x2b\x1a" else ">", []
        size = struct.unpack(f"{order}I", block[4:8])[0]
        body = block[8:] + raw.read(size - 12)
        if kind == 1:
            links.append((struct.unpack(f"{order}H", body[:2])[0], _resolution(body[8:-4], order)))
        elif kind == 6:
            number, high, low, length, _ = struct.unpack(f"{order}5I", body[:20])
            link, unit = links[number]
            yield unit * (high << 32 | low), link, body[20 : 20 + length]
        block = raw.read(12)


def _resolution(options: bytes, order: str) -> float:
    """Unit of time in s, by option 9 of an interface; microseconds without it."""
    at = 0
    while len(options) >= at + 5:
        code, length = struct.unpack(f"{order}HH", options[at : at + 4])
        if code == 9:
            power = options[at + 4]
            return float(2.0 ** -(power & 0x7F) if power & 0x80 else 10.0**-power)
        at += 4 + (length + 3) // 4 * 4
    return 1e-6


def _read_blf(raw: BinaryIO, file: Path, notes: Notes) -> Iterator[can.Message]:
    """What Vector's tools pack (.blf)."""
    number = 0
    with can.BLFReader(raw) as reader:
        for number, message in enumerate(reader, 1):  # noqa: B007
            yield message
        if file.suffix.lower() != ".gz" and reader.file_size > file.stat().st_size:
            notes.remarks.append(f"cut off, ends after frame {number}")  # as its head says


def _read_database(_: BinaryIO, file: Path, notes: Notes) -> Iterator[can.Message]:
    """What python-can keeps in a database (.db)."""
    notes.remarks.append(
        "python-can's writer of .db drops the frames that wait when it is stopped: the end of what "
        "was heard may be missing"
    )
    with can.SqliteReader(file) as reader:
        yield from reader


def _read_mf4(_: BinaryIO, file: Path, __: Notes) -> Iterator[can.Message]:
    """Measurement files (.mf4), where asammdf is installed."""
    with can.MF4Reader(file) as reader:
        yield from reader


_Packed = Callable[[BinaryIO, Path, Notes], Iterator[can.Message | None]]
_Text = Callable[[Iterable[str], Notes], Iterator[can.Message | None]]
_PACKED: dict[str, tuple[str, _Packed]] = {
    "CAN trace of Vector (.blf)": ("BLF", _read_blf),
    "SQLite database": ("python-can's database", _read_database),
    "measurement file (.mf4)": ("MF4", _read_mf4),
    "pcapng capture": ("pcapng", _read_capture),
    "pcap capture": ("pcap", _read_capture),
}
"""Readers of packed files by what their first bytes say."""
_FORMS: dict[str, tuple[Callable[[str], object], _Text]] = {
    "candump -L": (_LOG_LINE.match, _read_candump_log),
    "BUSMASTER": (re.compile(r"\*\*\*BUSMASTER").match, _read_busmaster),
    "PCAN-View": (re.compile(r";\$FILEVERSION|\s*\d+\)\s+\d").match, _read_trc),
    "Vector's ASC": (
        re.compile(r"\s*(base\s+(hex|dec)\b|begin triggerblock|date\s+\w+\s+\w+\s)", re.I).match,
        _read_asc,
    ),
    "CanKing": (re.compile(r"\s*Chn\s+Identifier\s+Flg", re.I).match, _read_kvaser),
    "candump on a terminal": (_TERMINAL_LINE.match, _read_candump_terminal),
    "a table of frames": (_is_table, _read_table),
}
"""Forms of text: how one of their first lines is known, and their readers."""
_BY_ENDING = {".asc": "Vector's ASC", ".trc": "PCAN-View", ".csv": "a table of frames"}


def _form(beginning: list[str], ending: str) -> tuple[str, _Text]:
    """The form that a text has by its first lines, else by the ending of its name."""
    for form, (known, reader) in _FORMS.items():
        if any(known(line) for line in beginning):
            return form, reader
    form = _BY_ENDING.get(ending, "candump -L")
    return form, _FORMS[form][1]
