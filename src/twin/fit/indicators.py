"""Indicators that a table may give, their units, and what else they may be written in."""

from __future__ import annotations

from math import degrees

from twin.errors import nearest
from twin.run.indicators import UNITS as ALL_UNITS

OF_THE_RUN = {"outcome_time", "judged_from", "real_time_factor"}
"""Indicators that say how a run went, not what the ball did."""
UNITS = {name: unit for name, unit in ALL_UNITS.items() if name not in OF_THE_RUN}
"""The indicators of a run that can be measured, and the unit of each."""
FACTORS = {
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "s": {"s": 1.0, "ms": 1e-3},
    "%": {"%": 1.0, "1": 100.0},
    "deg": {"deg": 1.0, "rad": degrees(1.0)},
    "rad/s^2": {"rad/s^2": 1.0, "deg/s^2": 1 / degrees(1.0)},
}
"""Of each unit what it may also be written in, and by what that is multiplied."""


def factor(name: str, unit: str | None) -> float:
    """What a number in a unit is multiplied by to be in the indicator's own.

    Args:
        name: Of the indicator.
        unit: As written; None for the indicator's own.

    Raises:
        ValueError: If there is no such indicator, or it cannot have this unit.
    """
    if name not in UNITS:
        raise ValueError(f"no indicator '{name}'{nearest(name, UNITS)}")
    known = FACTORS[UNITS[name]]
    if unit is None:
        return 1.0
    if unit not in known:
        raise ValueError(f"{name}: cannot be in {unit}; allowed: {', '.join(known)}")
    return known[unit]
