"""What a log says of each parameter: identified, or not, and what would show it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.identify.parameters import BALL, HIDDEN, SERVO, Parameter
from twin.identify.scores import Estimate
from twin.identify.search import Fit

IDENTIFIED, BOUNDED, NOT = "identified", "bounded", "not identifiable"
KINSHIP = 0.95
"""Correlation from which on two parameters cannot be told apart."""


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """One parameter.

    Attributes:
        about: Which.
        name: Its name on the command line; of the level each axis has one.
        value: Fitted value in the unit of its key; None if the log says nothing.
        low: Lower end of the 95 % interval, in the same unit.
        high: Upper end.
        word: ``identified``, ``bounded`` (only a bound is known) or ``not identifiable``.
        why: What is wrong and what experiment would show it; empty if identified.
    """

    about: Parameter
    name: str
    value: float | None
    low: float | None
    high: float | None
    word: str
    why: str

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``."""
        return {
            "name": self.name,
            "key": self.about.key,
            "unit": self.about.unit,
            "value": self.value,
            "low": self.low,
            "high": self.high,
            "verdict": self.word,
            "why": self.why,
        }


def verdicts(
    names: tuple[str, ...], fit: Fit, ball: Estimate, drives: Estimate | None
) -> tuple[Verdict, ...]:
    """One verdict a parameter asked for, in that order; the level has two.

    Args:
        names: What was asked for.
        fit: The fit of the ball's motion.
        ball: It with what chance leaves open.
        drives: The time constant of the drives in s; None if no command was recorded.
    """
    found = []
    for name in names:
        if name in HIDDEN:
            why = f"neither ball nor plate positions show it; {HIDDEN[name].experiment}"
            found.append(_unknown(HIDDEN[name], name, why))
        elif name == "servo":
            found.append(_servo(drives))
        else:
            axes = ("level_phi", "level_theta") if name == "level" else (name,)
            found += [_ball(each, fit, ball) for each in axes]
    return tuple(found)


def _ball(name: str, fit: Fit, ball: Estimate) -> Verdict:
    about, k = BALL[name], fit.problem.names.index(name)
    value, half = float(ball.value[k]), max(float(ball.spread[k]), about.floor)
    if name in {"breakaway", "stribeck", "dwell"} and not fit.problem.windows.resting.any():
        return _unknown(about, name, f"the ball never rests; {about.experiment}")
    if not math.isfinite(half):
        return _unknown(about, name, f"the log does not show it; {about.experiment}")
    low, high = max(value - half, about.least), min(value + half, about.most)
    ends = {"value": about.factor * value, "low": about.factor * low, "high": about.factor * high}
    if half <= max(about.wanted, about.share * abs(value)):
        return Verdict(about=about, name=name, **ends, word=IDENTIFIED, why="")
    kin = [
        other
        for j, other in enumerate(fit.problem.names)
        if j != k and abs(ball.correlation[k, j]) > KINSHIP
    ]
    why = f"cannot be told from {', '.join(kin)}" if kin else "its interval is too wide"
    at_edge = value <= about.least + half or value >= about.most - half
    word = BOUNDED if at_edge and high - low < about.most - about.least else NOT
    return Verdict(about=about, name=name, **ends, word=word, why=f"{why}; {about.experiment}")


def _servo(drives: Estimate | None) -> Verdict:
    if drives is None:
        return _unknown(SERVO, "servo", f"no commanded rates in the log; {SERVO.experiment}")
    lag, half = float(drives.value[0]), max(float(drives.spread[0]), SERVO.floor)
    if not math.isfinite(half):
        return _unknown(SERVO, "servo", f"the plate hardly moves; {SERVO.experiment}")
    if lag <= half:
        corner = corner_of(lag + half)
        why = f"faster than the log shows: above {corner:.3g} Hz; {SERVO.experiment}"
        return Verdict(
            about=SERVO, name="servo", value=None, low=corner, high=None, word=BOUNDED, why=why
        )
    ends = {
        "value": corner_of(lag),
        "low": corner_of(lag + half),
        "high": corner_of(lag - half),
    }
    good = half <= max(SERVO.wanted, SERVO.share * lag)
    why = "" if good else f"its interval is too wide; {SERVO.experiment}"
    word = IDENTIFIED if good else NOT
    return Verdict(about=SERVO, name="servo", **ends, word=word, why=why)


def corner_of(lag: float) -> float:
    """Corner frequency in Hz of a first-order lag of a time constant in s."""
    return float(1 / (2 * np.pi * lag))


def _unknown(about: Parameter, name: str, why: str) -> Verdict:
    return Verdict(about=about, name=name, value=None, low=None, high=None, word=NOT, why=why)
