"""What a number in a reference may be: each check returns it as a float or names what is wrong."""

from __future__ import annotations

import math
from collections.abc import Sequence


def finite(name: str, value: float) -> float:
    """A finite number, else ValueError."""
    if not math.isfinite(value):
        raise ValueError(f"{name} must be a finite number, got {value}")
    return float(value)


def positive(name: str, value: float) -> float:
    """A finite number above zero, else ValueError."""
    if not (math.isfinite(value) and value > 0):
        raise ValueError(f"{name} must be a positive number, got {value}")
    return float(value)


def not_zero(name: str, value: float) -> float:
    """A finite number other than zero, else ValueError."""
    if not (math.isfinite(value) and value != 0):
        raise ValueError(f"{name} must be a finite number other than zero, got {value}")
    return float(value)


def pair(name: str, value: float | Sequence[float]) -> tuple[float, float]:
    """Two finite numbers, one for each axis (one number serves both), else ValueError."""
    both = (value, value) if isinstance(value, int | float) else tuple(value)
    if len(both) != 2:
        raise ValueError(f"{name} must be one number or two (x, y), got {len(both)}")
    return finite(name, both[0]), finite(name, both[1])
