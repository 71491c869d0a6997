"""What the doctor says: one line a check."""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum
from typing import NamedTuple


class Verdict(StrEnum):
    """PASS: as it must be. WARN: it works, but. FAIL: a run would not."""

    PASS = "pass"
    WARN = "warn"
    FAIL = "fail"


class Finding(NamedTuple):
    """One check.

    Attributes:
        what: What was checked.
        verdict: How it is.
        seen: What was seen.
        advice: What to do; empty if nothing.
    """

    what: str
    verdict: Verdict
    seen: str
    advice: str = ""


Ask = Callable[[str], None]
"""Asks a person, or an emulated rig, to do something: ``lift`` or ``put`` the ball."""


def passed(what: str, seen: str) -> Finding:
    """As it must be."""
    return Finding(what, Verdict.PASS, seen)


def warned(what: str, seen: str, advice: str) -> Finding:
    """It works, but."""
    return Finding(what, Verdict.WARN, seen, advice)


def failed(what: str, seen: str, advice: str) -> Finding:
    """A run would not work."""
    return Finding(what, Verdict.FAIL, seen, advice)
