"""Verdicts on the parameters of a fitted twin, as far as its residuals are white."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import stats

from controllers.arrays import Array
from controllers.ballplate import corner_frequency
from twin.base.errors import plural
from twin.identify.intervals import Estimate
from twin.identify.least_squares import START_PRIOR, Fit
from twin.identify.parameters import (
    BALL_PARAMETERS,
    HIDDEN_PARAMETERS,
    LEVEL_PARAMETERS,
    SERVO_PARAMETER,
)
from twin.identify.plate_motion import Drives
from twin.identify.twin_fit import TwinProblem
from twin.identify.verdicts import (
    BOUNDED_VERDICT,
    IDENTIFIED_VERDICT,
    MAX_CORRELATION,
    NOT_IDENTIFIABLE,
    REJECTED_VERDICT,
    ParameterVerdict,
)


@dataclass(frozen=True, kw_only=True)
class WhitenessTest:
    """Constants of the test that residuals are white (Box and Pierce).

    Attributes:
        lags: Number of lags of the autocorrelation that are tested.
        level: Level of the test.
        slight_correlation: Correlation that a long log shows but that rejects no model: what moves
            together is then a twentieth of the noise variance, less than 0.1 mm. A replay of the
            twin itself leaves up to 0.03; the scatter of the intervals between windows is of this
            size.
        max_unexplained_share: Share of the noise variance up to which unexplained motion widens the
            intervals; a model that leaves more is rejected.
    """

    lags: int = 20
    level: float = 0.99
    slight_correlation: float = 0.05
    max_unexplained_share: float = 0.3


WHITENESS_TEST = WhitenessTest()
MAX_CORNER_FREQUENCY_HZ = 1000.0
"""Largest corner frequency in Hz that a scenario takes; drives beyond are as good as ideal."""


@dataclass(frozen=True)
class Whiteness:
    """Autocorrelation of the averaged residuals within windows.

    Attributes:
        correlation: At lags of 1 sample and more, shape (L,).
        band: What 95 % of white residuals stay within.
        misfit: Mean square residual in noise variances; 1 for a perfect twin.
        test: Constants of the test.
    """

    correlation: Array
    band: float
    misfit: float
    test: WhitenessTest = WHITENESS_TEST

    @property
    def outside(self) -> int:
        """How many of the lags are outside the band; of white residuals one in twenty."""
        return int((np.abs(self.correlation) > self.band).sum())

    @property
    def white(self) -> bool:
        """Whether the model explains the log: if not, no interval holds.

        It does unless the mean square correlation is beyond chance by more than a slight one: a
        log that is long enough distinguishes any replay from the motion.
        """
        test = self.test
        chance = stats.chi2.ppf(test.level, test.lags) / test.lags * (self.band / 1.96) ** 2
        beyond = float((self.correlation**2).mean()) > chance + test.slight_correlation**2
        return not beyond and self.misfit < 1 + test.max_unexplained_share

    @property
    def unexplained(self) -> float:
        """Variance of the motion that the twin does not explain, in noise variances; 0 if white.

        It is no more than moves together at any lag, or exceeds the noise.
        """
        if self.white:
            return 0.0
        return max(float(np.abs(self.correlation).max()), self.misfit - 1)

    @property
    def rejected(self) -> bool:
        """Whether so much is unexplained that no interval is given."""
        return self.unexplained > self.test.max_unexplained_share

    @property
    def words(self) -> str:
        """The verdict in words."""
        if self.white:
            return "the residuals look like the sensor's noise"
        what = (
            f"the residuals are not white: {self.outside} of {plural(self.test.lags, 'lag')} "
            "outside "
            f"the band, {self.misfit:.2f} times the sensor's noise; the log holds motion that the "
            f"twin does not explain, {np.sqrt(self.unexplained):.2f} times the noise's standard "
            "deviation"
        )
        if self.rejected:
            return f"{what}: too much for an interval"
        return f"{what}: the intervals include the largest error that it may have caused"

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``."""
        return {"misfit": self.misfit, "lags_outside": self.outside, "words": self.words}


def assess_parameters(
    names: tuple[str, ...], fit: Fit[TwinProblem], drives: Drives | None, left: Whiteness
) -> tuple[ParameterVerdict, ...]:
    """One verdict per parameter asked for, in that order; the level has one for each axis.

    Args:
        names: What was asked for.
        fit: The fit of the ball's motion.
        drives: How they follow; None if no command was recorded.
        left: What the fit leaves over.
    """
    found, ball = [], fit.estimate(white=left.white)
    moved = fit.bound_bias(left.unexplained)
    for name in names:
        if name in HIDDEN_PARAMETERS:
            why = "neither ball nor plate positions show it"
            found.append(ParameterVerdict.unknown(HIDDEN_PARAMETERS[name], name, why))
        elif name == "servo":
            found.append(_assess_servo(drives))
        else:
            each_axis = LEVEL_PARAMETERS[: fit.problem.windows.axes] if name == "level" else (name,)
            found += [
                _assess_ball(each, fit, ball, moved, rejected=left.rejected) for each in each_axis
            ]
    return tuple(found)


def whiteness(fit: Fit[TwinProblem], test: WhitenessTest = WHITENESS_TEST) -> Whiteness:
    """How white the residuals of a fit are, corrected for the starts that are fitted as well."""
    windows, every = fit.problem.windows, fit.found.linearisation
    axes = windows.axes
    products, counts = np.zeros((2, test.lags + 1))
    for r, Z, weight in zip(every.r[0], every.by_start[0], windows.weight, strict=True):  # noqa: N806
        there = np.outer((weight > 0).all(axis=-1), np.arange(2) < axes).ravel()
        r, Z = r[there], Z[there]  # noqa: N806, PLW2901
        taken = Z @ np.linalg.solve(Z.T @ Z + START_PRIOR, Z.T)
        for lag in range(min(test.lags + 1, len(r) // axes)):
            alike = r[axes * lag :] @ r[: len(r) - axes * lag]
            products[lag] += alike + (np.trace(taken, axes * lag) if lag else 0.0)
            counts[lag] += len(r) - axes * lag
    variance = products[0] / max(counts[0], 1)
    correlation = products[1:] / np.maximum(counts[1:], 1) / max(variance, 1e-300)
    return Whiteness(
        correlation,
        1.96 / float(np.sqrt(max(counts[0], 1))),
        float(fit.problem.misfit(every.r).mean()),
        test,
    )


def _assess_ball(
    name: str, fit: Fit[TwinProblem], ball: Estimate, moved: Array, *, rejected: bool
) -> ParameterVerdict:
    """The verdict of a parameter of the ball.

    Args:
        name: Which.
        fit: The fit of the ball's motion.
        ball: Its estimate.
        moved: By how much unexplained motion may have moved each parameter, SI units, shape (P,).
        rejected: Whether the log rejects the model.
    """
    about, k = BALL_PARAMETERS[name], fit.problem.names.index(name)
    half = max(float(np.hypot(ball.half_width[k], moved[k])), about.floor)
    value = float(ball.value[k])
    never = name in {"breakaway", "stribeck", "dwell"} and not fit.problem.windows.resting.any()
    if never or not math.isfinite(half):
        why = "the ball never rests" if never else "the log does not show it"
        return ParameterVerdict.unknown(about, name, why)
    found = ParameterVerdict(about=about, name=name, value=about.factor * value)
    if rejected:
        why = "best fit only: the log holds motion that the twin does not explain"
        return replace(found, word=REJECTED_VERDICT, why=why)
    low, high = max(value - half, about.least), min(value + half, about.most)
    if name == "delay" and value > about.most - half:
        why = f"at its bound of {about.most:g} s: give the log with --columns, which takes 1 s"
        low = about.factor * (value - half)
        return replace(found, low=low, word=BOUNDED_VERDICT, why=why)
    found = replace(found, low=about.factor * low, high=about.factor * high)
    if half <= about.allowed_half_width(value):
        return replace(found, word=IDENTIFIED_VERDICT)
    alike = np.abs(ball.correlation[k]) > MAX_CORRELATION
    others = [other for other, same in zip(fit.problem.names, alike, strict=True) if same]
    others.remove(name)
    why = f"not distinguishable from {', '.join(others)}" if others else "its interval is too wide"
    at_edge = value <= about.least + half or value >= about.most - half
    word = (
        BOUNDED_VERDICT if at_edge and high - low < about.most - about.least else NOT_IDENTIFIABLE
    )
    return replace(found, word=word, why=f"{why}; {about.experiment}")


def _assess_servo(drives: Drives | None) -> ParameterVerdict:
    found = ParameterVerdict(about=SERVO_PARAMETER, name="servo")
    if drives is None:
        return replace(found, why=f"no commanded rates in the log; {SERVO_PARAMETER.experiment}")
    lag, half = drives.lag, math.hypot(drives.half_width, SERVO_PARAMETER.floor)
    if not math.isfinite(half):
        return replace(found, why=f"the plate hardly moves; {SERVO_PARAMETER.experiment}")
    low = corner_frequency(lag + half)
    if lag <= half or corner_frequency(lag) > MAX_CORNER_FREQUENCY_HZ:
        why = f"faster than the log shows: above {low:.3g} Hz; {SERVO_PARAMETER.experiment}"
        return replace(found, low=low, word=BOUNDED_VERDICT, why=why)
    value, high = corner_frequency(lag), corner_frequency(lag - half)
    good = half <= SERVO_PARAMETER.allowed_half_width(lag)
    why = "" if good else f"its interval is too wide; {SERVO_PARAMETER.experiment}"
    word = IDENTIFIED_VERDICT if good else NOT_IDENTIFIABLE
    return replace(found, value=value, low=low, high=high, word=word, why=why)
