"""Forecast of the intervals that ``identify`` will give, before anything is recorded.

How much each parameter moves what the screen reports of a simulated run, over the noise of the
screen, is the expected information of a motion (Fisher). Windows, noise, intervals and verdicts are
those of ``identify``; only the search for the parameters is left out, for they are known here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from controllers.arrays import Array
from twin.base.errors import LogError
from twin.identify.least_squares import (
    CONVERGED,
    Estimate,
    Fit,
    Minimum,
    Termination,
    fit_starts,
    fit_starts_from_scratch,
)
from twin.identify.logs import Log
from twin.identify.parameters import (
    AT_REST,
    DEFAULT_PARAMETERS,
    FITTED_SHARE,
    HIDDEN_PARAMETERS,
    SERVO_PARAMETER,
    fitted_parameters,
)
from twin.identify.plate_motion import check_motion, fit_drives
from twin.identify.prepare import prepare
from twin.identify.twin_model import TWIN_SELECTION, TwinProblem, assess_parameters, whiteness
from twin.identify.verdicts import ParameterVerdict
from twin.identify.windows import cut, moving_spans
from twin.scenario.schema import Scenario
from twin.shadow.belief import Belief


@dataclass(frozen=True, kw_only=True)
class ForecastConstants:
    """Constants of a forecast.

    Attributes:
        noise_draws: Number of draws of the noise over which intervals are averaged.
        initial_force_m_s2: Unknown force on an uneven screen with which the search for its size
            begins.
        size_iterations: Number of estimates of the sizes of unknown motion.
        start_steps: Largest number of steps by which the start of a window is found.
        max_information_share: Eigenvalue of the scaled information, 1 if all parameters differ,
            below which the parameters of its direction cannot be told apart.
        min_direction_share: Component of a parameter in such a direction above which it is named.
        worst_ratio: Half width over the one that counts as identified, which stands for all larger
            ones and for none where motions are compared.
    """

    noise_draws: int = 24
    initial_force_m_s2: float = 1e-3
    size_iterations: int = 2
    start_steps: int = 8
    max_information_share: float = 0.05
    min_direction_share: float = 0.35
    worst_ratio: float = 100.0


FORECAST = ForecastConstants()


@dataclass(frozen=True)
class ExpectedFit(Fit[TwinProblem]):
    """The fit of a log at known parameters, with the intervals that noise gives on the average.

    Attributes:
        how: Constants of the forecast.
    """

    how: ForecastConstants = FORECAST

    @property
    def information(self) -> Array:
        """Expected information J'J of the parameters and what is known before, shape (P, P)."""
        slopes = self.found.linearisation.eliminate_starts()[0][0, ..., 1:]
        return np.asarray(np.einsum("wmi,wmj->ij", slopes, slopes)) + np.diag(self.problem.known[1])

    def estimate(self) -> Estimate:
        """The parameters and their uncertainty as ``identify`` has it, over draws of the noise.

        From white residuals the part is taken that the parameters would explain. The bootstrap
        draws of all draws of the noise are one sample.
        """
        line, information = self.found.linearisation, self.information
        slopes = line.eliminate_starts()[0][0, ..., 1:]
        noise = np.random.default_rng(0)
        found = []
        for _ in range(self.how.noise_draws):
            r = noise.standard_normal(line.r.shape)
            taken = np.linalg.solve(information, np.einsum("wmi,wm->i", slopes, r[0]))
            left = line._replace(r=r - line.by_parameter @ taken)
            found.append(Fit(self.problem, self.found._replace(linearisation=left)).estimate())
        return replace(
            found[0],
            draws=np.concatenate([each.draws for each in found]),
            degrees_of_freedom=np.mean([each.degrees_of_freedom for each in found], axis=0),
        )


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
        verdicts: Of the parameters: true value, expected interval and verdict; none if nothing is
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
        lag = 0.0 if found.value is None else 1 / (2 * math.pi * found.value)
        half = 1 / (2 * math.pi * found.low) - lag if found.low > 0 else math.inf
        size = lag
    else:
        half, size = half_width(found) / about.factor, abs(found.value or 0.0) / about.factor
    allowed = max(about.tolerance, about.relative * size)
    return min(half / allowed, how.worst_ratio)


def forecast_log(
    log: Log,
    truth: Scenario,
    names: tuple[str, ...] = DEFAULT_PARAMETERS,
    share: float = FITTED_SHARE,
    how: ForecastConstants = FORECAST,
) -> RigForecast:
    """What ``identify`` is expected to find in such a log as one of a known rig.

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
    spread = truth.plant.surface.spread_percent / 100
    uneven = spread > 0 or belief.values["dwell"] > 0
    fitted = fitted_parameters((*names, *AT_REST) if uneven else names)
    theta = np.array([[belief.values.get(name, 0.0) for name in fitted]])
    problem = TwinProblem(windows, fitted, log.model, belief.grip, noise=TWIN_SELECTION.noise)
    fit = _expect(problem, theta, (spread, how.initial_force_m_s2) if uneven else None, how)
    asked = tuple(name for name in names if name not in HIDDEN_PARAMETERS)
    left = whiteness(Fit(fit.problem, fit.found))
    return RigForecast(
        verdicts=assess_parameters(asked, fit, drives, left),
        indistinct=tuple(find_indistinct(fitted, fit.information, how)),
    )


def _expect(
    problem: TwinProblem,
    theta: Array,
    sizes: tuple[float, float] | None,
    how: ForecastConstants,
) -> ExpectedFit:
    """The fit at known parameters, without the windows that they do not explain.

    Args:
        problem: With all windows.
        theta: The parameters, shape (1, P).
        sizes: First guess of the size of unknown motion, see ``TwinProblem``; None for none.
        how: Constants of the forecast.
    """

    def at(problem: TwinProblem, starts: Array) -> Minimum:
        line = problem.linearise(theta, starts)
        reached = Termination(CONVERGED, 0, 0)
        return Minimum(theta, starts, problem.cost(line.r), line, reached)

    found = at(problem, fit_starts_from_scratch(problem, theta, how.start_steps))
    if sizes is not None:
        for _ in range(how.size_iterations):
            problem = problem.whiten(found, sizes)
            found = at(problem, fit_starts(problem, theta, found.starts, how.start_steps))
            sizes = problem.estimate_sizes(found)
        problem = problem.whiten(found, sizes)
        found = at(problem, found.starts)
    misfit = problem.misfit(found.linearisation.r)[0]
    most = TWIN_SELECTION.unexplained_misfit_ratio * max(1.0, float(np.median(misfit)))
    explained = misfit < most
    if not explained.all() and explained.sum() >= 3:
        problem = replace(problem, windows=problem.windows.take(explained))
        found = found._replace(
            starts=found.starts[:, :, explained],
            linearisation=found.linearisation.take(explained),
        )
    return ExpectedFit(problem, found, how)
