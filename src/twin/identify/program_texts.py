"""Texts of single programs as lines of cells behind a line of names.

LabVIEW, TwinCAT Scope, oscilloscopes of Rigol, recorders of Yokogawa, ARFF, archives of SIMATIC
panels, messages that ROS prints, Teleplot, and InfluxDB's line protocol.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import starmap, zip_longest

from twin.base.errors import LogError
from twin.run.units import with_unit

COMMENT_MARKS = ("#", "%", "//")
"""What begins a line that is a remark."""
LABVIEW_END = "***End_of_Header***"
"""Line with which a head of LabVIEW ends."""
LABVIEW_TIME = "X_Value"
"""Name of a column of times of LabVIEW."""
TWINCAT_STEP = "SampleTime[ms]"
"""Beginning of a line in the head of an export of TwinCAT Scope."""
FILETIME_DIGITS = 17
"""Digits of a time of TwinCAT Scope from which on it counts 100 ns since 1601."""
DECIMAL = re.compile(r"[-+]?\d+(?:[.,]\d+)?(?:[eE][-+]?\d+)?")
"""A number with a decimal point or comma."""
STATED_STEP = re.compile(r"(?:^|,)\s*(?:Start,Increment|t0 *= *[-+.\deE]+ *s?, *tInc *=)")
"""End of a line of names of an oscilloscope of Rigol."""
STEP_NAMES = ("Start", "Increment")
"""Names in it with their values in the next line."""
RIGOL_TIMES = ("X", "Time(s)")
"""Names of its first column where that has the times, or counts them."""
YOKOGAWA_STEP = "HResolution"
"""Beginning of a line in the head of a recorder of Yokogawa."""
ARFF_ATTRIBUTE = re.compile(r"(?i)\s*@attribute\s+(?:(?:['\"])([^'\"]*)['\"]|(\S+))")
"""Declaration of a column in an ARFF file."""
ARFF_DATA = re.compile(r"(?i)\s*@data\s*")
"""Line behind which its rows stand."""
WINCC_NAME, WINCC_TIME = "VarName", "Time_ms"
"""Names of columns of an archive of a SIMATIC panel."""
MICRODAY_S = 0.0864
"""Unit of its times in s."""
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

    Args:
        lines: All of the file.

    Raises:
        LogError: If neither its rows nor its head have times.
    """
    between = "," if any(line.startswith("Separator,") for line in lines) else "\t"
    facts, in_head, named, count = dict[str, list[str]](), True, False, 0
    channels, rows = list[tuple[int, int]](), list[list[str]]()
    for line in [*lines, "Channels"]:  # the head of a further segment ends the last one
        first, *cells = row = [cell.strip() for cell in line.split(between)]
        if first == "Channels" and rows:
            yield from _join_clocks(*_read_segment(facts, channels, rows, count), between)
            rows, count = [], count + len(rows)
        if first.startswith(LABVIEW_END):
            in_head = False
        elif first == "Channels" or in_head:
            in_head = True
            facts[first] = cells
        elif first == LABVIEW_TIME:
            channels = [
                each for each in _pair_clocks(row, LABVIEW_TIME) if row[each[1]] != "Comment"
            ]
            units = facts.get("Y_Unit_Label", [])
            names = [
                with_unit(row[k], units[k - 1] if k <= len(units) else "") for _, k in channels
            ]
            of_time = facts.get("X_Dimension", ["Time"])[0] == "Time"
            if not named:
                yield between.join([with_unit(first, "s" if of_time else ""), *names])
            named = True
        elif channels and (not first or DECIMAL.fullmatch(first)):
            rows.append(row)


def _pair_clocks(header: list[str], clock: str) -> Iterator[tuple[int, int]]:
    """Place of the times and of the values of each channel.

    Args:
        header: Names of the columns.
        clock: Name of a column of times, which are those of the channels behind it.
    """
    at = 0
    for k, name in enumerate(header):
        if name == clock:
            at = k
        elif name:
            yield at, k


def _read_segment(
    facts: Mapping[str, list[str]],
    channels: list[tuple[int, int]],
    rows: list[list[str]],
    since: int,
) -> tuple[list[list[float | None]], list[list[str]]]:
    """Times in s and values of each channel of a segment of LabVIEW.

    Args:
        facts: What its head states, for each column but the first.
        channels: Place of times and values.
        rows: Cells.
        since: Number of rows in the segments before.

    Raises:
        LogError: If neither the rows nor the head have times.
    """
    times = list[list[float | None]]()
    for clock, k in channels:
        if facts.get("X_Columns", [""])[0] != "No":
            times.append([_number(row[clock]) if clock < len(row) else None for row in rows])
            continue
        try:
            begin, step = (float(facts[e][k - 1].replace(",", ".")) for e in ("X0", "Delta_X"))
        except (KeyError, IndexError, ValueError):
            raise LogError(
                "LabVIEW: its rows have no times, and its head no X0 and Delta_X"
            ) from None
        times.append([begin + (since + row) * step for row in range(len(rows))])
    return times, [[row[k] if k < len(row) else "" for row in rows] for _, k in channels]


def _number(text: str) -> float | None:
    """The number of a cell with a decimal point or comma; None of any other cell."""
    return float(text.replace(",", ".")) if DECIMAL.fullmatch(text) else None


def _join_clocks(
    times: list[list[float | None]], cells: list[list[str]], between: str
) -> Iterator[str]:
    """Rows of channels of which each may have times of its own.

    Args:
        times: Of each channel; None where it has no value.
        cells: The values.
        between: What stands between two cells of a row.
    """
    if all(each == times[0] for each in times):
        for at, *row in zip(times[0], *cells, strict=True):
            if at is not None:
                yield between.join([f"{at:.9g}", *row])
        return
    rows: dict[float, list[str]] = {}
    for k, (clock, values) in enumerate(zip(times, cells, strict=True)):
        for at, value in zip(clock, values, strict=True):
            if at is not None and value:
                rows.setdefault(at, [""] * len(cells))[k] = value
    for at in sorted(rows):
        yield between.join([f"{at:.9g}", *rows[at]])


def _is_twincat(lines: list[str]) -> bool:
    """Whether a head has steps below names."""
    firsts = [re.split(r"[:;,\t]", line)[0] for line in lines[:LOOKED_AT_LINES]]
    return TWINCAT_STEP in firsts and "Name" in firsts[: firsts.index(TWINCAT_STEP)]


def _read_twincat(lines: list[str]) -> Iterator[str]:
    """The rows of an export of TwinCAT Scope behind one line of names with their units.

    Each column called ``Name`` has the times of the channels behind it, up to the next one: ms, or
    in units of 100 ns since 1601.

    Args:
        lines: All of the file.

    Raises:
        LogError: If it has no times.
    """
    step = next(k for k, line in enumerate(lines) if line.startswith(TWINCAT_STEP))
    between = lines[step].removeprefix(TWINCAT_STEP)[0]
    cells = [[cell.strip() for cell in line.split(between)] for line in lines]
    head = next((row for row in reversed(cells[:step]) if row[0] == "Name"), ["Name"])
    units = next((row for row in cells[step:] if row[0] == "Unit"), [])
    channels = list(_pair_clocks(head, "Name"))
    words = [units[k].partition(" ")[0] if k < len(units) else "" for _, k in channels]
    rows = [row for row in cells[step:] if DECIMAL.fullmatch(row[0])]
    if not rows:
        raise LogError("TwinCAT Scope: no row has a time; export it again with time columns")
    begin = int(rows[0][0]) if len(rows[0][0]) >= FILETIME_DIGITS else None
    names = [
        with_unit(head[k], "" if word.startswith("(") else word)
        for (_, k), word in zip(channels, words, strict=True)
    ]
    yield between.join(["time [ms]", *names])
    times = [
        [_read_stamp(row[clock], begin) if k < len(row) else None for row in rows]
        for clock, k in channels
    ]
    values = [[row[k] if k < len(row) else "" for row in rows] for _, k in channels]
    yield from _join_clocks(times, values, between)


def _read_stamp(text: str, begin: int | None) -> float | None:
    """The time in ms of a row of TwinCAT Scope; None without one.

    Args:
        text: The cell.
        begin: First of times that count 100 ns since 1601; None of times in ms.
    """
    if begin is None:
        return _number(text)
    return 1e-4 * (int(text) - begin) if text.isdecimal() else None


def _states_step(lines: list[str]) -> bool:
    """Whether the first line is one of names that ends in a first time and a step."""
    return STATED_STEP.search(lines[0]) is not None if lines else False


def _read_stated_step(lines: list[str]) -> Iterator[str]:
    """The rows of an oscilloscope of Rigol with the times that its first lines state.

    Args:
        lines: All of the file.

    Raises:
        LogError: If they state no numbers.
    """
    head, *rows = ([cell.strip() for cell in line.split(",")] for line in lines)
    units = list[str]()
    stated = [cell.partition("=")[2].strip(" s") for cell in head if "=" in cell]
    if not stated:
        units, *rows = rows
        stated = units[head.index("Start") :][:2]
    try:
        begin, step = map(float, stated)
    except ValueError:
        raise LogError("Rigol: its first lines state no first time and no increment") from None
    names = [name for name in head if name and "=" not in name and name not in STEP_NAMES]
    first = int(names[0] in RIGOL_TIMES)
    known = [with_unit(name, unit) for name, unit in zip_longest(names, units, fillvalue="")]
    yield ",".join(["time [s]", *known[first : len(names)]])
    for k, row in enumerate(rows):
        yield ",".join([f"{begin + k * step:.9g}", *row[first : len(names)]])


def _read_yokogawa(lines: list[str]) -> Iterator[str]:
    """The rows of a recorder of Yokogawa with the times that its head states.

    Rows of the head begin with what they state for each channel, rows of values with nothing.

    Args:
        lines: All of the file.

    Raises:
        LogError: If its head states no names or no times.
    """
    rows = [[cell.strip(' "') for cell in line.split(",")] for line in lines]
    stated = {row[0]: row[1:] for row in rows if row[0]}
    try:
        names = stated["TraceName"]
        begin, step = (float(stated[each][0]) for each in ("HOffset", YOKOGAWA_STEP))
    except (KeyError, IndexError, ValueError):
        raise LogError("Yokogawa: its head has no TraceName, HOffset and HResolution") from None
    units = stated.get("VUnit", [])
    named = zip_longest(filter(None, names), units[: len(names)], fillvalue="")
    yield ",".join([with_unit("time", stated.get("HUnit", ["s"])[0]), *starmap(with_unit, named)])
    for k, row in enumerate(row for row in rows if not row[0] and any(row)):
        yield ",".join([f"{begin + k * step:.9g}", *row[1:]])


def _read_arff(lines: list[str]) -> Iterator[str]:
    """The rows of an ARFF file behind a line of the names of its attributes.

    Args:
        lines: All of the file.
    """
    found = [each for each in map(ARFF_ATTRIBUTE.match, lines) if each]
    yield ",".join((each[1] or each[2]).replace(",", " ") for each in found)
    data = next(k for k, line in enumerate(lines) if ARFF_DATA.fullmatch(line))
    for line in lines[data + 1 :]:
        if not line.lstrip().startswith("%"):
            yield line


def _read_wincc(lines: list[str]) -> list[str]:
    """Rows of an archive of a SIMATIC panel, which has one value a row.

    Its times called ms are millionths of a day.

    Args:
        lines: All of the file.
    """
    between = next(sign for sign in ";\t," if sign in lines[0])
    head, *rows = ([cell.strip(' "') for cell in line.split(between)] for line in lines)
    name, time, value = map(head.index, (WINCC_NAME, WINCC_TIME, "VarValue"))
    values = list[tuple[str, str, str, str]]()
    for row in rows:
        if len(row) > time and not row[name].startswith("$"):  # which tells of the panel itself
            seconds = MICRODAY_S * (_number(row[time]) or 0.0)
            values.append((row[name], f"{seconds:.6f}", row[value], ""))
    return _join_values(values, "s")


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


def _read_single_values(lines: list[str]) -> list[str]:
    """Rows of the values of lines with one value each, as Teleplot takes them."""
    found = [each for each in map(ONE_VALUE.fullmatch, lines) if each]
    return _join_values(((e[1], e[2] or "", e[3], e[4] or "") for e in found), "ms")


def _join_values(values: Iterable[tuple[str, str, str, str]], unit: str) -> list[str]:
    """Rows of values; a row ends where a name or time is new.

    Args:
        values: Name, time or nothing, number, and unit or nothing of each.
        unit: Of the times.
    """
    names: dict[str, str] = {}
    rows = list[tuple[str, dict[str, str]]]()
    for name, time, value, of_value in values:
        names.setdefault(name, with_unit(name.replace(";", " "), of_value))
        if not rows or name in rows[-1][1] or rows[-1][0] != time:
            rows.append((time, {}))
        rows[-1][1][name] = value
    return _write_rows(rows, names, unit)


PROGRAMS: tuple[tuple[Callable[[list[str]], bool], Callable[[list[str]], Iterable[str]]], ...] = (
    (lambda lines: any(line.startswith(LABVIEW_END) for line in lines), _read_labview),
    (_is_twincat, _read_twincat),
    (_states_step, _read_stated_step),
    (
        lambda lines: any(line.strip('"').startswith(YOKOGAWA_STEP) for line in lines[:50]),
        _read_yokogawa,
    ),
    (lambda lines: any(ARFF_DATA.fullmatch(line) for line in lines), _read_arff),
    (
        lambda lines: {WINCC_NAME, WINCC_TIME} <= set(re.findall(r"\w+", "".join(lines[:1]))),
        _read_wincc,
    ),
    (_are_documents, _read_documents),
    (
        lambda lines: most_are(lines, lambda line: bool(ONE_VALUE.fullmatch(line))),
        _read_single_values,
    ),
    (lambda lines: most_are(lines, lambda line: bool(INFLUX_LINE.fullmatch(line))), _read_influx),
)
"""Whether a text is one of a program, and its reader."""
