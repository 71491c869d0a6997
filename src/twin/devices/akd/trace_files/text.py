"""Readers of traces in text, a frame a line: Vector's .asc, PCAN-View, BUSMASTER."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from itertools import chain, islice

from twin.devices.akd.trace_files.frames import LOOKAHEAD_LINES, Notes, TracedFrame, classic_frame
from twin.devices.akd.wire_values import BUS_ERROR, BUS_OFF, CONTROLLER

_DAY_S = 86400.0
"""Seconds of a day."""
_DAYS_TO_1970 = 25569
"""Days from the beginning of PCAN's calendar to the beginning of the Unix calendar."""


def read_asc(lines: Iterable[str], notes: Notes) -> Iterator[TracedFrame | None]:
    """Reader of Vector's tools (.asc), with times from the start or from event to event."""
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
            time = float(parts[0].replace(",", "."))
        except (IndexError, ValueError):
            if re.search(r"\s[RT]x\s", line) and not line.lstrip().startswith("//"):
                yield None  # else a remark, a date, the beginning or end of a block
            continue
        passed = passed + time if relative else time
        try:
            if len(parts) > 3 and parts[1].upper() == "CANFD":
                if parts[3].lower() != "txrq":  # a request to send, no frame
                    yield _asc_long(passed, parts[2:], base)
            elif len(parts) > 2 and parts[1].isdecimal():
                yield from _asc_short(passed, parts[1:], base)
            elif "chip status" in line:
                yield from _asc_status(passed, parts[2], line)
        except (IndexError, ValueError):
            yield None


def _asc_status(time: float, channel: str, line: str) -> Iterator[TracedFrame | None]:
    """A line of the controller's state, as an error frame if it is no longer error active."""
    state = line.rpartition("chip status")[2].lower().replace(" ", "")
    if not state.startswith("erroractive"):
        what = BUS_OFF if state.startswith("busoff") else CONTROLLER
        yield classic_frame(time, what, b"", error=True, channel=f"{int(channel)}")


def _asc_identifier(text: str, base: int) -> tuple[int, bool]:
    extended = text[-1:] in {"x", "X"}
    return int(text[:-1] if extended else text, base), extended


def _asc_short(time: float, parts: list[str], base: int) -> Iterator[TracedFrame | None]:
    """A line of a classic frame: channel, identifier, direction, d or r, length, data."""
    channel = f"{int(parts[0])}"
    if parts[1].lower() == "errorframe":
        yield classic_frame(time, 0, b"", error=True, channel=channel)
    elif len(parts) > 3 and parts[2].lower() in {"rx", "tx"}:
        identifier, extended = _asc_identifier(parts[1], base)
        kind, sent = parts[3].lower(), parts[2].lower() == "tx"
        if kind == "r":  # the length may be missing; the frame's duration may follow
            asked = int(parts[4]) if parts[4:5] and re.fullmatch("[0-8]", parts[4]) else 0
            yield classic_frame(
                time, identifier, b"", extended=extended, remote=asked, sent=sent, channel=channel
            )
        else:
            length = int(parts[4], base)
            data = bytes(int(each, base) for each in parts[5 : 5 + min(8, length)])
            whole = kind == "d" and len(data) == min(8, length)
            yield (
                classic_frame(time, identifier, data, extended=extended, sent=sent, channel=channel)
                if whole
                else None
            )


def _asc_long(time: float, parts: list[str], base: int) -> TracedFrame | None:
    """A line of the longer form (CANFD), which classic frames may have as well.

    Channel, direction, identifier, a name that may be missing, BRS, ESI, DLC, length, data; then
    the frame's duration, its bits and its flags; bit 12 marks a frame of CAN FD.
    """
    channel, sent = f"{int(parts[0])}", parts[1].lower() == "tx"
    if parts[2].lower() == "errorframe":
        return classic_frame(time, 0, b"", error=True, channel=channel)
    identifier, extended = _asc_identifier(parts[2], base)
    rest = parts[3:] if re.fullmatch(r"[01]", parts[3]) and len(parts[4]) == 1 else parts[4:]
    rate_switch, length = rest[0] == "1", int(rest[3])
    data = bytes(int(each, base) for each in rest[4 : 4 + length])
    flags = int(rest[6 + length], 16) if len(rest) > 6 + length else 0
    if rate_switch or flags & 1 << 12 or len(data) != length:
        return None
    remote = int(rest[2], 16) if flags & 1 << 4 else None
    return classic_frame(
        time, identifier, data, extended=extended, remote=remote, sent=sent, channel=channel
    )


_TRC_PLACES = {
    "1.0": {"I": 2, "L": 3},
    "1.1": {"T": 2, "I": 3, "L": 4},
    "1.2": {"B": 2, "T": 3, "I": 4, "L": 5},
    "1.3": {"B": 2, "T": 3, "I": 4, "L": 6},
}
"""Places of bus, type, identifier and length in the lines of PCAN-View, by the version."""
_TRC_COLUMNS = {
    4: {"O": 1, "T": 2, "I": 3, "d": 4, "L": 5},
    5: {"O": 1, "T": 2, "B": 3, "I": 4, "d": 5, "L": 7},
}
"""Places in the lines of versions 2.0 and 2.1, by the place of the direction."""
_TRC_DIRECTIONS = {"Rx", "Tx"}
_TRC_DATA = {"Rx", "Tx", "DT", "RR"}
_TRC_ERRORS = {"Warng", "Error", "ST", "ER"}


def read_trc(lines: Iterable[str], notes: Notes) -> Iterator[TracedFrame | None]:
    """Reader of PCAN-View (.trc), of any version, with its rows of errors and warnings.

    Lines that were copied without the header have the form of one of the versions.
    """
    version, begin = "1.0", 0.0
    places: dict[str, int] | None = None
    for line in lines:
        if line.lstrip().startswith(";"):
            key, __, value = line.strip().lstrip("; $").partition("=")
            if key == "FILEVERSION":
                version = value.strip()
                places = _TRC_PLACES.get(version)
            elif key == "STARTTIME" and version != "1.0":
                begin = _trc_begin(value, notes)
            elif key == "COLUMNS":
                names = value.strip().split(",")
                places = {name.replace("l", "L"): k for k, name in enumerate(names)}
            continue
        if not line.strip():
            continue
        try:
            parts = line.split()
            yield from _trc_row(parts, places or _trc_places(parts), begin)
        except (IndexError, KeyError, ValueError):
            yield None


def _trc_places(parts: list[str]) -> dict[str, int]:
    """The places in a line without a header, by where its type or its direction stands."""
    if not parts[0].endswith(")"):
        for direction, places in _TRC_COLUMNS.items():
            if parts[direction] in _TRC_DIRECTIONS:
                return places
        raise ValueError("no line of PCAN-View")
    if parts[2] in _TRC_DIRECTIONS:
        return _TRC_PLACES["1.1"]
    if parts[3] in _TRC_DIRECTIONS:
        return _TRC_PLACES["1.3" if parts[5] == "-" else "1.2"]
    return _TRC_PLACES["1.0"]


def _trc_begin(text: str, notes: Notes) -> float:
    """When a trace began by its header, s since 1970; 0 if that is no day."""
    try:
        day = float(text.replace(",", "."))
    except ValueError:
        day = math.nan
    if math.isfinite(day):
        return (day - _DAYS_TO_1970) * _DAY_S
    notes.remarks.append("its beginning is no day: times count from it")
    return 0.0


def _trc_row(
    parts: list[str], places: dict[str, int], begin: float
) -> Iterator[TracedFrame | None]:
    time = begin + float(parts[places.get("O", 1)].replace(",", ".")) / 1000
    kind = parts[places["T"]] if "T" in places else "Rx"
    channel = parts[places["B"]] if "B" in places else "1"
    if "T" not in places and "ERROR" in parts:
        kind = "Error"
    if kind in _TRC_ERRORS or (kind == "Rx" and parts[places["I"]] == "FFFFFFFF"):
        tail = re.findall(r"\b[0-9A-Fa-f]{2}\b", " ".join(parts[places["I"] + 1 :]))
        status = int("".join(tail[:4]) or "0", 16)
        if kind in {"Error", "ER"}:
            yield classic_frame(time, BUS_ERROR, b"", error=True, channel=channel)
        elif status:  # of a bus that is well there is nothing to say
            what = BUS_OFF if status & 0x10 else CONTROLLER
            yield classic_frame(time, what, b"", error=True, channel=channel)
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
    yield classic_frame(
        time,
        int(identifier, 16),
        given,
        extended=len(identifier) > 4,
        remote=length if remote else None,
        sent=sent,
        channel=channel,
        stated=length,
    )


_BUSMASTER_LINE = re.compile(
    r"\s*(\d+):(\d+):(\d+):(\d+)\s+(Rx|Tx)\s+(\d+)\s+(?:0x)?(\w+)\s+(\w+)\s+(\d+)((?:\s+\w+)*)\s*$",
    re.IGNORECASE,
)


def read_busmaster(lines: Iterable[str], notes: Notes) -> Iterator[TracedFrame | None]:
    """Reader of BUSMASTER (.log); parts of a second may lack their leading zeros."""
    rest = iter(lines)
    first = list(islice(rest, LOOKAHEAD_LINES))
    digits = [len(row[4]) for line in first if (row := _BUSMASTER_LINE.match(line))]
    parts = 10 ** max(digits, default=0)
    base, relative, passed, last = 16, False, 0.0, None
    for line in chain(first, rest):
        if line.startswith("***"):
            word = line.strip("* \r\n").upper()
            base = {"HEX": 16, "DEC": 10}.get(word, base)
            if word == "RELATIVE MODE" and not relative:
                relative = True
                notes.remarks.append("has times from frame to frame: they are added up")
            continue
        row = _BUSMASTER_LINE.match(line)
        if row is None:
            if line.strip():
                yield None
            continue
        hour, minute, second, part, way, channel, text, kind, length, data = row.groups()
        time = 3600 * int(hour) + 60 * int(minute) + int(second) + int(part) / parts
        if relative or last is None:
            passed += time
        else:
            passed += time - last + (_DAY_S if time < last - _DAY_S / 2 else 0.0)  # midnight
        last = time
        try:
            given = bytes(int(each, base) for each in data.split()[: int(length)])
            identifier = int(text, base)
        except ValueError:
            yield None
            continue
        remote = "r" in kind.lower()
        yield classic_frame(
            passed,
            identifier,
            b"" if remote else given,
            extended="x" in kind.lower(),
            remote=int(length) if remote else None,
            sent=way.lower() == "tx",
            channel=channel,
            stated=int(length),
        )


SLCAN_LINE = re.compile(
    r"\s*(?:([tr])([0-9A-F]{3})|([TR])([0-9A-F]{8}))([0-8])((?:[0-9A-F]{2})*)\s*$", re.IGNORECASE
)
"""A frame as serial adapters write it: ``t701105``, ``T`` with 29 bits, ``r`` and ``R`` remote."""
_SLCAN_MINUTE_S = 60.0
"""Time in s after which the time of a serial adapter begins anew."""


def read_slcan(lines: Iterable[str], notes: Notes) -> Iterator[TracedFrame | None]:
    """Reader of the lines of a serial adapter (Lawicel), with its times in ms or without."""
    passed, last, number = 0.0, None, 0
    for line in lines:
        row = SLCAN_LINE.match(line)
        if row is None:
            if line.strip("\a\r\n zZ"):  # else the adapter's answer to a frame that was sent
                yield None
            continue
        short, _, long, _, length, rest = row.groups()
        kind, size = short or long, int(length)
        remote = kind in "rR"
        data, time = rest[: 0 if remote else 2 * size], rest[0 if remote else 2 * size :]
        if len(time) not in (0, 4):
            yield None
            continue
        if time:
            now = int(time, 16) / 1000
            passed += 0.0 if last is None else (now - last) % _SLCAN_MINUTE_S
            last = now
        elif number == 0:
            notes.timed = False
            notes.remarks.append("has no times: frames are numbered in their place")
        yield classic_frame(
            passed if notes.timed else float(number),
            int(row[2] or row[4], 16),
            bytes.fromhex(data),
            extended=kind in "TR",
            remote=size if remote else None,
            stated=size,
        )
        number += 1


PRINTED_LINE = re.compile(
    r"\s*Timestamp:\s*(-?\d+\.\d+)\s+ID:\s*([0-9a-f]+)\s+([XS])\s+(.*?)\s*DLC?:\s*(\d+)"
    r"((?:\s+[0-9a-f]{2})*)(?:\s+'.*')?(?:\s+Channel:\s*(\S+))?\s*$"
)
"""A frame as python-can prints it; before its length are Rx or Tx, and E, R, F for its kind."""


def read_printed(lines: Iterable[str], _: Notes) -> Iterator[TracedFrame | None]:
    """Reader of what python-can prints (can_logger, .txt)."""
    for line in lines:
        row = PRINTED_LINE.match(line)
        if row is None:
            if line.strip():
                yield None
            continue
        time, identifier, kind, flags, length, data, channel = row.groups()
        marks = flags.split()
        remote = "R" in marks
        frame = classic_frame(
            float(time),
            int(identifier, 16),
            b"" if remote else bytes.fromhex(data),
            extended=kind == "X",
            remote=int(length) if remote else None,
            error="E" in marks,
            sent="Tx" in marks,
            channel=channel,
            stated=int(length),
        )
        yield None if "F" in marks else frame
