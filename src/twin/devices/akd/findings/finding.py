"""A finding: what is wrong in a trace, as data with a stable code."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from typing import Any, NamedTuple

from twin.base.data_file import read_packaged
from twin.base.errors import plural
from twin.devices.akd.observed import BUS


class Severity(StrEnum):
    """Whether a problem is there at the end of a trace, was over by then, or is only a warning."""

    UNRESOLVED = "unresolved"
    RECOVERED = "recovered"
    WARNING = "warning"


class Kind(NamedTuple):
    """What is known of a code without a trace.

    Attributes:
        tier: 1 where a node, a drive or the bus fails, 2 where something else does.
        causes: Its causes, the most likely first.
        check: What to check, in this order.
    """

    tier: int
    causes: tuple[str, ...]
    check: tuple[str, ...]


@cache
def kinds() -> dict[str, Kind]:
    """All codes of findings."""
    return {
        code: Kind(row["tier"], tuple(row["causes"]), tuple(row["check"]))
        for code, row in _table()["codes"].items()
    }


@cache
def _table() -> dict[str, Any]:
    return read_packaged("twin.devices.akd.findings", "findings.toml")


def causes_of_error(code: int) -> tuple[str, ...]:
    """The likely causes of an error code of CiA 402, by its class; empty if there are none.

    Args:
        code: As in an emergency, or in 603Fh.
    """
    known = _table()["error_causes"]
    digits = f"{code:04X}"
    found = (known.get(digits[:length]) for length in (4, 3, 2, 1))
    return tuple(next((each for each in found if each), ()))


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One problem in a trace.

    Attributes:
        code: Its stable code, one of ``kinds()``.
        severity: Whether it was over at the end of the trace.
        time: When it began, s since the first frame.
        until: When it was over, s; None if it was not, or did not last.
        node: The node; ``BUS`` if it belongs to none.
        axis: The axis of a drive, 1 for the first; None if it belongs to none.
        text: The finding in a sentence, without the node.
        motion: Its effect on the motion; empty if unknown.
        frames: Numbers of the frames that show it.
        seen: Causes that the trace itself suggests, instead of those of the code.
    """

    code: str
    severity: Severity
    time: float
    text: str
    frames: tuple[int, ...]
    node: int = BUS
    axis: int | None = None
    until: float | None = None
    motion: str = ""
    seen: tuple[str, ...] = ()

    @property
    def causes(self) -> tuple[str, ...]:
        """Its causes, the most likely first."""
        return self.seen or kinds()[self.code].causes

    @property
    def check(self) -> tuple[str, ...]:
        """What to check, in this order."""
        return kinds()[self.code].check

    @property
    def order(self) -> tuple[int, int, float]:
        """By what findings are ranked: severity, tier, time."""
        return list(Severity).index(self.severity), kinds()[self.code].tier, self.time

    def as_dict(self) -> dict[str, Any]:
        """The finding for ``--json``; the bus has no node."""
        return {
            "code": self.code,
            "severity": str(self.severity),
            "time": self.time,
            "until": self.until,
            "node": self.node or None,
            "axis": self.axis,
            "text": self.text,
            "motion": self.motion,
            "causes": list(self.causes),
            "check": list(self.check),
            "frames": list(self.frames),
        }


def severity_at_end(until: float | None) -> Severity:
    """The severity of a problem that is over at a time in s, or, without one, is not."""
    return Severity.UNRESOLVED if until is None else Severity.RECOVERED


def count_words(counts: Mapping[Severity, int]) -> str:
    """How many problems of each severity there are, in words."""
    return ", ".join(
        plural(count, "warning") if severity is Severity.WARNING else f"{count} {severity}"
        for severity, count in counts.items()
        if count
    )


SILENCES = ("node-lost", "bus-lost", "boot-up", "trace-gap")
"""Codes of times in which nothing comes of a node, which explain whatever is missing then."""
KNOWN_BEFORE_S = 0.05
"""Time in s by which a consequence may be seen before its cause."""


def is_explained(known: Sequence[Finding], codes: Collection[str], node: int, time: float) -> bool:
    """Whether a problem follows from one that was found before: of its node, or of the bus.

    Args:
        known: What was found before.
        codes: Those of which the problem is a consequence.
        node: Where the problem is.
        time: When it began, s.
    """
    return any(
        each.code in codes
        and each.node in (node, BUS)
        and each.time - KNOWN_BEFORE_S <= time <= (math.inf if each.until is None else each.until)
        for each in known
    )
