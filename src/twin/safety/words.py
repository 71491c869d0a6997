"""A row of the fault matrix in words and numbers, for the screen and for the document."""

from __future__ import annotations

import math
from collections.abc import Sequence

from twin.safety.row import FaultRow

HEADING = (
    "fault",
    "reported",
    "detected [ms]",
    "standstill [ms]",
    "tilt [deg]",
    "ball x, y [mm]",
    "stopped by",
    "reached",
    "run",
)
"""What the cells of a row are; a value is followed by its limit."""


def cells(row: FaultRow) -> tuple[str, ...]:
    """The cells of a row."""
    reported = row.condition or "none"
    if row.reason not in {"", row.condition}:
        reported += f" (ended by: {row.reason})"
    return (
        row.name,
        reported,
        _of(row.detected, row.allowed, 1e3) if row.condition else "-",
        _of(row.standstill, row.standstill_limit, 1e3) if row.standstill_limit else "-",
        _of(row.tilt, row.tilt_limit, math.degrees(1), 2),
        f"{_pair(row.ball)} of {_pair(row.ball_limit)}",
        both(row.stopped_by),
        both(row.state),
        row.ending,
    )


def both(names: Sequence[str]) -> str:
    """What holds for phi and theta, in one word where it is the same."""
    phi, theta = names
    return phi if phi == theta else f"phi: {phi}, theta: {theta}"


def _of(value: float | None, limit: float | None, factor: float, digits: int = 0) -> str:
    seen = "not" if value is None else f"{factor * value:.{digits}f}"
    return seen if limit is None else f"{seen} of {factor * limit:.{digits}f}"


def _pair(ways: tuple[float, float]) -> str:
    return ", ".join(f"{1e3 * way:.0f}" for way in ways)
