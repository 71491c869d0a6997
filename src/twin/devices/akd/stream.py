"""Which SYNC the frames of one PDO belong to.

A PDO carries no number, so frames are counted: every SYNC owes one. A frame too many pays a debt
of the last cycles (late) or belongs to no SYNC at all (wrong cycle). A PDO that lags by exactly
one period for good looks like one that was lost once; only its first cycle tells.
"""

from __future__ import annotations

from typing import NamedTuple

_DEBT = 25
"""Cycles after which a missing frame is no longer expected."""


class Tally(NamedTuple):
    """What a cycle has brought: frames missing, late, and of no cycle at all."""

    missing: bool
    late: int
    surplus: int


class Stream:
    """The frames of one PDO, cycle by cycle."""

    def __init__(self) -> None:
        self.cycle = 0
        """SYNC that the newest frame answers; 0 before the first."""
        self.missed = 0
        """Cycles in a row without a frame."""
        self.doubled = 0
        """Cycles in a row with frames that no SYNC asked for."""
        self._arrived = 0
        self._owed = 0
        self._since = 0

    def arrive(self, cycle: int) -> None:
        """Take in a frame while a SYNC is the newest."""
        self.cycle = cycle
        self._arrived += 1

    def close(self) -> Tally:
        """Judge the cycle before the next SYNC is sent."""
        arrived, self._arrived = self._arrived, 0
        self._since += 1
        if self._since > _DEBT:
            self._owed = 0
        if not arrived:
            self.missed += 1
            self._owed += 1
            self._since = 0
            self.doubled = 0
            return Tally(missing=True, late=0, surplus=0)
        late = min(arrived - 1, self._owed)
        self._owed -= late
        surplus = arrived - 1 - late
        self.missed = 0
        self.doubled = self.doubled + 1 if surplus else 0
        return Tally(missing=False, late=late, surplus=surplus)
