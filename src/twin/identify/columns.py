"""The columns of a log: their names, units, and what numbers in them can mean."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from twin.errors import TwinError


class LogError(TwinError, ValueError):
    """A log cannot be read, or nothing can be learned from it."""


@dataclass(frozen=True)
class Column:
    """A column that a log may have.

    Attributes:
        unit: Its SI unit.
        meaning: What it holds.
        required: Whether a log must have it.
    """

    unit: str
    meaning: str
    required: bool = False


COLUMNS = {
    "time": Column("s", "time of the row", required=True),
    "measured_x": Column("m", "ball on the screen, along x", required=True),
    "measured_y": Column("m", "ball on the screen, along y", required=True),
    "measured_phi": Column("rad", "plate encoder about y", required=True),
    "measured_theta": Column("rad", "plate encoder about x", required=True),
    "age": Column("s", "time since the ball's position arrived"),
    "touched": Column("1", "whether the screen felt the ball, 0 or 1"),
    "applied_phi_acc": Column("rad/s^2", "commanded plate acceleration from this row on"),
    "applied_theta_acc": Column("rad/s^2", "commanded plate acceleration from this row on"),
    "applied_phi_rate": Column("rad/s", "commanded plate rate from this row on"),
    "applied_theta_rate": Column("rad/s", "commanded plate rate from this row on"),
}
"""What ``identify`` reads; a log may have more columns."""

_SCALES = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6},
    "m": {"m": 1.0, "mm": 1e-3, "cm": 1e-2},
    "rad": {"rad": 1.0, "mrad": 1e-3, "deg": math.radians(1)},
    "1": {"1": 1.0, "": 1.0},
}
for _unit in ("rad/s", "rad/s^2"):
    _SCALES[_unit] = {_unit: 1.0, _unit.replace("rad", "deg"): math.radians(1)}


def split_unit(header: str) -> tuple[str, str | None]:
    """Name and unit of a header such as ``measured_x [mm]``; no unit: None."""
    match = re.fullmatch(r"\s*(.*?)\s*\[\s*(.*?)\s*\]\s*", header)
    return (match[1], match[2]) if match else (header.strip(), None)


def scale(name: str, unit: str | None, source: str) -> float:
    """Factor from a column's unit to SI.

    Raises:
        LogError: If the unit is not one of this column.
    """
    if unit is None:
        return 1.0
    known = _SCALES[COLUMNS[name].unit]
    if unit not in known:
        raise LogError(f"{source}: {name}: unit '{unit}'; known: {', '.join(filter(None, known))}")
    return known[unit]


def require(names: list[str], source: str) -> None:
    """Make sure that all required columns are there.

    Raises:
        LogError: Naming those that are missing, and those that are there.
    """
    missing = [name for name, column in COLUMNS.items() if column.required and name not in names]
    if missing:
        raise LogError(
            f"{source}: no column {', '.join(missing)} "
            f"(it has {', '.join(names[:12]) or 'none'}{', ...' if len(names) > 12 else ''})"
        )
