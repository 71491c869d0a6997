"""What a fit is worth: which parameters it identifies, and whether its residuals are noise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from controllers.arrays import Array
from twin.identify.bootstrap import Estimate
from twin.identify.parameters import BALL, HIDDEN, SERVO, IdentifiedParameter
from twin.identify.search import FitResult

IDENTIFIED, BOUNDED, NOT = "identified", "bounded", "not identifiable"
FASTEST = 1000.0
"""Largest corner frequency in Hz that a scenario takes; drives beyond are as good as ideal."""
CORRELATED = 0.95
"""Correlation above which two parameters cannot be told apart."""
LAGS = 20
"""This many lags of the residuals' autocorrelation are judged."""


@dataclass(frozen=True, kw_only=True)
class ParameterVerdict:
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

    about: IdentifiedParameter
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


@dataclass(frozen=True)
class Whiteness:
    """Autocorrelation of the averaged residuals within windows.

    Attributes:
        correlation: At lags 1 to ``LAGS`` samples, shape (LAGS,).
        band: What 95 % of white residuals stay within.
        misfit: Mean square residual in noise variances; 1 for a perfect twin.
    """

    correlation: Array
    band: float
    misfit: float

    @property
    def outside(self) -> int:
        """How many of the lags are outside the band; of white residuals one in twenty."""
        return int((np.abs(self.correlation) > self.band).sum())

    @property
    def words(self) -> str:
        """The verdict in words."""
        if self.outside <= 3 and self.misfit < 1.3:
            return "the residuals look like the screen's noise"
        return (
            f"the residuals are not white: {self.outside} of {LAGS} lags outside the band, "
            f"{self.misfit:.2f} times the screen's noise; the log holds motion that the twin "
            "does not explain"
        )

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``."""
        return {"misfit": self.misfit, "lags_outside": self.outside, "words": self.words}


def verdicts(
    names: tuple[str, ...], fit: FitResult, ball: Estimate, drives: Estimate | None
) -> tuple[ParameterVerdict, ...]:
    """One verdict per parameter asked for, in that order; the level has two.

    Args:
        names: What was asked for.
        fit: The fit of the ball's motion.
        ball: Its parameters and their uncertainty.
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


def whiteness(fit: FitResult) -> Whiteness:
    """How white the residuals of a fit are."""
    windows = fit.problem.windows
    r = fit.linearisation.r[0].reshape(len(windows), -1, 2)
    present = np.asarray((windows.weight > 0).all(axis=-1))
    products, counts = np.zeros(LAGS + 1), np.zeros(LAGS + 1)
    for row, mask in zip(r, present, strict=True):
        values = row[mask] - row[mask].mean(axis=0)
        for lag in range(min(LAGS + 1, len(values))):
            products[lag] += float((values[lag:] * values[: len(values) - lag]).sum())
            counts[lag] += 2 * (len(values) - lag)
    variance = products[0] / max(counts[0], 1)
    correlation = products[1:] / np.maximum(counts[1:], 1) / max(variance, 1e-300)
    # fitting the mean and start of each window removes some of what is white
    return Whiteness(
        correlation,
        1.96 / float(np.sqrt(max(counts[0], 1))),
        float(fit.problem.misfit(fit.linearisation.r).mean()),
    )


def corner_frequency(lag: float) -> float:
    """Corner frequency in Hz of a first-order lag of a time constant in s."""
    return float(1 / (2 * np.pi * lag))


def _ball(name: str, fit: FitResult, ball: Estimate) -> ParameterVerdict:
    about, k = BALL[name], fit.problem.names.index(name)
    value, half = float(ball.value[k]), max(float(ball.half_width[k]), about.floor)
    if name in {"breakaway", "stribeck", "dwell"} and not fit.problem.windows.resting.any():
        return _unknown(about, name, f"the ball never rests; {about.experiment}")
    if not math.isfinite(half):
        return _unknown(about, name, f"the log does not show it; {about.experiment}")
    low, high = max(value - half, about.least), min(value + half, about.most)
    ends = {"value": about.factor * value, "low": about.factor * low, "high": about.factor * high}
    if half <= max(about.tolerance, about.relative * abs(value)):
        return ParameterVerdict(about=about, name=name, **ends, word=IDENTIFIED, why="")
    correlated = [
        other
        for j, other in enumerate(fit.problem.names)
        if j != k and abs(ball.correlation[k, j]) > CORRELATED
    ]
    why = (
        f"cannot be told from {', '.join(correlated)}" if correlated else "its interval is too wide"
    )
    at_edge = value <= about.least + half or value >= about.most - half
    word = BOUNDED if at_edge and high - low < about.most - about.least else NOT
    return ParameterVerdict(
        about=about, name=name, **ends, word=word, why=f"{why}; {about.experiment}"
    )


def _servo(drives: Estimate | None) -> ParameterVerdict:
    if drives is None:
        return _unknown(SERVO, "servo", f"no commanded rates in the log; {SERVO.experiment}")
    lag, half = float(drives.value[0]), max(float(drives.half_width[0]), SERVO.floor)
    if not math.isfinite(half):
        return _unknown(SERVO, "servo", f"the plate hardly moves; {SERVO.experiment}")
    if lag <= half or corner_frequency(lag) > FASTEST:
        corner = corner_frequency(lag + half)
        why = f"faster than the log shows: above {corner:.3g} Hz; {SERVO.experiment}"
        return ParameterVerdict(
            about=SERVO, name="servo", value=None, low=corner, high=None, word=BOUNDED, why=why
        )
    ends = {
        "value": corner_frequency(lag),
        "low": corner_frequency(lag + half),
        "high": corner_frequency(lag - half),
    }
    good = half <= max(SERVO.tolerance, SERVO.relative * lag)
    why = "" if good else f"its interval is too wide; {SERVO.experiment}"
    word = IDENTIFIED if good else NOT
    return ParameterVerdict(about=SERVO, name="servo", **ends, word=word, why=why)


def _unknown(about: IdentifiedParameter, name: str, why: str) -> ParameterVerdict:
    return ParameterVerdict(
        about=about, name=name, value=None, low=None, high=None, word=NOT, why=why
    )
