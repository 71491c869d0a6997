"""Counts and radians: pure scaling, both ways, and the unwrapping of 32-bit counters."""

from __future__ import annotations

import math
from dataclasses import dataclass

TURN = 2 * math.pi
RPM = TURN / 60
"""One revolution per minute in rad/s."""

_WRAP = 1 << 32
_HALF = 1 << 31
INT32_MAX = _HALF - 1
INT32_MIN = -_HALF


@dataclass(frozen=True)
class Scale:
    """A linear scale between whole counts and a physical quantity.

    Attributes:
        unit: What one count is worth, in rad, rad/s or rad/s^2; negative where signs differ.
    """

    unit: float

    def value(self, counts: float) -> float:
        """The quantity for counts."""
        return counts * self.unit

    def counts(self, value: float) -> int:
        """The nearest counts for a finite quantity."""
        return round(value / self.unit)

    def counts32(self, value: float) -> int:
        """The nearest counts that a signed 32-bit object can hold, for a finite quantity."""
        return max(INT32_MIN, min(INT32_MAX, self.counts(value)))


def difference(new: int, old: int) -> int:
    """How far a signed 32-bit counter moved, the shorter way round its wrap, in counts."""
    return (new - old + _HALF) % _WRAP - _HALF
