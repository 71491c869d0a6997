"""Brings texts as boards and programs print them into lines of cells with a line of names.

Known are clocks and levels that terminals and loggers put before each line, cells with their names
(``x:12.5``), lines in brackets, tables drawn with bars, names after a comment mark, units in a line
of their own, and the forms of single programs of ``program_texts``.
"""

from __future__ import annotations

import re
from collections import Counter
from datetime import UTC, datetime
from itertools import islice

from twin.identify.program_texts import COMMENT_MARKS, most_are, rows_of_program

_CLOCK = r"(?P<clock>(?:\d{4}-\d\d-\d\d[ T])?\d{1,2}:\d\d:\d\d(?:[.,:]\d+)?)(?:Z|[-+]\d\d:?\d\d)?"
_LOG_LEVEL = r"(?:DEBUG|INFO|NOTICE|WARN|WARNING|ERROR)"
LINE_PREFIXES = tuple(
    re.compile(rf"\s*{prefix}(?P<rest>.*)")
    for prefix in (
        rf"{_CLOCK}\s*-?>\s?",  # Arduino, PlatformIO
        rf"\[(?:\d+ )?{_CLOCK}\]:?\s*",  # Tera Term, also with the days since its start
        rf"{_CLOCK}(?: -)?(?: [\w.]+ -)? \[?{_LOG_LEVEL}\]?:?(?: -)? (?:[\w.]+: )?",  # Python
        rf"{_CLOCK} +(?=[^\s;,|].*[;,\t])",  # CoolTerm
        rf"{_CLOCK} +(?=[A-Za-z_][\w.]*\s*[:=]\s*[-+.\d\[(])",  # Docker, before cells with names
        r"\[(?P<clock>\d\d:\d\d:\d\d\.\d{3},\d{3})\] <[a-z]+> [\w.]+: ",  # Zephyr
        rf"(?P<seconds>\d{{9,}}\.\d+) (?:- )?(?:[\w.]+ )?(?:- )?\[?{_LOG_LEVEL}\]?:?(?: -)? "
        r"(?:[\w.]+:? )?",
        r"[A-Z][a-z]{2} [ \d]\d \d\d:\d\d:\d\d \S+ [^\s:]+: ",  # syslog, whose times are whole s
        rf"\[{_LOG_LEVEL}\] \[(?P<seconds>\d+\.\d+)\](?: \[[^\]]*\])?:? ",  # ROS
        r"[DIWE] \((?P<millis>\d+)\) [\w.-]+: ",  # ESP32
        rf"{_LOG_LEVEL}:[\w.]*:\s*",  # Python, without a clock
    )
)
"""What stands before the cells of a line: a clock, a level, a name."""
RECEIVED_NAME = "received"
"""Name of the column of that clock."""
SEPARATE_UNIT = re.compile(
    r"(?<=\w)\s+(?=(?:\[[^\W\d]\S*\]|\([^\W\d]\S*\)|[\[(][°%][\])])(?:\s|$))"
)
"""Blanks between a name and its unit in brackets."""
BARRED_ROW = re.compile(r"\s*\|.*\|\s*")
"""A row of a table drawn with bars."""
RULED_LINE = re.compile(r"[-+|:=\s]*-[-+|:=\s]*")
"""A line drawn in such a table."""
LABELLED_CELL = re.compile(
    r"[\s,;|]*[\"']?([A-Za-z_µ°][\w ./µ°\[\]()-]*?)[\"']?\s*[:=]\s*"
    r"(0x[\dA-Fa-f]+|[-+]?[\d.]+(?:[eE][-+]?\d+)?|[\[(][-+\d.eE,;\s]+[\])])"
    r"(?:\s*([mµu]?s|[mcµu]?m|m?rad|deg|°|px|m?V|%))?\s*(?=$|[\s,;|])"
)
"""A cell with its name before it, and a unit behind some; or several in brackets."""
TERMINAL_CODE = re.compile(r"\x1b\[[\d;?]*[A-Za-z]")
"""What colours or moves the text of a terminal."""
CHECKED_SENTENCE = re.compile(r"\s*\$([^*]*)\*[0-9A-Fa-f]{2}\s*")
"""A line with a check sum, as of NMEA 0183."""
PRINTED_LIST = re.compile(r"\s*(?:b['\"])?[\[({<]?(.*?)[\])}>]?;?(?:(?:\\r)?(?:\\n)?['\"])?\s*")
"""A line as Python prints a list, a tuple or bytes."""


def plain_lines(text: str) -> list[str]:
    """The lines of a text, in which cells follow a line of names if there is one.

    Args:
        text: All of it.
    """
    lines = list(filter(str.strip, TERMINAL_CODE.sub("", text.replace("−", "-")).splitlines()))
    if lines and ";" not in lines[len(lines) // 2]:  # of rows without any they begin remarks
        lines = [line for line in lines if not line.startswith(";")]
    if (rows := rows_of_program(lines)) is not None:
        return rows
    for prefix in LINE_PREFIXES:
        if most_are(lines, lambda line: prefix.fullmatch(line) is not None):  # noqa: B023
            lines = [_with_clock(line, prefix) for line in lines]
            break
    if most_are(lines, lambda line: BARRED_ROW.fullmatch(line) is not None):
        lines = [line.strip().strip("|") for line in lines if not RULED_LINE.fullmatch(line)]
    if most_are(lines, lambda line: CHECKED_SENTENCE.fullmatch(line) is not None):
        lines = [
            found[1] if (found := CHECKED_SENTENCE.fullmatch(line)) else line for line in lines
        ]
    if most_are(lines, lambda line: _split_labels(line) is not None):
        return _without_names(lines)
    if most_are(lines, _is_wrapped):
        lines = [found[1] if (found := PRINTED_LIST.fullmatch(line)) else line for line in lines]
    return _without_comments(lines)


def _with_clock(line: str, prefix: re.Pattern[str]) -> str:
    """A line whose clock is a cell, in s where it is a number, without what else is before it."""
    found = prefix.fullmatch(line)
    if found is None:
        return line
    rest, given = found["rest"], found.groupdict()
    clock = given.get("clock") or given.get("seconds")
    if millis := given.get("millis"):
        clock = f"{1e-3 * float(millis):.3f}"
    if clock is None:
        return rest
    # a comma or a colon before the milliseconds in some versions, in Zephyr one behind them
    clock = re.sub(r"(?<=\.\d{3}),", "", clock)
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


def _split_labels(line: str) -> list[tuple[str, str]] | None:
    """Names and numbers of a line that has nothing else; None of any other line."""
    found, at = [], 0
    while (cell := LABELLED_CELL.match(line, at)) is not None:
        name, value, unit = cell[1].strip(), cell[2], cell[3]
        ending = f" [{unit}]" if unit else ""
        if value[0] in "[(":
            each = re.findall(r"[^\s,;()\[\]]+", value)
            found += [(f"{name}.{k}{ending}", number) for k, number in enumerate(each)]
        else:
            found.append((f"{name}{ending}", value))
        at = cell.end()
    return found if found and not line[at:].strip(" ,;|\t\r") else None


def _without_names(lines: list[str]) -> list[str]:
    """Lines of numbers behind a line of their names; a line without all of them is shorter."""
    cells = [_split_labels(line) or [] for line in lines]
    while not cells[0]:  # what a board says before it measures
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
    """Lines without comments, but with the last one before the numbers that names the cells."""
    kept, comments = list[str](), list[str]()
    for line in lines:
        bare = line.lstrip()
        if not bare.startswith(COMMENT_MARKS):
            kept.append(line)
        elif not kept:
            comments.append(bare.lstrip("#%/ \t"))
    if not kept or re.match(r"\s*[-+]?[\d.,]", kept[0]) is None:
        return kept
    some = kept[len(kept) // 2]
    named = (each for each in reversed(comments) if each and _has_as_many_cells(each, some))
    return [*islice(named, 1), *kept]


def _has_as_many_cells(names: str, line: str) -> bool:
    """Whether a line of names has as many cells as one of numbers, and more than one."""
    for sign in ";\t,":
        if (cells := len(line.split(sign))) > 1:
            return len(names.split(sign)) == cells
    return len(split_at_blanks(names)) == len(line.split()) > 1


def split_at_blanks(line: str) -> list[str]:
    """The cells of a line between blanks; a unit in brackets belongs to the name before it."""
    return SEPARATE_UNIT.sub("", line).split()
