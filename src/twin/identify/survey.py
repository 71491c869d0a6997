"""Surveys a log of an unknown program: its columns, and the roles that they may have."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from controllers.arrays import Array, Mask
from twin.base.errors import LogError, plural
from twin.identify.cells import are_times_of_day, describe_hexadecimal, parse_numbers
from twin.identify.clocks import find_stated_step, unwrap
from twin.identify.column_names import COUNTER, Suggestion, suggest_kinds
from twin.identify.log_columns import (
    AXIS_COLUMNS,
    ROLE_UNITS,
    ROLES_OF_BOTH_AXES,
    ROW_NAME,
    unit_factor,
)
from twin.identify.log_tables import MIN_UNIX_TIME_S, open_content, split_content
from twin.identify.samples import are_copies, find_noise
from twin.run.readers import ForeignTable
from twin.run.units import OTHER_UNITS, UNIT_SCALES, plain_unit, split_unit

NAME_UNITS = {"millis": "ms", "micros": "us", "ms": "ms", "us": "us"}
"""Names that state the unit of their numbers."""
UNIT_ENDING = re.compile(
    r"(?i)(.+?)(?:[_ ]in)?[_ ](m?s|[un]s|[mu]?sec|[mcu]?m|m?rad|deg|degrees|grad|°)"
)
"""A name that ends in its unit, as ``x_mm``."""
TIME_STEPS = (("s", 1e-5, 0.5), ("ms", 0.5, 500.0), ("us", 500.0, 5e5), ("ns", 5e5, 5e8))
"""Unit of a time, and from and to which step of its numbers it is assumed."""
MAX_POSITIONS = (("m", 1.2), ("cm", 30.0), ("mm", 500.0))
"""Unit of a position, and up to which largest number it is assumed."""
LENGTH_UNITS = frozenset(UNIT_SCALES["m"])
"""Units that no command has."""
WEAK_WEIGHT = 0.5
"""Weight of a suggestion below which it gives way to any other position."""
MIN_RISING_SHARE = 0.95
"""Share of rows in which a time has to rise."""
COUNTER_DISADVANTAGE = 1.5
"""What a column that counts rows lacks in weight: any column of times is better."""
MIN_COUNTER_STEPS = 10
"""Least number of steps by which numbers are seen to count rows."""
MAX_STEP_SPREAD = 0.5
"""Standard deviation of steps, over the usual one, up to which numbers rise evenly."""
RATE_BLANK = "RATEHz"
"""Unit of a time that only counts rows, until the rate of the rows stands there."""
STATED = "counts rows, and the head of the file states the time between two"
"""Why the number of a row is the time."""
SIZE_BLANK = "SIZEmm"
"""Unit of a position that is in no length, as pixels, until the size of one in mm stands there."""
SIZE_ADVICE = f"give the size of one in the place of {SIZE_BLANK}, as 0.5mm"
"""How a person fills ``SIZE_BLANK``."""
MAX_SMOOTH_RATIO = 0.1
"""Noise of a column, over that of one with a name as clear, below which it is a reference or an
estimate of the other; each as a share of its motion."""
GAP_STEPS = 3.0
"""Times the usual step above which a step of the time is a gap."""


@dataclass(frozen=True)
class SurveyedColumn:
    """A column of a log.

    Attributes:
        name: Its name, or its number in a text without a header.
        unit: Unit in the header or the file; empty if it has none.
        values: Its numbers, NaN where there is none, shape (K,).
        clock: Times in s of its own, shape (K,); None if it has none.
        dated: Whether its cells are dates or times of day; the numbers are then seconds.
        of_day: Whether its cells are times of day without a date.
        said: What its cells are read as, where they are no usual numbers; else empty.
    """

    name: str
    unit: str
    values: Array
    clock: Array | None
    dated: bool = False
    of_day: bool = False
    said: str = ""

    @property
    def range(self) -> str:
        """Its smallest and largest number."""
        known = self.values[np.isfinite(self.values)]
        if not len(known):
            return "no number"
        ends = float(known.min()), float(known.max())
        low, high = (f"{end:.4g}" for end in ends)
        if low == high and ends[0] < ends[1]:  # as of seconds since 1970
            low, high = (f"{end:.15g}" for end in ends)
        return f"{low} to {high}"

    @property
    def missing(self) -> int:
        """Rows without a number."""
        return int((~np.isfinite(self.values)).sum())


@dataclass(frozen=True)
class RoleGuess:
    """A column that may have a role.

    Attributes:
        role: One of ``ROLE_UNITS``.
        column: Its name.
        unit: Its unit; empty for the unit of the header, or SI if that has none.
        why: The reason, in words.
    """

    role: str
    column: str
    unit: str
    why: str

    @property
    def option(self) -> str:
        """As ``--columns`` has it."""
        return f"{self.role}={self.column}" + (f":{self.unit}" if self.unit else "")


@dataclass(frozen=True)
class Survey:
    """The content of a log.

    Attributes:
        path: The file.
        columns: Those with numbers.
        guesses: Columns that may have a role.
        notes: What was left out, and what the times do.
        typed: Words of the command line that was typed, which lacks its columns.
    """

    path: Path
    columns: tuple[SurveyedColumn, ...]
    guesses: tuple[RoleGuess, ...]
    notes: tuple[str, ...]
    typed: tuple[str, ...]

    @property
    def command(self) -> str:
        """The command line that would use the log, with a blank for each lacking role."""
        options = [guess.option for guess in self.guesses]
        roles = {guess.role for guess in self.guesses}
        if not roles & {"time"} and any(column.clock is None for column in self.columns):
            options.insert(0, "time=NAME:s")
        if not roles & {"measured_x", "measured_y"}:
            of_y = any(role.endswith("_theta") for role in roles)
            of_x = any(role.endswith("_phi") for role in roles)
            ball = "measured_y" if of_y and not of_x else "measured_x"
            options.append(f"{ball}=NAME:m")
            roles.add(ball)
        for ball, angle in (("measured_x", "phi"), ("measured_y", "theta")):
            if ball in roles and not roles & {f"command_{angle}", f"measured_{angle}"}:
                options.append(f"command_{angle}=NAME:deg")
        return shlex.join([*self.typed, "--columns", ",".join(options)])

    def as_dict(self) -> dict[str, Any]:
        """As JSON has it."""
        return {
            "columns": [
                {"name": c.name, "unit": c.unit, "rows": len(c.values), "empty": c.missing}
                for c in self.columns
            ],
            "roles": {
                g.role: {"column": g.column, "unit": g.unit, "why": g.why} for g in self.guesses
            },
            "notes": list(self.notes),
            "command": self.command,
        }


def survey(
    path: Path,
    separator: str | None = None,
    content: ForeignTable | str | None = None,
    typed: Sequence[str] = (),
) -> Survey:
    """Look at what a log holds.

    Args:
        path: A file of any format that is read.
        separator: Between columns of text; None to find it.
        content: The file's table or its text; None to read it.
        typed: Words of the command line that was typed; by default those of ``identify``.

    Raises:
        TwinError: If it cannot be read, or has no column of numbers.
    """
    if content is None:
        content = open_content(path)
    header, cells, clocks, notes = split_content(path.name, content, {}, separator)
    columns = []
    for k, raw in enumerate(cells):
        values, _ = parse_numbers(raw)
        name, unit = split_unit(header[k]) if k < len(header) else (str(k + 1), None)
        if np.isfinite(values).any():
            clock = clocks.get(k)
            dated = isinstance(raw, list) and ":" in next(filter(None, raw))
            columns.append(
                SurveyedColumn(
                    name or str(k + 1),
                    unit or "",
                    values,
                    clock,
                    dated,
                    are_times_of_day(raw),
                    describe_hexadecimal(raw),
                )
            )
    if not columns:
        raise LogError(f"{path.name}: no column time and no column of numbers: not a log")
    guesses, remarks = _leave_out_copies(_guess_roles(columns), columns)
    notes += remarks
    step = find_stated_step(content) if isinstance(content, str) else None
    if step is not None:
        guesses = _count_by_step(guesses, step)
    notes += _describe_clock({guess.role: guess for guess in guesses}, columns)
    notes += [f"{column.name}: {column.said}" for column in columns if column.said]
    names = [column.name for column in columns]
    for name in dict.fromkeys(name for name in names if names.count(name) > 1):
        notes.append(f"{names.count(name)} columns are called {name}: give their numbers")
    described: set[int] = set()
    for column in columns:
        if column.clock is not None and id(column.clock) not in described:
            described.add(id(column.clock))
            notes += _describe_times(f"the clock of {column.name}", column.clock)
    words = tuple(typed) or ("ballplate", "identify", str(path))
    return Survey(path, tuple(columns), tuple(guesses), tuple(notes), words)


def _count_by_step(guesses: list[RoleGuess], step: float) -> list[RoleGuess]:
    """The guesses, with the number of the row as the time where no column is one.

    Args:
        guesses: Of all roles.
        step: Time in s between two rows.
    """
    time = next((guess for guess in guesses if guess.role == "time"), None)
    if time is not None and time.unit != RATE_BLANK:
        return guesses
    counted = RoleGuess("time", time.column if time else ROW_NAME, f"{step:.9g}s", STATED)
    return [counted, *(guess for guess in guesses if guess.role != "time")]


def _leave_out_copies(
    guesses: list[RoleGuess], columns: list[SurveyedColumn]
) -> tuple[list[RoleGuess], list[str]]:
    """The guesses without a column that is the copy of one for the other axis, and notes on it."""
    found = {guess.role: guess.column for guess in guesses}
    values = {column.name: column.values for column in columns}
    left, notes = set[str](), list[str]()
    for role, other in ROLES_OF_BOTH_AXES:
        if {role, other} <= found.keys():
            first, second = found[role], found[other]
            if are_copies(values[first], values[second]):
                left.add(other)
                notes.append(
                    f"{second} equals {first} in every row, up to the sign: one column may be "
                    f"written twice, so it is not taken as {other}; make sure which axis {first} "
                    "is of"
                )
    return [guess for guess in guesses if guess.role not in left], notes


def _describe_clock(found: Mapping[str, RoleGuess], columns: Sequence[SurveyedColumn]) -> list[str]:
    """What the column of the time does, or what a log without one needs, in words.

    Args:
        found: Role to guess.
        columns: Of the log.
    """
    if (guess := found.get("time")) is None:
        if all(column.clock is not None for column in columns):
            return []
        return [
            "no column looks like a time: name one, or for rows at a constant rate give "
            f"time={ROW_NAME}:100Hz"
        ]
    name = guess.column
    if guess.why == STATED:
        return [f"{name}: {guess.why}"]
    if guess.unit == RATE_BLANK:
        return [
            f"{name}: counts rows, and is no time: give their rate in the place of {RATE_BLANK}, "
            f"as time={name}:100Hz"
        ]
    (column,) = (each for each in columns if each.name == name)
    numbers, wraps = unwrap(column.values, of_day=column.of_day)
    factor = unit_factor(guess.unit or column.unit or "s", "s") or 1.0
    notes = _describe_times(name, factor * numbers)
    if wraps:
        notes.append(f"{name}: wraps {plural(wraps, 'time')}, and is taken as going on")
    return notes


def _describe_times(name: str, time: Array) -> list[str]:
    """Rate, gaps, repeated stamps and resets of times in s, in words."""
    steps = np.diff(time[np.isfinite(time)])
    rising = steps[steps > 0]
    if not len(rising):
        return [f"{name}: does not rise"]
    usual = float(np.median(rising))
    remarks = [f"{1 / usual:.4g} rows per s over {float(rising.sum()):.4g} s"]
    gaps = rising[rising > GAP_STEPS * usual]
    if len(gaps):
        remarks.append(f"{plural(len(gaps), 'gap')}, the longest {gaps.max():.3g} s")
    if doubled := int((steps == 0).sum()):
        remarks.append(plural(doubled, "repeated stamp"))
    if resets := int((steps < 0).sum()):
        remarks.append(f"{plural(resets, 'step')} back")
    return [f"{name}: {', '.join(remarks)}"]


def _guess_roles(columns: list[SurveyedColumn]) -> list[RoleGuess]:
    """The column of each role: its name suggests the role most clearly, and its numbers agree.

    A log with one position and one command is of one axis, whatever their names are.
    """
    names = [column.name for column in columns]
    split = [_split_ending(column.name) for column in columns]
    stems = [stem for stem, _ in split]
    units = [column.unit or ending for column, (_, ending) in zip(columns, split, strict=True)]
    found: dict[str, tuple[float, RoleGuess]] = {}
    stems = _number_behind_time(stems, columns)
    suggested = [
        COUNTER if (each is None or each.kind != "time") and _counts_by_one(column.values) else each
        for column, each in zip(columns, suggest_kinds(stems, units), strict=True)
    ]
    values = {column.name: column for column in columns}
    for column, each in zip(columns, suggested, strict=True):
        if each is None or names.count(column.name) > 1 or "," in column.name:
            continue
        role, weight = _role_of(each)
        if role != "time" and _rises_evenly(column.values):
            continue
        alike = [
            other.values
            for other, own, unit in zip(columns, suggested, units, strict=True)
            if other is column or (own and not unit and _are_of_a_kind(own, each))
        ]
        guess = _guess(role, column, each, np.concatenate(alike))
        if guess is None:
            continue
        if guess.unit == RATE_BLANK:
            weight -= COUNTER_DISADVANTAGE
        before, other = found.get(role, (0.0, None))
        noisier = (
            other is not None and weight == before and _is_smooth(values[other.column], column)
        )
        if weight > before or noisier:
            found[role] = weight, guess
    if "time" not in found and (guess := _guess_time(columns, suggested, found)) is not None:
        found["time"] = 1.0, guess
    if all(column.clock is not None for column in columns):
        found.pop("time", None)
    return [guess for _, guess in _sort_roles(_on_one_axis(found))]


def _are_of_a_kind(one: Suggestion, other: Suggestion) -> bool:
    """Whether two names say as clearly that their columns are of one kind, and so of one unit."""
    return (one.kind, one.weight, one.counts) == (other.kind, other.weight, other.counts)


def _number_behind_time(stems: list[str], columns: list[SurveyedColumn]) -> list[str]:
    """Names in which the columns of a matrix count from 1 behind one of times, which has none."""
    timed = {
        stem.removesuffix(".1")
        for stem, column in zip(stems, columns, strict=True)
        if stem.endswith(".1") and _rises_evenly(column.values)
    }
    shifted = []
    for stem in stems:
        matrix, _, number = stem.rpartition(".")
        inside = matrix in timed and number.isdecimal()
        shifted.append(
            "" if inside and number == "1" else f"{matrix}.{int(number) - 1}" if inside else stem
        )
    return shifted


def _guess_time(
    columns: list[SurveyedColumn],
    suggested: list[Suggestion | None],
    found: dict[str, tuple[float, RoleGuess]],
) -> RoleGuess | None:
    """The first column that rises as a time does, of a name that suggests nothing else.

    One that is called a counter has times since 1970. One of the matrix that has the ball's
    position is preferred.

    Args:
        columns: All of them.
        suggested: What each name suggests.
        found: Guesses of other roles.
    """
    first = columns[0]
    unnamed = first.clock is None and (first.name == "1" or first.dated)
    if unnamed and _rises(first.values, strictly=not first.dated):
        unit, why = _unit_by_numbers("time", first.values)
        return RoleGuess("time", first.name, unit, f"rises{why}")
    free = [
        column
        for column, each in zip(columns, suggested, strict=True)
        if column.clock is None
        and (each is None or (each.kind == "counter" and column.values[0] >= MIN_UNIX_TIME_S))
        and [other.name for other in columns].count(column.name) == 1
        and _rises_evenly(column.values)
    ]
    balls = [guess.column for role, (_, guess) in found.items() if ROLE_UNITS[role] == "m"]
    matrices = {ball.rpartition(".")[0] for ball in balls if "." in ball}
    free.sort(key=lambda column: column.name.rpartition(".")[0] not in matrices)
    for column in free:
        if not column.unit or unit_factor(column.unit, "s") is not None:
            unit, why = ("", "") if column.unit else _unit_by_numbers("time", column.values)
            return RoleGuess("time", column.name, unit, f"a guess: rises evenly in every row{why}")
    return None


def _is_smooth(column: SurveyedColumn, other: SurveyedColumn) -> bool:
    """Whether a column has hardly noise, as a reference, next to one that is measured."""
    shares = []
    for each in (column, other):
        known = each.values[np.isfinite(each.values)]
        if len(known) < MIN_COUNTER_STEPS:
            return False
        shares.append(float(find_noise(known)) / max(float(np.std(known)), 1e-300))
    return shares[0] < MAX_SMOOTH_RATIO * shares[1]


def _role_of(each: Suggestion) -> tuple[str, float]:
    """The role of a column, and how clear it is; a column without an axis is along x."""
    if each.kind == "counter":
        return "time", each.weight
    if each.kind not in {"measured", "command", "angle"}:
        return each.kind, each.weight
    along = each.axis or "x"
    ball, angle = AXIS_COLUMNS[along]
    names = {"measured": ball, "command": f"command_{angle}", "angle": f"measured_{angle}"}
    return names[each.kind], each.weight - 0.3 * (not each.axis)


def _on_one_axis(found: dict[str, tuple[float, RoleGuess]]) -> dict[str, tuple[float, RoleGuess]]:
    """The roles, those of a single position and its command moved to x where they have two axes."""
    if "measured_y" in found and 0 < found.get("measured_x", (0.0,))[0] < WEAK_WEIGHT:
        del found["measured_x"]
    places = [ball for ball, _ in AXIS_COLUMNS.values() if ball in found]
    if len(places) != 1:
        return found
    at = next(axis for axis, (ball, _) in AXIS_COLUMNS.items() if ball == places[0])
    angle = AXIS_COLUMNS[at][1]
    if {f"command_{angle}", f"measured_{angle}"} & found.keys():
        return found
    (other,) = (own for axis, (_, own) in AXIS_COLUMNS.items() if axis != at)
    moved = {places[0]: "measured_x", f"command_{other}": "command_phi"}
    moved[f"measured_{other}"] = "measured_phi"
    if not {f"command_{other}", f"measured_{other}"} & found.keys():
        return found
    new = {moved.get(role, role): each for role, each in found.items()}
    return {role: (w, replace(guess, role=role)) for role, (w, guess) in new.items()}


def _sort_roles(found: dict[str, tuple[float, RoleGuess]]) -> list[tuple[float, RoleGuess]]:
    return [found[role] for role in ROLE_UNITS if role in found]


def _split_ending(name: str) -> tuple[str, str]:
    """A name without the unit in which it ends, and the unit; empty without one."""
    ending = UNIT_ENDING.fullmatch(name)
    return (ending[1], ending[2]) if ending else (name, "")


def _guess(role: str, column: SurveyedColumn, each: Suggestion, alike: Array) -> RoleGuess | None:
    """A column in a role, or None if its unit or its numbers speak against it.

    Args:
        role: One of ``ROLE_UNITS``.
        column: The column.
        each: What its name suggests.
        alike: Numbers of all columns of such names without units, which share one.
    """
    if role == "time" and not _rises(column.values):
        return None
    if each.kind == "counter":
        counted = RoleGuess(role, column.name, RATE_BLANK, "counts rows")
        return counted if _counts_by_one(column.values, np.median) else None
    if each.kind in {"measured", "command", "angle"} and np.nanmax(column.values) == np.nanmin(
        column.values
    ):
        return None
    stem, ending = _split_ending(column.name)
    named = NAME_UNITS.get(stem.casefold(), ending.casefold())
    for unit, given, why in ((column.unit, "", "unit"), (named, named, "which states")):
        if unit:
            return _guess_by_unit(role, column.name, unit, given, f"name, {why} {unit}")
    values = column.values if role == "time" else alike
    unit, why = _unit_by_numbers(role, values, counts=each.counts)
    return RoleGuess(role, column.name, unit, f"name{why}")


def _guess_by_unit(role: str, name: str, unit: str, given: str, why: str) -> RoleGuess | None:
    """A column in a role by its unit, or None if that speaks against it.

    Args:
        role: One of ``ROLE_UNITS``.
        name: The column.
        unit: Its unit.
        given: The unit that a command line has to give; empty where the header has it.
        why: The reason, in words.
    """
    si = ROLE_UNITS[role]
    if unit_factor(unit, si) is not None:
        return RoleGuess(role, name, given, why)
    if si == "m" and plain_unit(unit) in OTHER_UNITS:
        return RoleGuess(role, name, SIZE_BLANK, f"{why}, no length: {SIZE_ADVICE}")
    if si == "rad" and unit not in LENGTH_UNITS:
        return RoleGuess(role, name, "counts", f"{why}, no angle")
    return None


def _rises(time: Array, *, strictly: bool = False) -> bool:
    steps = np.diff(time[np.isfinite(time)])
    rising = steps > 0 if strictly else steps >= 0
    return bool((steps > 0).any()) and float(np.mean(rising)) >= MIN_RISING_SHARE


def _rises_evenly(values: Array) -> bool:
    """Whether numbers, shape (K,), rise from each to the next by about the same step."""
    steps = np.diff(values[np.isfinite(values)])
    if len(steps) < MIN_COUNTER_STEPS or not (steps > 0).all():
        return False
    return float(np.std(steps)) < MAX_STEP_SPREAD * float(np.median(steps))


def _counts_by_one(values: Array, of_steps: Callable[[Mask], float] = np.all) -> bool:
    """Whether numbers, shape (K,), rise by 1 from each to the next, or at most of them."""
    steps = np.diff(values[np.isfinite(values)])
    return len(steps) >= MIN_COUNTER_STEPS and bool(of_steps(steps == 1))


def _unit_by_numbers(role: str, values: Array, *, counts: bool = False) -> tuple[str, str]:
    """A unit by the size of the numbers, and the reason; empty if any would do.

    Args:
        role: One of ``ROLE_UNITS``.
        values: The numbers.
        counts: Whether the name states a unit of the rig's own, as pixels.
    """
    known = values[np.isfinite(values)]
    if role == "time":
        if _counts_by_one(known):
            return RATE_BLANK, "; counts rows by 1"
        steps = np.diff(known)
        step = float(np.median(steps[steps > 0]))
        unit = next((unit for unit, low, high in TIME_STEPS if low <= step < high), "s")
        return unit, f"; steps of {step:.3g}, as of {unit}"
    if role.startswith("measured_") and ROLE_UNITS[role] == "m":
        reach = float(np.percentile(np.abs(known), 99))
        unit = next((unit for unit, most in MAX_POSITIONS if reach <= most), "mm")
        like = f"as in {unit}"
        if counts:
            unit, like = SIZE_BLANK, f"no length: {SIZE_ADVICE}"
        elif reach > MAX_POSITIONS[-1][1]:
            like = "taken as mm; else give the size of one, as 0.5mm"
        return unit, f"; reaches {reach:.3g}, {like}"
    if ROLE_UNITS[role] == "rad":
        reach = float(np.percentile(np.abs(known - np.median(known)), 99))
        unit = "counts" if counts else "rad" if reach < 1.0 else "deg" if reach < 60.0 else "counts"
        return unit, f"; moves by {reach:.3g}, as in {unit}"
    return "", ""
