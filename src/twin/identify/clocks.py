"""Clocks as boards and programs write them: counters that wrap, seconds with nanoseconds apart."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from controllers.arrays import Array

WRAPS = (2.0**8, 2.0**16, 2.0**24, 2.0**32, 2.0**32 / 1e3, 2.0**32 / 1e6)
"""Numbers at which a counter begins again at 0: of 8, 16, 24 and 32 bits; the last also of us that
a board turned into ms and s."""
WRAPS_OF_DAY_S = (3600.0, 43200.0, 86400.0)
"""The same of a time of day in s, of one hour, 12 and 24 hours."""
MAX_WRAP_STEPS = 3.0
"""Usual steps that may lie between the last number before a wrap and the first one after it."""
SECONDS = re.compile(r"(?i)(.*?)(secs?|seconds?)")
NANOSECONDS = re.compile(r"(?i)(.*?)(nsecs?|nanosecs?|nanoseconds?)")
"""Names of columns of whole seconds and of nanoseconds, after a beginning that both share."""
MILLISECONDS = re.compile(r"(?i)ms|msecs?|millis|milliseconds?")
"""Name of a column of milliseconds next to one of dates in whole seconds."""
STEP_WORDS = re.compile(
    r"(?i)sampl(?:e|ing)[ _]?(?:interval|period|time)|time[ _]?(?:step|increment)"
)
RATE_WORDS = re.compile(r"(?i)sampl(?:e|ing)[ _]?(?:rate|frequency)")
"""What heads of logs call the time between two rows, and its inverse."""
STATED = re.compile(r"([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*([mµunk]?(?:s|Hz|S/s|Sa/s))?")
"""A stated number with its unit."""
HEAD_LETTERS = 4000
"""Number of letters at the beginning of a text in which a rate is looked for."""


def unwrap(numbers: Array, *, of_day: bool = False) -> tuple[Array, int]:
    """Numbers of a clock that go on where it wraps, and how often it wraps.

    A clock that is set back to 0 at any other number begins anew, and is left as it is.

    Args:
        numbers: As they stand in the log, NaN where there is none, shape (K,).
        of_day: Whether they are times of day in s.
    """
    there = np.flatnonzero(np.isfinite(numbers))
    known = numbers[there]
    steps = np.diff(known)
    rising = steps[steps > 0]
    if not len(rising):
        return numbers, 0
    longest = MAX_WRAP_STEPS * float(np.median(rising))
    for period in WRAPS_OF_DAY_S if of_day else WRAPS:
        low = -period / 2 if known.min() < 0 else 0.0
        after = steps + period
        wraps = (steps < 0) & (after > 0) & (after <= longest)
        if (
            wraps.any()
            and longest < period / 8
            and low <= known.min() <= known.max() < low + period
        ):
            going = numbers.copy()
            going[there[1:]] += period * np.cumsum(wraps)
            return going, int(wraps.sum())
    return numbers, 0


def pair_seconds(names: Sequence[str]) -> list[tuple[int, int]]:
    """Columns of whole seconds, each with the column of its nanoseconds, as ROS writes a stamp.

    Args:
        names: Of the columns, without units.
    """
    stems = {
        found[1].casefold(): k
        for k, name in enumerate(names)
        if (found := NANOSECONDS.fullmatch(name)) is not None
    }
    return [
        (k, stems[found[1].casefold()])
        for k, name in enumerate(names)
        if (found := SECONDS.fullmatch(name)) is not None and found[1].casefold() in stems
    ]


def find_stated_step(text: str) -> float | None:
    """The time in s between two rows that the head of a text states; None if it states none.

    Args:
        text: All of it.
    """
    for line in text[:HEAD_LETTERS].splitlines():
        cells = [cell.strip(" \"'#%/[]") for cell in re.split(r"[,;:\t=]", line)]
        for k, cell in enumerate(cells):
            inverse = RATE_WORDS.match(cell)
            if not inverse and not STEP_WORDS.match(cell):
                continue
            for found in filter(None, map(STATED.fullmatch, cells[k + 1 :])):
                unit = (found[2] or "").replace("Sa/s", "Hz").replace("S/s", "Hz")
                scale = {"m": 1e-3, "u": 1e-6, "µ": 1e-6, "n": 1e-9, "k": 1e3}.get(unit[:1], 1.0)
                number = scale * float(found[1])
                if number > 0:
                    return 1 / number if inverse else number
    return None
