"""Surveys a log of an unknown program: its columns, and the roles that they may have."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from controllers.arrays import Array
from twin.base.errors import LogError, plural
from twin.identify.log_columns import ROLE_UNITS, unit_factor
from twin.identify.log_tables import open_content, parse_numbers, split_content
from twin.run.logs import split_unit
from twin.run.readers import ForeignTable

ROLE_NAMES = (
    ("time", r"t|time|times?|timestamp|stamp|millis|micros|clock|zeit|.*[_./ ](time|timestamp|t)"),
    (
        "measured_x",
        r"x|px|x_?pos|pos_?x|(.*[_./ ])?(ball|pos|position|measured|cam|camera)[_./ ]?x",
    ),
    (
        "measured_y",
        r"y|py|y_?pos|pos_?y|(.*[_./ ])?(ball|pos|position|measured|cam|camera)[_./ ]?y",
    ),
    ("measured_phi", r"(.*[_./ ])?(measured|imu|encoder)[_./ ]?(phi|roll|angle_?x)"),
    ("measured_theta", r"(.*[_./ ])?(measured|imu|encoder)[_./ ]?(theta|pitch|angle_?y)"),
    (
        "command_phi",
        r"(.*[_./ ])?(phi|roll|ux|u_?1?|(servo|cmd|command|motor|tilt|angle)[_./ ]?[1xa]?)",
    ),
    (
        "command_theta",
        r"(.*[_./ ])?(theta|pitch|uy|u_?2|(servo|cmd|command|motor|tilt|angle)[_./ ]?[2yb])",
    ),
    ("touched", r"touch(ed)?|seen|visible|valid|detected"),
    ("age", r"age|latency"),
)
"""Role and the names that suggest it, in small letters and without units."""
NAME_UNITS = {"millis": "ms", "micros": "us"}
"""Names that state the unit of their numbers."""
UNIT_ENDING = re.compile(r"(.+)[_ ](s|ms|us|ns|m|mm|cm|rad|mrad|deg)")
"""A name that ends in its unit, as ``x_mm``."""
TIME_STEPS = (("s", 1e-5, 0.5), ("ms", 0.5, 500.0), ("us", 500.0, 5e5), ("ns", 5e5, 5e8))
"""Unit of a time, and from and to which step of its numbers it is assumed."""
MAX_POSITIONS = (("m", 0.5), ("cm", 30.0), ("mm", 500.0))
"""Unit of a position, and up to which largest number it is assumed."""
MIN_RISING_SHARE = 0.95
"""Share of rows in which a time has to rise."""
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
    """

    name: str
    unit: str
    values: Array
    clock: Array | None

    @property
    def range(self) -> str:
        """Its smallest and largest number."""
        known = self.values[np.isfinite(self.values)]
        return f"{known.min():.4g} to {known.max():.4g}" if len(known) else "no number"

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
            options.append("measured_x=NAME:m")
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
        typed: Words of the command line that was typed; by default that of ``identify``.

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
            columns.append(SurveyedColumn(name or str(k + 1), unit or "", values, clock))
    if not columns:
        raise LogError(f"{path.name}: no column time and no column of numbers: not a log")
    guesses = tuple(_guess_roles(columns))
    found = {guess.role: guess for guess in guesses}
    if "time" in found:
        guess = found["time"]
        (values,) = (each.values for each in columns if each.name == guess.column)
        notes += _describe_times(guess.column, values * (unit_factor(guess.unit or "s", "s") or 1))
    described: set[int] = set()
    for column in columns:
        if column.clock is not None and id(column.clock) not in described:
            described.add(id(column.clock))
            notes += _describe_times(f"the clock of {column.name}", column.clock)
    words = tuple(typed) or ("ballplate", "identify", str(path))
    return Survey(path, tuple(columns), guesses, tuple(notes), words)


def _describe_times(name: str, time: Array) -> list[str]:
    """Rate, gaps, doubled stamps and resets of times in s, in words."""
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
        remarks.append(f"{doubled} doubled stamps, of which the first row is taken")
    if resets := int((steps < 0).sum()):
        remarks.append(f"{plural(resets, 'step')} back")
    return [f"{name}: {', '.join(remarks)}"]


def _guess_roles(columns: list[SurveyedColumn]) -> Iterator[RoleGuess]:
    """The first column of each role with a name and numbers that suggest it."""
    taken: set[str] = set()
    names = [column.name for column in columns]
    for role, pattern in ROLE_NAMES:
        for column in columns:
            if column.name in taken or names.count(column.name) > 1 or "," in column.name:
                continue
            guess = _guess(role, pattern, column)
            if guess is not None:
                taken.add(column.name)
                yield guess
                break


def _guess(role: str, pattern: str, column: SurveyedColumn) -> RoleGuess | None:
    """A column in a role, or None if its name or its numbers speak against it."""
    bare = column.name.casefold().strip("/")
    ending = UNIT_ENDING.fullmatch(bare)
    stem = ending[1] if ending else bare
    if re.fullmatch(pattern, stem) is None:
        return None
    si = ROLE_UNITS[role]
    if role == "time" and not _rises(column.values):
        return None
    if column.unit:
        known = unit_factor(column.unit, si) is not None
        return RoleGuess(role, column.name, "", f"name, unit {column.unit}") if known else None
    unit = NAME_UNITS.get(stem, ending[2] if ending else "")
    if unit:
        known = unit_factor(unit, si) is not None
        return RoleGuess(role, column.name, unit, f"name, which states {unit}") if known else None
    unit, why = _unit_by_numbers(role, column.values)
    return RoleGuess(role, column.name, unit, f"name{why}")


def _rises(time: Array) -> bool:
    steps = np.diff(time[np.isfinite(time)])
    return len(steps) > 0 and float(np.mean(steps >= 0)) >= MIN_RISING_SHARE


def _unit_by_numbers(role: str, values: Array) -> tuple[str, str]:
    """A unit by the size of the numbers, and the reason; empty if any would do."""
    known = values[np.isfinite(values)]
    if role == "time":
        steps = np.diff(known)
        step = float(np.median(steps[steps > 0]))
        unit = next((unit for unit, low, high in TIME_STEPS if low <= step < high), "s")
        return unit, f"; steps of {step:.3g}, as of {unit}"
    if role.startswith("measured_") and ROLE_UNITS[role] == "m":
        reach = float(np.percentile(np.abs(known), 99))
        unit = next((unit for unit, most in MAX_POSITIONS if reach <= most), "mm")
        return unit, f"; reaches {reach:.3g}, as in {unit}"
    if ROLE_UNITS[role] == "rad":
        reach = float(np.percentile(np.abs(known - np.median(known)), 99))
        unit = "rad" if reach < 1.0 else "deg" if reach < 60.0 else "counts"
        return unit, f"; moves by {reach:.3g}, as in {unit}"
    return "", ""
