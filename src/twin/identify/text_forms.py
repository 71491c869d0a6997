"""Brings texts as boards and programs print them into lines of cells with a line of names.

Known are clocks and levels that terminals and loggers put before each line, cells with their names
(``x:12.5``), lines in brackets, tables drawn with bars, names after a comment mark, units in a line
of their own, the heads of LabVIEW, and one value a line with its name, as for Teleplot.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator
from datetime import UTC, datetime

COMMENT_MARKS = ("#", "%", "//")
_CLOCK = r"(?P<clock>(?:\d{4}-\d\d-\d\d[ T])?\d{1,2}:\d\d:\d\d(?:[.,:]\d+)?)"
_LOG_LEVEL = r"(?:DEBUG|INFO|NOTICE|WARN|WARNING|ERROR)"
LINE_PREFIXES = tuple(
    re.compile(rf"\s*{prefix}(?P<rest>.*)")
    for prefix in (
        rf"{_CLOCK}\s*->\s?",  # Arduino
        rf"\[{_CLOCK}\]:?\s*",  # Tera Term
        rf"{_CLOCK}(?: -)?(?: [\w.]+ -)? \[?{_LOG_LEVEL}\]?:?(?: -)? (?:[\w.]+: )?",  # Python
        rf"{_CLOCK} +(?=[^\s;,|].*[;,\t])",  # CoolTerm
        rf"(?P<seconds>\d{{9,}}\.\d+) (?:- )?(?:[\w.]+ )?(?:- )?\[?{_LOG_LEVEL}\]?:?(?: -)? "
        r"(?:[\w.]+:? )?",
        r"[A-Z][a-z]{2} [ \d]\d \d\d:\d\d:\d\d \S+ [^\s:]+: ",  # syslog, times in whole s
        rf"\[{_LOG_LEVEL}\] \[(?P<seconds>\d+\.\d+)\](?: \[[^\]]*\])?:? ",  # ROS
        r"[DIWE] \((?P<millis>\d+)\) [\w.-]+: ",  # ESP32
        rf"{_LOG_LEVEL}:[\w.]*:\s*",  # Python, without a clock
    )
)
"""What stands before the cells of a line: a clock, a level, a name."""
RECEIVED_NAME = "received"
"""Name of the column of that clock."""
LABVIEW_END = "***End_of_Header***"
"""Line with which a head of LabVIEW ends."""
LABVIEW_TIME = "X_Value"
"""Name of a column of times of LabVIEW."""
ONE_VALUE = re.compile(
    r"\s*>([^:;|]+):(?:(\d+(?:\.\d+)?):)?([-+]?[\d.]+(?:[eE][-+]?\d+)?)(?:§([^|]*))?(?:\|.*)?"
)
"""A value with its name and its time in ms, as Teleplot takes it."""
SEPARATE_UNIT = re.compile(
    r"(?<=\w)\s+(?=(?:\[[^\W\d]\S*\]|\([^\W\d]\S*\)|[\[(][°%][\])])(?:\s|$))"
)
"""Blanks between a name and its unit in brackets."""
BARRED_ROW = re.compile(r"\s*\|.*\|\s*")
"""A row of a table drawn with bars."""
RULED_LINE = re.compile(r"[-+|:=\s]*-[-+|:=\s]*")
"""A line drawn in such a table."""
LABELLED_CELL = re.compile(
    r"[\s,;|]*[\"']?([A-Za-z_µ°][\w ./µ°\[\]()-]*?)[\"']?\s*[:=]\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?)"
    r"\s*(?=$|[\s,;|])"
)
"""A cell with its name before it."""
TERMINAL_CODE = re.compile(r"\x1b\[[\d;?]*[A-Za-z]")
"""What colours or moves the text of a terminal."""
CHECKED_SENTENCE = re.compile(r"\s*\$([^*]*)\*[0-9A-Fa-f]{2}\s*")
"""A line with a check sum, as of NMEA 0183."""
PRINTED_LIST = re.compile(r"\s*(?:b['\"])?[\[({<]?(.*?)[\])}>]?;?(?:(?:\\r)?(?:\\n)?['\"])?\s*")
"""A line as Python prints a list, a tuple or bytes."""
MOST_LINES_SHARE = 0.8
"""Share of the lines above which they are all taken to be of a form."""
LOOKED_AT_LINES = 50
"""Number of lines in the middle of a text by which its form is recognised."""


def plain_lines(text: str) -> list[str]:
    """The lines of a text, in which cells follow a line of names if there is one.

    Args:
        text: All of it.
    """
    lines = list(filter(str.strip, TERMINAL_CODE.sub("", text.replace("−", "-")).splitlines()))
    if any(line.startswith(LABVIEW_END) for line in lines):
        return list(_read_labview(lines))
    if _most_are(lines, lambda line: ONE_VALUE.fullmatch(line) is not None):
        return _join_values(lines)
    for prefix in LINE_PREFIXES:
        if _most_are(lines, lambda line: prefix.fullmatch(line) is not None):  # noqa: B023
            lines = [_with_clock(line, prefix) for line in lines]
            break
    if _most_are(lines, lambda line: BARRED_ROW.fullmatch(line) is not None):
        lines = [line.strip().strip("|") for line in lines if not RULED_LINE.fullmatch(line)]
    if _most_are(lines, lambda line: CHECKED_SENTENCE.fullmatch(line) is not None):
        lines = [
            found[1] if (found := CHECKED_SENTENCE.fullmatch(line)) else line for line in lines
        ]
    if _most_are(lines, lambda line: _split_labels(line) is not None):
        return _without_names(lines)
    if _most_are(lines, _is_wrapped):
        lines = [found[1] if (found := PRINTED_LIST.fullmatch(line)) else line for line in lines]
    return _without_comments(lines)


def _most_are(lines: list[str], is_one: Callable[[str], bool]) -> bool:
    """Whether most lines in the middle of a text are of a form."""
    some = [line for line in lines if not line.lstrip().startswith(COMMENT_MARKS)]
    some = some[len(some) // 2 :][:LOOKED_AT_LINES]
    return bool(some) and sum(map(is_one, some)) > MOST_LINES_SHARE * len(some)


def _with_clock(line: str, prefix: re.Pattern[str]) -> str:
    """A line with its clock as a cell, in s where it is a number, and nothing else before it."""
    found = prefix.fullmatch(line)
    if found is None:
        return line
    rest, given = found["rest"], found.groupdict()
    clock = given.get("clock") or given.get("seconds")
    if millis := given.get("millis"):
        clock = f"{1e-3 * float(millis):.3f}"
    if clock is None:
        return rest
    # the clock has a comma or a colon before its milliseconds in some versions
    clock = re.sub(r"(?<=:\d\d)[:,](?=\d+$)", ".", clock)
    between = next((sign for sign in ";\t," if sign in rest), " ")
    if " " in clock and between == " ":
        rest, between = ";".join(rest.split()), ";"
    if _split_labels(rest) is not None:
        try:
            return f"{RECEIVED_NAME}_s:{_seconds(clock)}{between}{rest}"
        except ValueError:  # a date that does not exist
            return rest
    names = re.search(r"\d", rest) is None
    return f"{RECEIVED_NAME if names else clock}{between}{rest}"


def _seconds(clock: str) -> str:
    """A time of day, with or without a date, in seconds.

    Raises:
        ValueError: If there is no such date.
    """
    if ":" not in clock:
        return clock
    if "-" in clock:
        return f"{datetime.fromisoformat(clock).replace(tzinfo=UTC).timestamp():.6f}"
    hours, minutes, seconds = map(float, clock.split(":"))
    return f"{3600 * hours + 60 * minutes + seconds:.6f}"


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
            begin, step = (float(facts[key][0].replace(",", ".")) for key in ("X0", "Delta_X"))
            yield between.join([f"{begin + row * step:.9g}", *cells[: len(names) - 1]])
            row += 1
        else:
            yield between.join([first, *cells][: len(names)])


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


def _join_values(lines: list[str]) -> list[str]:
    """Rows of the values of lines with one value each; a row ends where a name or time is new."""
    names: dict[str, str] = {}
    rows = list[tuple[str, dict[str, str]]]()
    for line in lines:
        if (found := ONE_VALUE.fullmatch(line)) is None:
            continue
        name, time, value, unit = found.groups()
        names.setdefault(name, name.replace(",", " ") + (f" [{unit}]" if unit else ""))
        if not rows or name in rows[-1][1] or rows[-1][0] != (time or ""):
            rows.append((time or "", {}))
        rows[-1][1][name] = value
    timed = ["time [ms]"] if any(time for time, _ in rows) else []
    header = ",".join((*timed, *names.values()))
    return [
        header,
        *(
            ",".join(([time] if timed else []) + [cells.get(name, "") for name in names])
            for time, cells in rows
        ),
    ]


def _split_labels(line: str) -> list[tuple[str, str]] | None:
    """Names and numbers of a line that has nothing else; None of any other line."""
    found, at = [], 0
    while (cell := LABELLED_CELL.match(line, at)) is not None:
        found.append((cell[1].strip(), cell[2]))
        at = cell.end()
    return found if found and not line[at:].strip(" ,;|\t\r") else None


def _without_names(lines: list[str]) -> list[str]:
    """Lines of numbers behind a line of their names; a line without all of them is shorter."""
    cells = [_split_labels(line) or [] for line in lines]
    while not cells[0]:  # a board's messages before it measures
        del cells[0]
    usual = Counter(tuple(name for name, _ in each) for each in cells if each).most_common(1)[0][0]
    numbers = [
        ",".join(number for _, number in each) if tuple(n for n, _ in each) == usual else "cut"
        for each in cells
    ]
    return [",".join(usual), *numbers]


def _is_wrapped(line: str) -> bool:
    """Whether a line begins with a bracket or as bytes of Python, or ends in its only semicolon."""
    return re.fullmatch(r"\s*(b['\"]|[\[({<]).*|[^;]*;\s*", line) is not None


def _without_comments(lines: list[str]) -> list[str]:
    """Lines without comments, but with the last one before the numbers if it names the cells."""
    kept, names = list[str](), ""
    for line in lines:
        bare = line.lstrip()
        if not bare.startswith(COMMENT_MARKS):
            kept.append(line)
        elif not kept:
            names = bare.lstrip("#%/ \t")
    if not names or not kept or re.match(r"\s*[-+]?[\d.,]", kept[0]) is None:
        return kept
    return [names, *kept] if _has_as_many_cells(names, kept[len(kept) // 2]) else kept


def _has_as_many_cells(names: str, line: str) -> bool:
    """Whether a line of names has as many cells as one of numbers, and more than one."""
    for sign in ";\t,":
        if (cells := len(line.split(sign))) > 1:
            return len(names.split(sign)) == cells
    return len(split_at_blanks(names)) == len(line.split()) > 1


def split_at_blanks(line: str) -> list[str]:
    """The cells of a line between blanks; a unit in brackets belongs to the name before it."""
    return SEPARATE_UNIT.sub("", line).split()
