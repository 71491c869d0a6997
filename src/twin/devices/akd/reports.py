"""Faults on their way to the supervisor: stops are latched, warnings are not repeated endlessly."""

from __future__ import annotations

from dataclasses import dataclass

from twin.devices.akd.conditions import needs_restart
from twin.hal.faults import Condition, Fault, Severity


@dataclass
class _Repeat:
    last: float
    swallowed: int = 0


class Reports:
    """What has been detected: each stop once until the reset, each warning once a while.

    Args:
        repeat: Shortest time in s between two reports of one warning.
    """

    def __init__(self, repeat: float) -> None:
        self._repeat = repeat
        self._new: list[Fault] = []
        self._latched: dict[tuple[str, str], Fault] = {}
        self._warned: dict[tuple[str, str], _Repeat] = {}
        self.stopped = False
        """Whether something is latched that forbids torque."""

    def report(self, condition: Condition, where: str, detail: str, at: float) -> None:
        """Take in what was seen at a time in s."""
        key = condition.name, where
        if condition.severity is Severity.WARNING:
            known = self._warned.get(key)
            if known is not None and at - known.last < self._repeat:
                known.swallowed += 1
                return
            if known is not None and known.swallowed:
                detail = f"{detail} ({known.swallowed} more before)"
            self._warned[key] = _Repeat(at)
        elif key in self._latched:
            return
        fault = Fault(condition, where, detail)
        if condition.severity is not Severity.WARNING:
            self._latched[key] = fault
            self.stopped = self.stopped or condition.severity is Severity.STOP
        self._new.append(fault)

    def latched(self, condition: Condition, where: str) -> bool:
        """Whether a condition stands since the last reset."""
        return (condition.name, where) in self._latched

    @property
    def standing(self) -> tuple[Fault, ...]:
        """Everything latched, oldest first."""
        return tuple(self._latched.values())

    @property
    def needs_restart(self) -> bool:
        """Whether a reset cannot help."""
        return any(needs_restart(fault.condition) for fault in self._latched.values())

    def take(self) -> tuple[Fault, ...]:
        """What is new since the last call, oldest first."""
        new, self._new = tuple(self._new), []
        return new

    def reset(self) -> None:
        """Forget what is latched; what persists is reported anew."""
        self._latched.clear()
        self._warned.clear()
        self.stopped = False
