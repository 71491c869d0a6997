"""Results of the doctor: one line per check."""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum
from typing import NamedTuple


class CheckStatus(StrEnum):
    """PASS: as it must be. WARN: it works, with reservations. FAIL: a run would not work."""

    PASS = "pass"
    WARN = "warn"
    FAIL = "fail"


class CheckResult(NamedTuple):
    """What one check found.

    Attributes:
        what: What was checked.
        status: Whether it passed.
        seen: What was seen.
        advice: What to do; empty if nothing.
    """

    what: str
    status: CheckStatus
    seen: str
    advice: str = ""

    def as_dict(self) -> dict[str, str]:
        """The result for ``--json``; the status is called verdict there."""
        return {
            "what": self.what,
            "verdict": str(self.status),
            "seen": self.seen,
            "advice": self.advice,
        }


Ask = Callable[[str], str]
"""Asks a person, or an emulated rig, to do something: ``lift`` or ``put`` the ball, ``touch X Y``
in mm, ``watch`` the plate; or for an answer: which ``edge`` of it dipped, ``short`` or ``long``."""


def passed(what: str, seen: str) -> CheckResult:
    """As it must be."""
    return CheckResult(what, CheckStatus.PASS, seen)


def warned(what: str, seen: str, advice: str) -> CheckResult:
    """It works, with reservations."""
    return CheckResult(what, CheckStatus.WARN, seen, advice)


def failed(what: str, seen: str, advice: str) -> CheckResult:
    """A run would not work."""
    return CheckResult(what, CheckStatus.FAIL, seen, advice)
