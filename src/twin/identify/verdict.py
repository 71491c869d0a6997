"""What a fit is worth: what it identifies, and whether its residuals are noise."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import stats

from controllers.arrays import Array
from twin.identify.bootstrap import Estimate
from twin.identify.parameters import BALL, HIDDEN, SERVO, IdentifiedParameter
from twin.identify.plate_motion import Drives
from twin.identify.problem import START_PRIOR
from twin.identify.search import BestFit

NOTHING = math.radians(0.005)
"""Lost motion in rad up to which there is none: what wheels and joints of a good rig make."""
IDENTIFIED, BOUNDED, NOT = "identified", "bounded", "not identifiable"
REJECTED = "model rejected"
"""What is fitted to a log that the model does not explain: a value, but nothing known of it."""
FASTEST = 1000.0
"""Largest corner frequency in Hz that a scenario takes; drives beyond are as good as ideal."""
CORRELATED = 0.95
"""Correlation above which two parameters cannot be told apart."""
LAGS = 20
"""This many lags of the residuals' autocorrelation are judged."""
CHANCE = 0.99
"""Level of the test that the residuals are white (Box and Pierce)."""
SLIGHT = 0.05
"""Correlation of the residuals that is seen in a long log but does not reject a model: what moves
together is then a twentieth of the noise variance, less than 0.1 mm. A replay leaves up to 0.03 of
the twin itself; what hides in the intervals' own scatter between windows is of this size."""


@dataclass(frozen=True, kw_only=True)
class ParameterVerdict:
    """One parameter.

    Attributes:
        about: Which.
        name: Its name on the command line; of the level each axis has one.
        value: Fitted value in the unit of its key; None if the log says nothing.
        low: Lower end of the 95 % interval, in the same unit; None if unknown.
        high: Upper end.
        word: ``identified``, ``bounded`` (only a bound is known), ``model rejected`` (the value
            is the best fit, and has no interval) or ``not identifiable``.
        why: What is wrong and what experiment would show it; empty if identified.
    """

    about: IdentifiedParameter
    name: str
    value: float | None = None
    low: float | None = None
    high: float | None = None
    word: str = NOT
    why: str = ""

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
    def white(self) -> bool:
        """Whether the model explains the log: if not, no interval holds.

        It does unless the mean square correlation is beyond chance by more than ``SLIGHT``: any
        replay is told from the motion by a log that is long enough.
        """
        chance = stats.chi2.ppf(CHANCE, LAGS) / LAGS * (self.band / 1.96) ** 2
        beyond = float((self.correlation**2).mean()) > chance + SLIGHT**2
        return not beyond and self.misfit < 1.3

    @property
    def words(self) -> str:
        """The verdict in words."""
        if self.white:
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
    names: tuple[str, ...], fit: BestFit, drives: Drives | None, *, white: bool
) -> tuple[ParameterVerdict, ...]:
    """One verdict per parameter asked for, in that order; the level has two.

    Args:
        names: What was asked for.
        fit: The fit of the ball's motion.
        drives: How they follow; None if no command was recorded.
        white: Whether the fit explains the log.
    """
    found, ball = [], fit.estimate()
    for name in names:
        if name in HIDDEN:
            why = f"neither ball nor plate positions show it; {HIDDEN[name].experiment}"
            found.append(ParameterVerdict(about=HIDDEN[name], name=name, why=why))
        elif name == "servo":
            found.append(_servo(drives))
            if drives is not None and drives.play - drives.play_half_width > NOTHING:
                found.append(_lost_motion(drives))
        else:
            axes = ("level_phi", "level_theta") if name == "level" else (name,)
            found += [_ball(each, fit, ball, white=white) for each in axes]
    return tuple(found)


def whiteness(fit: BestFit) -> Whiteness:
    """How white the residuals of a fit are.

    What the starts fitted along take out of white noise is known, and is not held against it.
    """
    windows, every = fit.problem.windows, fit.linearisation
    products, counts = np.zeros(LAGS + 1), np.zeros(LAGS + 1)
    for r, Z, weight in zip(every.r[0], every.by_start[0], windows.weight, strict=True):  # noqa: N806
        there = np.repeat((weight > 0).all(axis=-1), 2)
        r, Z = r[there], Z[there]  # noqa: N806, PLW2901
        taken = Z @ np.linalg.solve(Z.T @ Z + START_PRIOR, Z.T)
        for lag in range(min(LAGS + 1, len(r) // 2)):
            alike = r[2 * lag :] @ r[: len(r) - 2 * lag]
            products[lag] += alike + (np.trace(taken, 2 * lag) if lag else 0.0)
            counts[lag] += len(r) - 2 * lag
    variance = products[0] / max(counts[0], 1)
    correlation = products[1:] / np.maximum(counts[1:], 1) / max(variance, 1e-300)
    return Whiteness(
        correlation,
        1.96 / float(np.sqrt(max(counts[0], 1))),
        float(fit.problem.misfit(every.r).mean()),
    )


def corner_frequency(lag: float) -> float:
    """Corner frequency in Hz of a first-order lag of a time constant in s."""
    return float(1 / (2 * np.pi * lag))


def _ball(name: str, fit: BestFit, ball: Estimate, *, white: bool) -> ParameterVerdict:
    about, k = BALL[name], fit.problem.names.index(name)
    value, half = float(ball.value[k]), max(float(ball.half_width[k]), about.floor)
    never = name in {"breakaway", "stribeck", "dwell"} and not fit.problem.windows.resting.any()
    if never or not math.isfinite(half):
        why = "the ball never rests" if never else "the log does not show it"
        return ParameterVerdict(about=about, name=name, why=f"{why}; {about.experiment}")
    found = ParameterVerdict(about=about, name=name, value=about.factor * value)
    if not white:
        why = "best fit only: the log holds motion that the twin does not explain"
        return replace(found, word=REJECTED, why=why)
    low, high = max(value - half, about.least), min(value + half, about.most)
    if name == "delay" and value > about.most - half:
        why = f"at its bound of {about.most:g} s: give the log with --columns, which takes 1 s"
        low = about.factor * (value - half)
        return replace(found, low=low, word=BOUNDED, why=why)
    found = replace(found, low=about.factor * low, high=about.factor * high)
    if half <= max(about.tolerance, about.relative * abs(value)):
        return replace(found, word=IDENTIFIED)
    alike = np.abs(ball.correlation[k]) > CORRELATED
    others = [other for other, same in zip(fit.problem.names, alike, strict=True) if same]
    others.remove(name)
    why = f"cannot be told from {', '.join(others)}" if others else "its interval is too wide"
    at_edge = value <= about.least + half or value >= about.most - half
    word = BOUNDED if at_edge and high - low < about.most - about.least else NOT
    return replace(found, word=word, why=f"{why}; {about.experiment}")


def _lost_motion(drives: Drives) -> ParameterVerdict:
    value, half = math.degrees(drives.play), math.degrees(drives.play_half_width)
    return ParameterVerdict(
        about=HIDDEN["lost_motion"],
        name="lost_motion",
        value=value,
        low=value - half,
        high=value + half,
        word=IDENTIFIED,
        why="play, hysteresis or friction: ballplate calibrate lost-motion tells which",
    )


def _servo(drives: Drives | None) -> ParameterVerdict:
    found = ParameterVerdict(about=SERVO, name="servo")
    if drives is None:
        return replace(found, why=f"no commanded rates in the log; {SERVO.experiment}")
    lag, half = drives.lag, max(drives.half_width, SERVO.floor)
    if not math.isfinite(half):
        return replace(found, why=f"the plate hardly moves; {SERVO.experiment}")
    low = corner_frequency(lag + half)
    if lag <= half or corner_frequency(lag) > FASTEST:
        why = f"faster than the log shows: above {low:.3g} Hz; {SERVO.experiment}"
        return replace(found, low=low, word=BOUNDED, why=why)
    value, high = corner_frequency(lag), corner_frequency(lag - half)
    good = half <= max(SERVO.tolerance, SERVO.relative * lag)
    why = "" if good else f"its interval is too wide; {SERVO.experiment}"
    if not drives.agree:
        why = "angles and rates of the plate do not give the same: the interval holds both"
    word = IDENTIFIED if good else NOT
    return replace(found, value=value, low=low, high=high, word=word, why=why)
