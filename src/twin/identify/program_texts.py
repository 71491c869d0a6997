"""Texts of single programs as lines of cells behind a line of names.

LabVIEW, TwinCAT Scope, messages that ROS prints, Teleplot, and InfluxDB's line protocol.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping

from twin.base.errors import LogError

COMMENT_MARKS = ("#", "%", "//")
"""What begins a line that is a remark."""
LABVIEW_END = "***End_of_Header***"
"""Line with which a head of LabVIEW ends."""
LABVIEW_TIME = "X_Value"
"""Name of a column of times of LabVIEW."""
TWINCAT_STEP = "SampleTime[ms]"
"""Beginning of a line in the head of an export of TwinCAT Scope."""
INFLUX_LINE = re.compile(
    r"(?P<series>[A-Za-z_][^\s,=]*(?:,[^\s,=]+=[^\s,=]+)*) "
    r"(?P<fields>[^\s,=]+=(?:\"[^\"]*\"|[^\s,=]+)(?:,[^\s,=]+=(?:\"[^\"]*\"|[^\s,=]+))*)"
    r"(?: (?P<time>\d{10,19}))?"
)
"""A row of InfluxDB's line protocol."""
TIME_UNITS_BY_DIGITS = {10: "s", 13: "ms", 16: "us", 19: "ns"}
"""Digits of a time since 1970 and its unit."""
ONE_VALUE = re.compile(
    r"\s*>([^:;|]+):(?:(\d+(?:\.\d+)?):)?([-+]?[\d.]+(?:[eE][-+]?\d+)?)(?:§([^|]*))?(?:\|.*)?"
)
"""A value with its name and its time in ms, as Teleplot takes it."""
DOCUMENT_END = "---"
"""Line between two messages that ROS prints."""
DOCUMENT_LINE = re.compile(r"\s*(?:---|- .*|[A-Za-z_]\w*:(?: .*)?)")
"""A line of such messages."""
MIN_DOCUMENTS = 10
"""Least number of messages."""
MOST_LINES_SHARE = 0.8
"""Share of the lines above which they are all taken to be of a form."""
LOOKED_AT_LINES = 50
"""Number of lines in the middle of a text by which its form is recognised."""


def rows_of_program(lines: list[str]) -> list[str] | None:
    """The rows of a text of a known program behind a line of names; None of any other text.

    Args:
        lines: All of it.
    """
    for is_one, read in PROGRAMS:
        if is_one(lines):
            return list(read(lines))
    return None


def most_are(lines: list[str], is_one: Callable[[str], bool]) -> bool:
    """Whether most lines in the middle of a text are of a form."""
    some = [line for line in lines if not line.lstrip().startswith(COMMENT_MARKS)]
    some = some[len(some) // 2 :][:LOOKED_AT_LINES]
    return bool(some) and sum(map(is_one, some)) > MOST_LINES_SHARE * len(some)


def _read_labview(lines: list[str]) -> Iterator[str]:
    """The rows of all segments of a LabVIEW measurement file behind one line of names.

    The names have their units. Times that the file states by their step alone are written out.

    Args:
        lines: All of the file.
    """
    between = "," if any(line.startswith("Separator,") for line in lines) else "\t"
    facts = dict[str, list[str]]()
    in_head, names, row = True, list[str](), 0
    for line in lines:
        first, *cells = (cell.strip() for cell in line.split(between))
        if first.startswith(LABVIEW_END):
            in_head = False
        elif first == "Channels" or in_head:
            in_head = True
            facts[first] = cells
        elif first == LABVIEW_TIME:
            if not names:
                names = list(_name_channels([first, *cells], facts.get("Y_Unit_Label", [])))
                yield between.join(names)
        elif not first and facts.get("X_Columns", [""])[0] == "No":
            begin, step = _read_times(facts)
            yield between.join([f"{begin + row * step:.9g}", *cells[: len(names) - 1]])
            row += 1
        else:
            yield between.join([first, *cells][: len(names)])


def _read_times(facts: Mapping[str, list[str]]) -> tuple[float, float]:
    """The first time and the step in s that a head of LabVIEW states."""
    try:
        begin, step = (float(facts[key][0].replace(",", ".")) for key in ("X0", "Delta_X"))
    except (KeyError, IndexError, ValueError):
        raise LogError("LabVIEW: its rows have no times, and its head no X0 and Delta_X") from None
    return begin, step


def _name_channels(header: list[str], units: list[str]) -> Iterator[str]:
    """Names of the columns of LabVIEW with their units, the comment left out.

    Args:
        header: The names; of several columns of times each but the first is numbered.
        units: Of the channels.
    """
    times = channels = 0
    for name in header:
        if name == LABVIEW_TIME:
            times += 1
            yield name if times == 1 else f"time {times}"
        elif name and name != "Comment":
            unit = units[channels] if channels < len(units) else ""
            yield f"{name} [{unit}]" if unit else name
            channels += 1


def _is_twincat(lines: list[str]) -> bool:
    """Whether a head has steps below names, each line with several cells."""
    firsts = [re.split(r"[;,\t]", line)[0] for line in lines[:LOOKED_AT_LINES]]
    return TWINCAT_STEP in firsts and "Name" in firsts[: firsts.index(TWINCAT_STEP)]


def _read_twincat(lines: list[str]) -> Iterator[str]:
    """The rows of an export of TwinCAT Scope behind one line of names with their units.

    Each column called ``Name`` has the times in ms of the channels behind it, up to the next one.

    Args:
        lines: All of the file.
    """
    between = next(
        (sign for sign in ";," if any(f"{TWINCAT_STEP}{sign}" in e for e in lines)), "\t"
    )
    cells = [[cell.strip() for cell in line.split(between)] for line in lines]
    step = next(k for k, row in enumerate(cells) if row[0] == TWINCAT_STEP)
    head = next((row for row in reversed(cells[:step]) if row[0] == "Name"), ["Name"])
    units = next((row for row in cells[step:] if row[0] == "Unit"), [])
    channels, names = list[tuple[int, int]](), list[str]()
    for k, name in enumerate(head):
        if name == "Name":
            clock = k
        elif name:
            channels.append((clock, k))
            unit = units[k].partition(" ")[0] if k < len(units) else ""
            names.append(f"{name} [{unit}]" if unit and not unit.startswith("(") else name)
    rows: dict[float, list[str]] = {}
    for row in cells[step:]:
        for place, (clock, k) in enumerate(channels):
            if k < len(row) and re.fullmatch(r"\d+([.,]\d+)?", row[clock]):
                at = float(row[clock].replace(",", "."))
                rows.setdefault(at, [""] * len(names))[place] = row[k]
    yield ";".join(["time [ms]", *names])
    for at in sorted(rows):
        yield ";".join([f"{at:.9g}", *rows[at]])


def _are_documents(lines: list[str]) -> bool:
    """Whether lines are messages of names and values, or of entries of lists, with ends between."""
    ends = sum(line.strip() == DOCUMENT_END for line in lines)
    return ends >= MIN_DOCUMENTS and most_are(lines, lambda e: bool(DOCUMENT_LINE.fullmatch(e)))


def _read_documents(lines: list[str]) -> list[str]:
    """Rows of messages as ROS prints them, ``NAME: VALUE`` in lines, one row for each.

    Names within others are joined by dots, entries of lists are numbered from 0.

    Args:
        lines: All of the file.
    """
    rows, above = [dict[str, str]()], list[tuple[int, str]]()
    for line in lines:
        bare = line.strip()
        indent = line.index(bare)
        if bare == DOCUMENT_END:
            rows.append({})
            above = []
        elif bare.startswith("- "):
            path = ".".join(name for at, name in above if at <= indent)
            entries = sum(name.rpartition(".")[0] == path for name in rows[-1])
            rows[-1][f"{path}.{entries}"] = bare.removeprefix("- ")
        else:
            key, _, value = bare.partition(":")
            above = [(at, name) for at, name in above if at < indent]
            if value.strip():
                rows[-1][".".join([*(name for _, name in above), key])] = value.strip()
            else:
                above.append((indent, key))
    names = dict.fromkeys(
        name for row in rows for name, value in row.items() if re.match(r"[-+.\d\[]", value)
    )
    return _write_rows([("", row) for row in rows if row], {name: name for name in names}, "s")


def _read_influx(lines: list[str]) -> list[str]:
    """Rows of InfluxDB's line protocol, a row for each time.

    A field is called by its name, where there are several series by ``SERIES.NAME``.

    Args:
        lines: All of the file.
    """
    found = [each for each in map(INFLUX_LINE.fullmatch, lines) if each]
    several = len({each["series"] for each in found}) > 1
    rows: dict[str, dict[str, str]] = {}
    for k, each in enumerate(found):
        row = rows.setdefault(each["time"] or f"row {k}", {})
        for field in re.findall(r"[^\s,=]+=(?:\"[^\"]*\"|[^\s,=]+)", each["fields"]):
            name, _, value = field.partition("=")
            series = each["series"].replace(",", " ")
            row[f"{series}.{name}" if several else name] = re.sub(r"(?<=\d)[iu]$", "", value)
    times = [time for time in rows if time.isdigit()]
    unit = TIME_UNITS_BY_DIGITS.get(max(map(len, times), default=19), "ns")
    names = dict.fromkeys(name for row in rows.values() for name in row)
    timed = [(time if time.isdigit() else "", row) for time, row in rows.items()]
    return _write_rows(timed, {name: name for name in names}, unit)


def _write_rows(
    rows: list[tuple[str, dict[str, str]]], names: Mapping[str, str], unit: str
) -> list[str]:
    """Lines of rows behind one of their names.

    Args:
        rows: Time, empty where there is none, and cells by name.
        names: Name to how it is written.
        unit: Of the times.
    """
    timed = any(time for time, _ in rows)
    header = [f"time [{unit}]"] * timed + list(names.values())
    lines = [[time] * timed + [cells.get(name, "") for name in names] for time, cells in rows]
    return [";".join(each) for each in (header, *lines)]


def _join_values(lines: list[str]) -> list[str]:
    """Rows of the values of lines with one value each; a row ends where a name or time is new."""
    names: dict[str, str] = {}
    rows = list[tuple[str, dict[str, str]]]()
    for line in lines:
        if (found := ONE_VALUE.fullmatch(line)) is None:
            continue
        name, time, value, unit = found.groups()
        names.setdefault(name, name.replace(";", " ") + (f" [{unit}]" if unit else ""))
        if not rows or name in rows[-1][1] or rows[-1][0] != (time or ""):
            rows.append((time or "", {}))
        rows[-1][1][name] = value
    return _write_rows(rows, names, "ms")


PROGRAMS: tuple[tuple[Callable[[list[str]], bool], Callable[[list[str]], Iterable[str]]], ...] = (
    (lambda lines: any(line.startswith(LABVIEW_END) for line in lines), _read_labview),
    (_is_twincat, _read_twincat),
    (_are_documents, _read_documents),
    (lambda lines: most_are(lines, lambda line: bool(ONE_VALUE.fullmatch(line))), _join_values),
    (lambda lines: most_are(lines, lambda line: bool(INFLUX_LINE.fullmatch(line))), _read_influx),
)
"""Whether a text is one of a program, and its reader."""
