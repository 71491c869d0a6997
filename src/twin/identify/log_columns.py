"""Roles of the columns of a log of any rig, and which columns a person gives them.

A column is given as ``role=name:unit``: ``measured_x=X:mm``, ``time=3:ms`` for the third,
``command_theta=-servo2:0.24deg`` with its sign turned and a factor, ``measured_x=far:mm@50`` with
the number that it has at zero. A column of a matrix may be given as ``data(:,1)`` or ``data[:,0]``.
Rows at a constant rate have the time ``time=row:100Hz``, by their
number, or ``time=n:100Hz`` by a column that counts them.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from controllers.arrays import Array
from twin.base.errors import LogError, suggest
from twin.run.units import UNIT_SCALES, plain_unit

ROLE_UNITS = {
    "time": "s",
    "measured_x": "m",
    "measured_y": "m",
    "command_phi": "rad",
    "command_theta": "rad",
    "measured_phi": "rad",
    "measured_theta": "rad",
    "age": "s",
    "touched": "1",
}
"""Roles of columns, and their SI units."""
ROLE_ALIASES = {"command_x": "command_phi", "command_y": "command_theta", "t": "time"}
"""Other names of a role: the command of phi moves the ball along x."""
AXIS_COLUMNS = {"x": ("measured_x", "phi"), "y": ("measured_y", "theta")}
"""The ball's column and the plate's angle that moves it, of each axis."""
ROLES_OF_BOTH_AXES = (
    ("measured_x", "measured_y"),
    ("command_phi", "command_theta"),
    ("measured_phi", "measured_theta"),
)
"""Roles of x and of y that are the same quantity."""
COUNT_UNITS = dict.fromkeys(("counts", "count", "1", ""), 1.0)
"""Units of a command other than angles."""
ROW_NAME = "row"
"""Stands for the number of the row, from 0, where no column has this name."""
UNIT_WITH_FACTOR = re.compile(r"\s*([0-9.]+(?:[eE][-+]?\d+)?)?\s*\*?\s*([^\W\d_]*|°|1)\s*")
"""A unit, or a factor, or both."""
MATRIX_COLUMN = re.compile(r"([\w.]*)(?:\(:,\s*(\d+)\)|\[:,\s*(\d+)\])")
"""A column of a matrix as MATLAB or Python write it: ``data(:,1)`` or ``data[:,0]``."""
RATE_UNITS = {"Hz": 1.0, "kHz": 1e3}
"""Units of a rate of rows, of which a time may be counted."""


@dataclass(frozen=True)
class ColumnWanted:
    """The column of a role, and the conversion of its numbers to SI.

    Attributes:
        name: In the header, or its number from 1 on; ``ROW_NAME`` for a time by a rate.
        unit: As given; empty for the unit of the header, or SI if that has none.
        sign: 1 or -1.
        zero: Number in the column that stands for zero, as of a sensor at one end of a tube.
    """

    name: str
    unit: str
    sign: float
    zero: float = 0.0

    def to_si(self, values: Array, factor: float) -> Array:
        """Numbers of the column, shape (K,), in SI units of this factor, counted from zero."""
        return self.sign * factor * (values - self.zero)


def wanted_columns(text: str) -> dict[str, ColumnWanted]:
    """Read the wanted columns from a list ``role=name:unit,...``.

    Raises:
        LogError: If a role is unknown, given twice, or required and missing, or commas are missing.
    """
    if not isinstance(text, str):
        raise LogError("columns: give a text, as in 'time=t:ms,measured_x=X:mm,command_phi=u:deg'")
    text = MATRIX_COLUMN.sub(_name_matrix_column, text)
    if "," not in text and text.count("=") > 1 and " " in text.strip():
        parts = re.split(r"\s+(?=\w+=)", text.strip())
        raise LogError(f"--columns: put commas between the columns: {','.join(parts)}")
    found: dict[str, ColumnWanted] = {}
    for part in filter(None, (each.strip() for each in text.split(","))):
        role, equals, name = (each.strip() for each in part.partition("="))
        role = ROLE_ALIASES.get(role, role)
        if role not in ROLE_UNITS or not equals or not name:
            meant = "" if role in ROLE_UNITS else suggest(role, ROLE_UNITS)
            raise LogError(
                f"--columns: '{part}'{meant or ':'} give ROLE=NAME:UNIT, role one of "
                + ", ".join(ROLE_UNITS)
            )
        if role in found:
            raise LogError(f"--columns: {role}: given twice")
        sign = -1.0 if name.startswith("-") and len(name) > 1 else 1.0
        name, _, unit = name.removeprefix("-").rpartition(":")
        name, unit = (name, unit) if name else (unit, "")
        zero = 0.0
        if name and "@" in unit:
            unit, _, after = unit.partition("@")
            zero = _number_at_zero(role, after)
        if unit and unit_factor(unit, ROLE_UNITS[role]) is None:
            known = ", ".join(filter(None, _unit_scales(ROLE_UNITS[role])))
            rate = "; or the rate of rows, as 100Hz" if role == "time" else ""
            raise LogError(
                f"--columns: {role}: unit '{unit}'; known: {known}, each with a factor before it"
                f"{rate}"
            )
        found[role] = ColumnWanted(name.strip(), unit.strip(), sign, zero)
    lacking: list[str] = []
    if not any(ball in found for ball, _ in AXIS_COLUMNS.values()):
        lacking.append("measured_x or measured_y")
    for ball, angle in AXIS_COLUMNS.values():
        if ball in found and not {f"command_{angle}", f"measured_{angle}"} & set(found):
            lacking.append(f"command_{angle} or measured_{angle}, for {ball}")
    if lacking:
        raise LogError(f"--columns: give {'; '.join(lacking)}, too")
    return found


def _name_matrix_column(found: re.Match[str]) -> str:
    """A column of a matrix as ``NAME.1``, or its number where the matrix has no name."""
    number = found[2] or str(int(found[3]) + 1)
    return f"{found[1]}.{number}" if found[1] else number


def _number_at_zero(role: str, text: str) -> float:
    """The number that a column has where its quantity is zero.

    Raises:
        LogError: If it is no number, or the quantity has no zero to choose.
    """
    if role in ("age", "touched"):
        raise LogError(f"--columns: {role}: @{text}: only positions, tilts and time have a zero")
    try:
        zero = float(text)
    except ValueError:
        zero = math.nan
    if not math.isfinite(zero):
        raise LogError(
            f"--columns: {role}: @{text}: give the column's number at zero, as {role}=NAME:UNIT@50"
        )
    return zero


def unit_factor(unit: str, si: str) -> float | None:
    """Factor from a unit such as ``mm``, ``0.5mm`` or ``0.24`` to SI; None if it is none.

    The unit of a time may be the rate of its counts, as ``100Hz``.
    """
    if (match := UNIT_WITH_FACTOR.fullmatch(unit)) is None:
        return None
    word = plain_unit(match[2])
    if si == "s" and match[1] and word in RATE_UNITS:
        rate = unit_factor(match[1], "1")
        return 1 / (rate * RATE_UNITS[word]) if rate else None
    scale = _unit_scales(si).get(word, 1.0 if match[1] and not word else None)
    try:
        factor = float(match[1] or 1.0) * (scale or 0.0)
    except ValueError:
        return None
    return factor if 0.0 < factor < math.inf else None


def is_count(unit: str) -> bool:
    """Whether a unit of a command, with or without a factor, is none of an angle."""
    match = UNIT_WITH_FACTOR.fullmatch(unit)
    return bool(unit) and (match is None or plain_unit(match[2]) not in UNIT_SCALES["rad"])


def _unit_scales(si: str) -> dict[str, float]:
    """The units of a quantity and their factors."""
    return UNIT_SCALES[si] | (COUNT_UNITS if si == "rad" else {})
