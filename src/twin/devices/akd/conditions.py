"""Everything that can go wrong with the drives and their bus: the table, the error, the latch.

The table is ``conditions.toml``; each of its rows is a constant here.
"""

from __future__ import annotations

from dataclasses import dataclass
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


@dataclass
class _LastWarning:
    at: float
    suppressed: int = 0


class FaultReports:
    """Faults on their way to the supervisor: stops and levels are latched.

    Args:
        repeat: Shortest time in s between two reports of one warning.
    """

    def __init__(self, repeat: float) -> None:
        self._repeat = repeat
        self._new: list[Fault] = []
        self._latched: dict[tuple[str, str], Fault] = {}
        self._warned: dict[tuple[str, str], _LastWarning] = {}
        self.stopped = False
        """Whether something is latched that forbids torque."""

    def report(self, condition: Condition, where: str, detail: str, at: float) -> None:
        """Report a condition seen at a time in s: once, a warning every while."""
        key = condition.name, where
        if condition.severity is Severity.WARNING:
            last = self._warned.get(key)
            if last is not None and at - last.at < self._repeat:
                last.suppressed += 1
                return
            if last is not None and last.suppressed:
                detail = f"{detail} ({last.suppressed} more before)"
            self._warned[key] = _LastWarning(at)
        elif key in self._latched:
            return
        fault = Fault(condition, where, detail, at)
        if condition.severity is not Severity.WARNING:
            self._latched[key] = fault
            self.stopped = self.stopped or condition.severity is Severity.STOP
        self._new.append(fault)

    def latched(self, condition: Condition, where: str) -> bool:
        """Whether a condition was reported; warnings are never latched."""
        return (condition.name, where) in self._latched

    @property
    def standing(self) -> tuple[Fault, ...]:
        """Everything latched, oldest first."""
        return tuple(self._latched.values())

    def take(self) -> tuple[Fault, ...]:
        """Faults reported since the last call, oldest first."""
        new, self._new = tuple(self._new), []
        return new
