"""A row of the fault matrix: a reaction next to its limits, the verdict, and its text."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from twin.safety.reaction import Reaction


@dataclass(frozen=True, kw_only=True)
class FaultRow(Reaction):
    """Result of one case; the keys of ``--json``.

    Times are in s from the injection, or from switching on; angles in rad, ways in m. Pairs are
    those of phi and theta, or of x and y. A key that ends in ``_limit`` or ``_expected`` is the
    bound or value with which the key before it is compared.

    Attributes:
        name: What was done.
        condition: The condition that had to be reported; empty if none.
        severity: Its severity.
        allowed: Longest time to its detection.
        detected: Time to its detection; None if it was not. Where the host hangs, the time to
            the first drive that stops by itself.
        ending: How the run ended.
        line: The one line that a person reads; empty if the run finished.
        safe: Whether the plate was safe: every key checked below is as it must be, and no drive has
            torque at the end.
        whole: Whether every period up to the end is in the record, without gaps.
        recovered: Whether it runs again after the cause was removed and a person asks for it.
        reason: The condition that ended the run; empty if none did.
        reason_expected: The one that had to.
        stopped_by: Who stopped the axes.
        stopped_by_expected: Who had to.
        state: The drives' states that were reached: with torque where the plate was levelled or
            the run went on, else the first without.
        state_expected: Those that had to be.
        standstill: From when on the plate stood, and was level if it had to be levelled; None if it
            did not, or did not have to.
        standstill_limit: None where nothing has to stop.
        torque_off: When the last drive lost its torque; None if one did not.
        torque_off_limit: None where the plate is held.
        tilt: Largest plate angle after the fault.
        tilt_limit: Its limit.
        ball: Largest distances of the ball from the plate's centre after the fault, until the
            plate has to stand; on a plate that is left tilted it rolls on.
        ball_limit: Their limits.
        ball_later: The same over the whole observation; not evaluated.
        torque: Whether a drive has torque at the end of the observation.
        held: Whether the drives held the limits of torque and speed when the fault began.
        says: Whether the line contains the required text.
        failures: The keys that are not as they must be.
        good: Whether there are none.
    """

    name: str
    condition: str
    severity: str
    allowed: float
    detected: float | None
    ending: str
    line: str
    whole: bool
    recovered: bool
    reason: str
    reason_expected: str
    stopped_by_expected: tuple[str, ...]
    state_expected: tuple[str, ...]
    standstill_limit: float | None
    torque_off_limit: float | None
    tilt_limit: float
    ball_limit: tuple[float, float]
    held: bool
    says: bool

    @property
    def _safe_by_key(self) -> dict[str, bool]:
        stop, off = self.standstill_limit, self.torque_off_limit
        return {
            "stopped_by": self.stopped_by == self.stopped_by_expected,
            "state": self.state == self.state_expected,
            "standstill": stop is None or _within(self.standstill, stop),
            "torque_off": off is None or _within(self.torque_off, off),
            "tilt": _within(self.tilt, self.tilt_limit),
            "ball": all(map(_within, self.ball, self.ball_limit)),
            "torque": not self.torque,
            "held": self.held,
        }

    @property
    def safe(self) -> bool:
        """Whether the plate was safe."""
        return all(self._safe_by_key.values())

    @property
    def failures(self) -> tuple[str, ...]:
        """Keys of what is not as it must be."""
        right_by_key = {
            "detected": not self.condition or _within(self.detected, self.allowed),
            "reason": self.reason == self.reason_expected,
            "line": self.says,
            **self._safe_by_key,
            "whole": self.whole,
            "recovered": self.recovered,
        }
        return tuple(key for key, right in right_by_key.items() if not right)

    @property
    def good(self) -> bool:
        """Whether the fault was detected in time, answered safely, recorded, recovered from."""
        return not self.failures

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``."""
        more = {"safe": self.safe, "good": self.good, "failures": self.failures}
        return {**asdict(self), **more}


def _within(value: float | None, limit: float) -> bool:
    return value is not None and value <= limit + 1e-6


FAULT_HEADINGS = (
    "fault",
    "reported",
    "detected [ms]",
    "standstill [ms]",
    "tilt [deg]",
    "ball x, y [mm]",
    "stopped by",
    "reached",
    "run",
)
"""Headings of the cells of a row; a value is followed by its limit."""


def failure_sheet(rows: Sequence[FaultRow]) -> tuple[tuple[str, ...], list[tuple[Any, ...]]]:
    """Headings and rows of a failure mode and effects sheet; times in s, angles in deg, ways in m.

    The effect of a fault is the motion of plate and ball until the rig stood still.
    """
    headings = (
        *("fault", "effect: largest tilt [deg]", "effect: way of the ball x [m]"),
        *("effect: way of the ball y [m]", "detection: condition", "detection: time [s]"),
        *("detection: limit [s]", "reaction: severity", "reaction: stopped by", "reaction: state"),
        *("reaction: standstill [s]", "end of the run", "verdict"),
    )
    lines = [
        (
            row.name,
            round(math.degrees(row.tilt), 3),
            *(round(way, 5) for way in row.ball),
            row.condition or "none",
            _seconds(row.detected),
            _seconds(row.allowed) if row.condition else None,
            row.severity,
            both(row.stopped_by),
            both(row.state),
            _seconds(row.standstill),
            row.ending,
            "good" if row.good else f"BAD: {', '.join(row.failures)}",
        )
        for row in rows
    ]
    return headings, lines


def _seconds(value: float | None) -> float | None:
    return None if value is None else round(value, 4)


def cells(row: FaultRow) -> tuple[str, ...]:
    """The cells of a row."""
    reported = row.condition or "none"
    if row.reason not in {"", row.condition}:
        reported += f" (ended by: {row.reason})"
    return (
        row.name,
        reported,
        _of(row.detected, row.allowed, 1e3) if row.condition else "-",
        _of(row.standstill, row.standstill_limit, 1e3) if row.standstill_limit else "-",
        _of(row.tilt, row.tilt_limit, math.degrees(1), 2),
        f"{_pair(row.ball)} of {_pair(row.ball_limit)}",
        both(row.stopped_by),
        both(row.state),
        row.ending,
    )


def both(names: Sequence[str]) -> str:
    """What holds for phi and theta, in one word where it is the same."""
    phi, theta = names
    return phi if phi == theta else f"phi: {phi}, theta: {theta}"


def _of(value: float | None, limit: float | None, factor: float, digits: int = 0) -> str:
    seen = "not" if value is None else f"{factor * value:.{digits}f}"
    return seen if limit is None else f"{seen} of {factor * limit:.{digits}f}"


def _pair(ways: tuple[float, float]) -> str:
    return ", ".join(f"{1e3 * way:.0f}" for way in ways)
