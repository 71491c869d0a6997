"""Everything that can go wrong with the drives and their bus: the table, the error, the latch.

The table is ``conditions.toml``; each of its rows is a constant here.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from twin.errors import TwinError
from twin.hal.interface import Condition, Fault, Severity, conditions

_TABLE = conditions("twin.devices.akd")
CONDITIONS = tuple(_TABLE.values())
"""Every condition the drives and their bus report."""
if TYPE_CHECKING:

    def __getattr__(name: str) -> Condition: ...

else:
    globals().update(_TABLE)


class DriveError(TwinError, ConnectionError):
    """A drive or its bus cannot be used as requested; one line.

    Args:
        condition: What is wrong.
        where: The device.
        detail: What was seen and what to do, in one line.
    """

    def __init__(self, condition: Condition, where: str, detail: str) -> None:
        self.fault = Fault(condition, where, detail)
        super().__init__(f"{where}: {detail}")


class FaultReports:
    """Faults on their way to the supervisor: stops and levels are latched.

    Args:
        repeat: Shortest time in s between two reports of one warning.
    """

    def __init__(self, repeat: float) -> None:
        self._repeat = repeat
        self._new: list[Fault] = []
        self._latched: dict[tuple[str, str], Fault] = {}
        self._warned: dict[tuple[str, str], tuple[float, int]] = {}
        """When each warning was reported last, and how often it has been seen since."""

    def report(self, condition: Condition, where: str, detail: str, at: float) -> None:
        """Report a condition seen at a time in s: once, a warning every while."""
        key = condition.name, where
        if condition.severity is Severity.WARNING:
            last, held_back = self._warned.get(key, (-math.inf, 0))
            if at - last < self._repeat:
                self._warned[key] = last, held_back + 1
                return
            self._warned[key] = at, 0
            more = f" ({held_back} more before)" if held_back else ""
            self._new.append(Fault(condition, where, detail + more, at))
        elif key not in self._latched:
            self._latched[key] = fault = Fault(condition, where, detail, at)
            self._new.append(fault)

    def latched(self, condition: Condition, where: str) -> bool:
        """Whether a condition was reported; warnings are never latched."""
        return (condition.name, where) in self._latched

    @property
    def stopping(self) -> tuple[Fault, ...]:
        """Everything latched that forbids torque, oldest first."""
        every = self._latched.values()
        return tuple(each for each in every if each.condition.severity is Severity.STOP)

    def take(self) -> tuple[Fault, ...]:
        """Faults reported since the last call, oldest first."""
        new, self._new = tuple(self._new), []
        return new
