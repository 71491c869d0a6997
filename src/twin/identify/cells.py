"""Numbers of the cells of a log: decimal signs, marks of thousands, hexadecimal digits, times."""

from __future__ import annotations

import math
import re
from contextlib import suppress
from datetime import UTC, datetime

import numpy as np

from controllers.arrays import Array

BLANK_CELLS = {"", "?", "nan", "na", "n/a", "none", "null", "-", "--", "inf", "-inf"}
"""Cells without a number, in small letters."""
BOOLEAN_WORDS = {"true": 1.0, "false": 0.0, "yes": 1.0, "no": 0.0}
"""Words that stand for a number, in small letters."""
NUMBER = r"[-+]?[0-9]*[.,]?[0-9]+(?:[eEdD][-+]?[0-9]+)?[.,]?"
NUMBER_WITH_UNIT = re.compile(
    rf"({NUMBER})\s*([mµu]?s|[mu]?secs?|seconds?|[mcµu]?m|m?rad|deg(?:rees?)?|°|px|m?V|%)?"
)
"""A number, and the unit that follows it in some cells."""
LIST_CELL = re.compile(rf"[\[(]\s*{NUMBER}(?:[\s,;]+{NUMBER})+\s*[\])]")
"""A cell with several numbers in brackets."""
THOUSANDS = re.compile(r"[-+]?(?:\d{1,3}|[1-9]\d{0,2}([.,])\d{3}(?:\1\d{3})*)")
"""A whole number, with a mark before each three digits from 1000 on."""
MIN_THOUSANDS = 10
"""Least number of cells with such marks, and of cells that need none."""
HEXADECIMAL = re.compile(r"0[xX][0-9A-Fa-f]+")
"""A hexadecimal number, as C has it."""
HEX_DIGITS = re.compile(r"(?:[0-9A-F]{4}){1,2}")
"""Four or eight hexadecimal digits alone."""
HEX_WIDTHS = (2, 4, 8)
"""Digits of numbers of 8, 16 and 32 bits, which may be signed."""
MAX_SIGNED_SHARE = 0.5
"""Sum of the steps of signed numbers, over that of unsigned ones, below which they are signed."""
_MONTHS = {
    name: f"{k:02d}"
    for k, name in enumerate(
        ["jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec"],
        start=1,
    )
}
TIME_OF_DAY = re.compile(
    r"(?:(?P<days>\d+) days? )?"
    r"(?:(?P<day>\d{1,2})(?P<sign>[./-])(?P<month>\d{1,2})(?P=sign)(?P<year>\d{4}),? )?"
    r"(?:(?P<hours>\d{1,2}):|(?=\d\d:\d\d\.))(?P<minutes>\d\d):(?P<seconds>\d\d(?:\.\d+)?)"
    r"(?: (?P<half>am|pm))?"
)
"""A time of day, after a number of days or a date that does not begin with the year; without hours
its seconds have a fraction."""


def parse_numbers(cells: Array | list[str]) -> tuple[Array, int]:
    """Numbers of cells, NaN where there is none, and how many are neither number nor blank.

    A comma is a decimal sign, or with a point in the same cell whichever of the two is last.
    Hexadecimal numbers are counts, see ``describe_hexadecimal``.
    """
    if not isinstance(cells, list):
        return np.where(np.isfinite(cells), cells, np.nan), 0
    if _are_hexadecimal(cells):
        return _parse_hexadecimal(cells)[0], 0
    values, broken = np.full(len(cells), np.nan), 0
    mark = _thousands_mark(cells)
    for k, cell in enumerate(cells):
        word = cell.casefold()
        if mark:
            word = word.replace(mark, "")
        elif ":" in word:
            word = re.sub(r",(?=\d)", ".", word)
        elif "," in word:
            if word.rfind(".") > word.rfind(","):
                word = word.replace(",", "")
            elif "." in word:
                word = word.replace(".", "")
            word = word.replace(",", ".")
        try:
            values[k] = _number(word)
        except ValueError:
            broken += word not in BLANK_CELLS
    values[~np.isfinite(values)] = np.nan
    return values, broken


def _are_hexadecimal(cells: list[str]) -> bool:
    """Whether all cells are hexadecimal; without ``0x`` all have one width and some a letter."""
    known = [cell for cell in cells if cell.casefold() not in BLANK_CELLS]
    if not known or not (HEXADECIMAL.fullmatch(known[0]) or HEX_DIGITS.fullmatch(known[0])):
        return False
    if all(map(HEXADECIMAL.fullmatch, known)):
        return True
    one_width = len({len(cell) for cell in known}) == 1
    if not one_width or not all(map(HEX_DIGITS.fullmatch, known)):
        return False
    # decimal numbers have no letter, words no digit
    return not all(map(str.isdigit, known)) and not all(map(str.isalpha, known))


def _parse_hexadecimal(cells: list[str]) -> tuple[Array, int]:
    """Numbers of hexadecimal cells, NaN where there is none, and bits of signed ones, else 0.

    They are signed where all have the width of 8, 16 or 32 bits and stay closer together so.
    """
    blank = [cell.casefold() in BLANK_CELLS for cell in cells]
    values = np.array(
        [np.nan if no else int(cell, 16) for cell, no in zip(cells, blank, strict=True)]
    )
    widths = {
        len(cell.casefold().removeprefix("0x"))
        for cell, no in zip(cells, blank, strict=True)
        if not no
    }
    if len(widths) > 1 or not widths <= set(HEX_WIDTHS):
        return values, 0
    bits = 4 * widths.pop()
    signed = np.where(values >= 2.0 ** (bits - 1), values - 2.0**bits, values)
    ways = [np.abs(np.diff(each[np.isfinite(each)])).sum() for each in (signed, values)]
    return (signed, bits) if ways[0] < MAX_SIGNED_SHARE * ways[1] else (values, 0)


def describe_hexadecimal(cells: Array | list[str]) -> str:
    """What hexadecimal cells are read as, in words; empty for any other cells."""
    if not isinstance(cells, list) or not _are_hexadecimal(cells):
        return ""
    bits = _parse_hexadecimal(cells)[1]
    return f"hexadecimal, read as {f'signed counts of {bits} bits' if bits else 'counts'}"


def _thousands_mark(cells: list[str]) -> str:
    """The sign that marks thousands in whole numbers, as in ``980`` and ``1,000``; empty for none.

    Some numbers have it, always before three digits, and smaller ones do not.
    """
    found = [THOUSANDS.fullmatch(cell) for cell in cells if cell.casefold() not in BLANK_CELLS]
    marks = [each[1] or "" for each in found if each]
    (mark, *others) = set(marks) - {""} or {""}
    shares = min(marks.count(mark), marks.count(""))
    return mark if mark and not others and all(found) and shares >= MIN_THOUSANDS else ""


def _number(word: str) -> float:
    """The number of a cell in small letters, with a point; of a time seconds.

    It may be in brackets, have marks of thousands or an exponent of Fortran.

    Raises:
        ValueError: If it is none.
    """
    if word in BOOLEAN_WORDS:
        return BOOLEAN_WORDS[word]
    with suppress(ValueError):
        return float(word)
    bare = re.sub(r"(?<=\d)[\s'\u2019](?=\d{3}(?!\d))", "", word.strip("[]()"))
    with suppress(ValueError):
        return float(re.sub(r"(?<=[\d.])d(?=[-+]?\d+$)", "e", bare))
    return _parse_time(word)


def _parse_time(word: str) -> float:
    """Seconds of a date, a time of day or a number of days and hours.

    Args:
        word: The cell in small letters, with a point.

    Raises:
        ValueError: If it is none.
    """
    word = _with_plain_date(word)
    found = TIME_OF_DAY.fullmatch(word)
    if found is None:
        whole = re.sub(r"z(?=[-+]\d)", "", word).upper()  # of mosquitto: a Z before the offset
        return datetime.fromisoformat(whole).replace(tzinfo=UTC).timestamp()
    hours = int(found["hours"] or 0)
    seconds = 3600.0 * hours + 60.0 * int(found["minutes"]) + float(found["seconds"])
    if found["half"]:
        seconds += 43200.0 * ((found["half"] == "pm") - (hours == 12))
    if found["year"]:
        day, month = int(found["day"]), int(found["month"])
        if found["sign"] == "/" and day <= 12:  # as in the United States
            day, month = month, day
        return datetime(int(found["year"]), month, day, tzinfo=UTC).timestamp() + seconds
    return 86400.0 * int(found["days"] or 0) + seconds


def _with_plain_date(word: str) -> str:
    """A time with its month as a number, dashes in a date from the year on, and a decimal point."""
    word = re.sub(r"(?<=\d:\d\d:\d\d):(?=\d{2,3}$)", ".", word)
    word = re.sub(r"(?<=\d[-. ])[a-z]{3}(?=[-. ]\d)", lambda m: _MONTHS.get(m[0], m[0]), word)
    return re.sub(r"^(\d{4})[/.](\d\d)[/.](\d\d)", r"\1-\2-\3", word)


def are_times_of_day(cells: Array | list[str]) -> bool:
    """Whether cells are times of day without a date, by the first that is not empty."""
    if not isinstance(cells, list):
        return False
    first = next(filter(None, cells), "").casefold().replace(",", ".")
    found = TIME_OF_DAY.fullmatch(_with_plain_date(first))
    return found is not None and not (found["year"] or found["days"])


def is_time(cell: str) -> bool:
    """Whether a cell is a date with a time, or a time of day."""
    with suppress(ValueError):
        return ":" in cell and math.isfinite(_parse_time(cell.casefold()))
    return False


def is_number(cell: str) -> bool:
    """Whether a cell is a number, with or without a unit, or a list of numbers in brackets."""
    bare = cell.strip("[]()")
    if HEX_DIGITS.fullmatch(bare):
        return not bare.isalpha()
    numbers = (NUMBER_WITH_UNIT, HEXADECIMAL)
    return any(each.fullmatch(bare) for each in numbers) or bool(LIST_CELL.fullmatch(cell))
