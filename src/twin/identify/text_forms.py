"""Brings texts as boards and programs print them into lines of cells with a line of names.

Known are the clock that the Arduino IDE puts before each line, cells with their names (``x:12.5``),
lines in brackets, names after a comment mark, and units in a line of their own.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable

COMMENT_MARKS = ("#", "%", "//")
RECEIVED = re.compile(r"\s*(\d{1,2}:\d\d:\d\d[.,:]\d+)\s*->\s?(.*)")
"""A line with the clock of the computer that received it, and the rest."""
RECEIVED_NAME = "received"
"""Name of the column of that clock."""
LABELLED = re.compile(
    r"[\s,;|]*[\"']?([A-Za-z_µ°][\w ./µ°\[\]()-]*?)[\"']?\s*[:=]\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?)"
    r"\s*(?=$|[\s,;|])"
)
"""A cell with its name before it."""
WRAPPED = re.compile(r"\s*(?:b['\"])?[\[({]?(.*?)[\])}]?;?(?:(?:\\r)?(?:\\n)?['\"])?\s*")
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
    lines = list(filter(str.strip, text.splitlines()))
    if _most_are(lines, lambda line: RECEIVED.fullmatch(line) is not None):
        lines = [_with_clock(line) for line in lines]
    if _most_are(lines, lambda line: _labelled(line) is not None):
        return _without_names(lines)
    if _most_are(lines, _is_wrapped):
        lines = [found[1] if (found := WRAPPED.fullmatch(line)) else line for line in lines]
    return _without_comments(lines)


def _most_are(lines: list[str], is_one: Callable[[str], bool]) -> bool:
    """Whether most lines in the middle of a text are of a form."""
    some = [line for line in lines if not line.lstrip().startswith(COMMENT_MARKS)]
    some = some[len(some) // 2 :][:LOOKED_AT_LINES]
    return bool(some) and sum(map(is_one, some)) > MOST_LINES_SHARE * len(some)


def _with_clock(line: str) -> str:
    """A line whose clock is a cell."""
    found = RECEIVED.fullmatch(line)
    if found is None:
        return line
    clock, rest = found.groups()
    between = next((sign for sign in ";\t," if sign in rest), " ")
    # the clock has a colon before its milliseconds in some versions
    clock = re.sub(r"[:,](?=\d+$)", ".", clock)
    if _labelled(rest) is not None:
        return f"{RECEIVED_NAME}_s:{_seconds(clock)}{between}{rest}"
    names = re.search(r"\d", rest) is None
    return f"{RECEIVED_NAME if names else clock}{between}{rest}"


def _seconds(clock: str) -> str:
    """A time of day in seconds."""
    hours, minutes, seconds = map(float, clock.split(":"))
    return f"{3600 * hours + 60 * minutes + seconds:.6f}"


def _labelled(line: str) -> list[tuple[str, str]] | None:
    """Names and numbers of a line that has nothing else; None of any other line."""
    found, at = [], 0
    while (cell := LABELLED.match(line, at)) is not None:
        found.append((cell[1].strip(), cell[2]))
        at = cell.end()
    return found if found and not line[at:].strip(" ,;|\t\r") else None


def _without_names(lines: list[str]) -> list[str]:
    """Lines of numbers behind a line of their names; a line without all of them is shorter."""
    cells = [_labelled(line) or [] for line in lines]
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
    return re.fullmatch(r"\s*(b['\"]|[\[({]).*|[^;]*;\s*", line) is not None


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
    for sign in ";\t, ":
        cells = len(line.split(sign if sign != " " else None))
        if cells > 1:
            return len(names.split(sign if sign != " " else None)) == cells
    return False
