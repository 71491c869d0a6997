"""What a device reports when something is wrong with it: condition, place, detail."""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple, Protocol


class Severity(StrEnum):
    """How the supervisor answers.

    WARNING: noted in the record. LEVEL: level the plate with the drives, then hold.
    STOP: nothing can be trusted to move; zero rate, quick stop, drives off.
    """

    WARNING = "warning"
    LEVEL = "level"
    STOP = "stop"


class Condition(NamedTuple):
    """One thing that can go wrong, as a row of the supervisor's table.

    Attributes:
        name: What it is called in records, tables and messages, as ``heartbeat lost``.
        severity: How it is answered.
        within: Longest time in s from its start to its detection.
        reaction: What is done, in words.
        recovery: What a person does to go on, in words.
        restart: Whether a reset cannot end it, only switching off and on again.
        device: Whether a device has a fault then; that there is no ball is none.
    """

    name: str
    severity: Severity
    within: float
    reaction: str
    recovery: str
    restart: bool = False
    device: bool = True


class Fault(NamedTuple):
    """A condition that was detected.

    Attributes:
        condition: Which one.
        where: The device, as ``drive phi (node 1)`` or ``touch screen``.
        detail: What was seen, in words and numbers.
        at: When, on the monotonic clock of the rig, s; None where nobody noted it.
    """

    condition: Condition
    where: str
    detail: str
    at: float | None = None

    def __str__(self) -> str:
        return f"{self.where}: {self.condition.name}: {self.detail}"


class FaultSource(Protocol):
    """A device that reports its faults."""

    def faults(self) -> tuple[Fault, ...]:
        """Faults detected since the last call, oldest first; never waits."""
