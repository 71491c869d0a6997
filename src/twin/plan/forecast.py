"""Forecast of the intervals that ``identify`` will give, before anything is recorded.

How much each parameter moves what the screen reports of a simulated run, over the noise of the
screen, is the expected information of a motion (Fisher). Windows, fit, intervals and verdicts are
those of ``identify``; only the search for a first guess is left out: a fit begins at the rig's own
numbers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from controllers.arrays import Array
from controllers.ballplate import time_constant
from twin.base.errors import LogError
from twin.identify.intervals import Estimate
from twin.identify.least_squares import Fit
from twin.identify.logs import Log
from twin.identify.parameters import (
    DEFAULT_PARAMETERS,
    FITTED_SHARE,
    HIDDEN_PARAMETERS,
    SERVO_PARAMETER,
)
from twin.identify.plate_motion import check_motion, fit_drives
from twin.identify.prepare import prepare
from twin.identify.twin_fit import TWIN_SELECTION, TwinProblem
from twin.identify.twin_model import fit_windows
from twin.identify.twin_verdicts import assess_parameters
from twin.identify.verdicts import ParameterVerdict
from twin.identify.windows import cut, moving_spans
from twin.scenario.schema import Scenario
from twin.shadow.belief import Belief


@dataclass(frozen=True, kw_only=True)
class ForecastConstants:
    """Constants of a forecast.

    Attributes:
        noise_draws: Number of draws of the noise over whose intervals the median is taken.
        max_information_share: Eigenvalue of the scaled information, 1 if all parameters differ,
            below which the parameters of its direction cannot be told apart.
        min_direction_share: Component of a parameter in such a direction above which it is named.
        worst_ratio: Half width over the one that counts as identified, which stands for all larger
            ones and for none where motions are compared.
    """

    noise_draws: int = 24
    max_information_share: float = 0.05
    min_direction_share: float = 0.35
    worst_ratio: float = 100.0


FORECAST = ForecastConstants()


def find_information(fit: Fit[TwinProblem]) -> Array:
    """Expected information J'J of the parameters and what is known before, shape (P, P)."""
    slopes = fit.found.linearisation.eliminate_starts()[0][0, ..., 1:]
    return np.asarray(np.einsum("wmi,wmj->ij", slopes, slopes)) + np.diag(fit.problem.known[1])


@dataclass(frozen=True, kw_only=True)
class ExpectedEstimate(Estimate):
    """Estimates of one fit under several draws of the noise; values and draws are of the first.

    Attributes:
        each: The estimates.
    """

    each: tuple[Estimate, ...]

    @property
    def half_width(self) -> Array:
        """Half width that half of the draws of the noise stay within, shape (P,)."""
        return np.asarray(np.median([one.half_width for one in self.each], axis=0))


@dataclass(frozen=True)
class ExpectedFit(Fit[TwinProblem]):
    """The fit of a log, with the intervals that noise usually gives.

    Attributes:
        how: Constants of the forecast.
    """

    how: ForecastConstants = FORECAST

    def estimate(self, *, white: bool = False) -> ExpectedEstimate:
        """The parameters and their uncertainty as ``identify`` has it, over draws of the noise.

        From white residuals the part is taken that the parameters would explain.

        Args:
            white: Whether residuals are expected to be white.
        """
        line, information = self.found.linearisation, find_information(self)
        slopes = line.eliminate_starts()[0][0, ..., 1:]
        noise = np.random.default_rng(0)
        found = []
        for _ in range(self.how.noise_draws):
            r = noise.standard_normal(line.r.shape)
            taken = np.linalg.solve(information, np.einsum("wmi,wm->i", slopes, r[0]))
            left = line._replace(r=r - line.by_parameter @ taken)
            one = Fit(self.problem, self.found._replace(linearisation=left))
            found.append(one.estimate(white=white))
        return ExpectedEstimate(**vars(found[0]), each=tuple(found))


def find_indistinct(
    names: Sequence[str], information: Array, how: ForecastConstants = FORECAST
) -> list[tuple[str, ...]]:
    """Groups of parameters that cannot be told apart: weak directions of the information.

    Args:
        names: Of the parameters, P of them.
        information: Shape (P, P).
        how: Constants of the forecast.
    """
    diagonal = np.diagonal(information)
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    groups = []
    for vector in vectors[:, values < how.max_information_share].T:
        strong = np.abs(vector) > how.min_direction_share
        group = tuple(name for name, there in zip(names, strong, strict=True) if there)
        if len(group) > 1 and group not in groups:
            groups.append(group)
    return groups


@dataclass(frozen=True, kw_only=True)
class RigForecast:
    """What a motion will tell of one rig.

    Attributes:
        verdicts: Of the parameters: expected value, interval and verdict; none if nothing is
            expected.
        indistinct: Groups of names that cannot be told apart.
        why: Why nothing is expected; empty if something is.
    """

    verdicts: tuple[ParameterVerdict, ...] = ()
    indistinct: tuple[tuple[str, ...], ...] = ()
    why: str = ""

    def verdict(self, name: str) -> ParameterVerdict | None:
        """The verdict of a parameter; None if nothing is expected."""
        return next((each for each in self.verdicts if each.name == name), None)


def half_width(found: ParameterVerdict | None) -> float:
    """The half width of an interval in the unit of its key; infinite without one.

    Of an interval that ends at a bound of the parameter it is the longer side.
    """
    if found is None or found.value is None or found.low is None or found.high is None:
        return math.inf
    return max(found.high - found.value, found.value - found.low)


def width_ratio(found: ParameterVerdict | None, how: ForecastConstants = FORECAST) -> float:
    """The half width over the largest one that counts as identified, at most ``worst_ratio``."""
    if found is None or found.low is None:
        return how.worst_ratio
    about = found.about
    if about is SERVO_PARAMETER:
        # of the time constant: the corner frequency of fast drives has a lower end alone
        lag = 0.0 if found.value is None else time_constant(found.value)
        half = time_constant(found.low) - lag if found.low > 0 else math.inf
        size = lag
    else:
        half, size = half_width(found) / about.factor, abs(found.value or 0.0) / about.factor
    return min(half / about.allowed_half_width(size), how.worst_ratio)


def forecast_log(
    log: Log,
    truth: Scenario,
    names: tuple[str, ...] = DEFAULT_PARAMETERS,
    share: float = FITTED_SHARE,
    how: ForecastConstants = FORECAST,
) -> RigForecast:
    """What ``identify`` is expected to find in such a log as one of a known rig.

    The parameters are fitted to the log, though they are known: at the rig's own numbers a replay
    may miss how long a ball clings before it starts, which a fit explains by other numbers of its
    friction at rest. The unknown forces would have to explain it instead, and widen all intervals.

    The residuals are drawn, but those of an even screen that explains the log of an uneven rig are
    the run's own: what the model lacks makes more of them than the noise.

    Args:
        log: A simulated run of the rig.
        truth: The rig.
        names: The parameters, as ``identify`` takes them.
        share: Share of the usable time that is fitted.
        how: Constants of the forecast.
    """
    try:
        usable = prepare(log)
        check_motion(usable)
        known = usable.split(share)[0] if share < 1 else usable
        drives = fit_drives(known) if "servo" in names else None
        belief = Belief.of(truth, log)
        lag = belief.lag if drives is None else drives.lag
        windows = cut(known, lag, TWIN_SELECTION.max_window_s, moving_spans)
        if windows is None or len(windows) < 3:
            raise LogError(f"{known.length:.0f} s are too short: fewer than 3 windows to fit")
    except LogError as error:
        return RigForecast(why=str(error).removeprefix(f"{log.source}: "))
    _, fit, left, _ = fit_windows(usable, windows, names, guess=belief.values)
    even = not belief.scenario.plant.surface.spread_percent and not belief.values["dwell"]
    if even or fit.problem.windows.white is not None:
        fit = ExpectedFit(fit.problem, fit.found, how)
    asked = tuple(name for name in names if name not in HIDDEN_PARAMETERS)
    return RigForecast(
        verdicts=assess_parameters(asked, fit, drives, left),
        indistinct=tuple(find_indistinct(fit.problem.names, find_information(fit), how)),
    )
