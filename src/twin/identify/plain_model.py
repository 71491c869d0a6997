"""The plain model of any rig's axis, fitted to simulated windows with free initial states.

    x'' = gain (u - lever u''/g) + level + camber x - viscous x' - friction sign(x')

u is the command behind a first-order lag, or the measured angle, a dead time ago; a ball that
friction can hold rests. The lever is how far above the plate's axis the ball is as good as. Axes
are independent but for friction. Dead time is all between command and measured ball.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from controllers.arrays import Array, Mask
from twin.base.errors import LogError, plural
from twin.identify.axis_fitting import AXIS_FITTING, AxisFitting
from twin.identify.axis_logs import MAX_COMMAND_GAP_S, AxisLog
from twin.identify.axis_problem import AxisProblem
from twin.identify.command_model import TiltHistory
from twin.identify.first_look import FirstLook
from twin.identify.intervals import Estimate
from twin.identify.least_squares import Fit, fit_starts, fit_starts_from_scratch, minimise
from twin.identify.profiles import Profile
from twin.identify.windows import MIN_WINDOW_SHARE, SAMPLE_BIN_S, axis_windows, find_moving, spans

WHITE_RATIO_STD = 1.7
"""Standard deviation of the ratio by which ``AxisFit.explained`` judges, for N white residuals in
windows of 25 to 250, times the square root of N: by simulation."""
ADMIXTURE_DIFFERENCE = 0.02
"""Step of finite differences of a further tilt, in swings of the tilt."""
SMOOTH_PARAMETERS = ("gain", "dead_time", "lag", "level")
"""Parameters that are always fitted; the lag of a measured angle is 0."""


@dataclass(frozen=True)
class AxisFit(Fit[AxisProblem]):
    """The fit of an axis, weighed by the usual residual.

    Attributes:
        log: The fitted samples, without those that something else disturbed.
        sigma: The usual residual of windows in which the ball moves, m.
        noise: The usual residual of the first fit, m.
        pushed: Seconds left out.
        windowed: The fit to windows of one level, where this one predicts better.
        briefer: The fits to shorter windows, if there are enough.
        profiles: Likelihood profiles of drive effects and lever.
        rivals: Drive effects, with their values in swings, that explain the log nearly as well in
            the place of the fitted one.
        how: All constants of the fit.
    """

    log: AxisLog
    sigma: float
    noise: float = 0.0
    pushed: float = 0.0
    windowed: AxisFit | None = None
    briefer: tuple[AxisFit, ...] = ()
    profiles: tuple[Profile, ...] = ()
    rivals: tuple[tuple[str, float], ...] = ()
    how: AxisFitting = AXIS_FITTING

    def estimate(self, *, white: bool | None = None) -> Estimate:
        """The parameters, as uncertain as what drives and lever may be makes them, too.

        Args:
            white: Whether the residuals are white; None to find that out.
        """
        white = self.explained if white is None else white
        own, names = super().estimate(white=white), self.problem.names
        for each in self.profiles:
            for at, name in enumerate(names):
                own.draws[:, at] += each.deviations[name]
                if name == each.name:
                    own.identifiable[at] = True
                    own.degrees_of_freedom[at] = max(len(self.problem.windows) - len(names), 1)
        return own

    @property
    def explained(self) -> bool:
        """Whether the residuals are as white as noise, so that no other model leaves much less.

        The scatter of differences of successive residuals, over the square root of two, equals the
        scatter of the residuals if they are white, and is smaller if a motion is left in them. Both
        are medians over windows in which the ball moves, so that a few disturbed ones do not count;
        of few residuals they scatter.
        """
        moving = find_moving(self.problem.windows, self.how.hold_out.min_motion_m)
        line, weights = self.found.linearisation, self.problem.windows.weight[..., 0]
        rows = zip(line.r[0, moving], weights[moving], strict=True)
        each = [row[: len(weight)][weight > 0] / weight[weight > 0] for row, weight in rows]
        size, change = (
            float(np.median([np.median(np.abs(part)) for part in parts if len(part)]))
            for parts in (each, [np.diff(row) / np.sqrt(2) for row in each])
        )
        how, count = self.how.drives, sum(map(len, each))
        by_chance = 1 - how.white_stds * WHITE_RATIO_STD / np.sqrt(max(count, 1))
        return change > min(how.white_share, by_chance) * size

    @property
    def window_s(self) -> float:
        """Length of its windows in s."""
        return self.problem.longest - SAMPLE_BIN_S

    def with_lead(self, lead_s: float) -> AxisFit:
        """This fit, with predictions that start from so many seconds of samples."""
        hold_out = replace(self.how.hold_out, lead_s=lead_s)
        return replace(self, how=replace(self.how, hold_out=hold_out))

    @property
    def by_unknowns(self) -> Array:
        """Slopes of the residuals by the shares of what was added to the tilt, shape (W, M, C)."""
        each = [self.slope_by_tilt(more) for more in self.log.added]
        return np.stack(each, axis=-1) if each else super().by_unknowns

    def slope_by_tilt(self, more: Array) -> Array:
        """Slope of the residuals by a share of further tilt that acts along, shape (W, M).

        Args:
            more: The further tilt, when each command begins, shape (K,).
        """
        scale, size = self.problem.tilt.scale, float(np.std(more)) or 1.0
        share = ADMIXTURE_DIFFERENCE * scale / size
        ways = []
        for each in (share, -share):
            mixed = replace(self.log, tilt=self.log.tilt + each * more)
            problem = replace(self.problem, tilt=TiltHistory(mixed, scale))
            moved = problem.linearise(self.found.theta, self.found.starts, slopes=False)
            ways.append(moved.r[0])
        return np.asarray((ways[0] - ways[1]) / (2 * share))

    def take(self, which: Mask) -> AxisFit:
        """Fit of a selection of the windows, with the same parameters."""
        problem = replace(self.problem, windows=self.problem.windows.take(which))
        found = self.found._replace(
            starts=self.found.starts[:, :, which],
            linearisation=self.found.linearisation.take(which),
        )
        return replace(self, problem=problem, found=found)

    def refit(self, log: AxisLog, names: tuple[str, ...], longest: float) -> AxisFit:
        """The fit of other parameters, windows or parts of a log, begun from this one."""
        guess = np.array([[self.value(name) for name in names]])
        problem = replace(self.problem, names=names)
        found = fit_from_guesses(log, problem, longest, guess, self.sigma, self.how)
        return replace(found, noise=self.noise, pushed=self.pushed, rivals=self.rivals)


def fit_axis(
    log: AxisLog,
    names: tuple[str, ...],
    longest: float,
    delays: tuple[float, float],
    how: AxisFitting = AXIS_FITTING,
    look: FirstLook | None = None,
) -> AxisFit:
    """Fit an axis from no first guess, or a first look.

    Short windows without friction find gain, dead time and level, and what disturbed the ball; from
    there, and from the gain of a mere tilt, the long ones begin with several frictions.

    Args:
        log: Of the axis.
        names: Of the parameters.
        longest: Length of the windows in s.
        delays: Smallest and largest dead time in s.
        how: All constants of the fit.
        look: A first look at it, which is a guess as well.

    Raises:
        LogError: If there are too few windows.
    """
    nothing = axis_windows(log, np.zeros(0), np.zeros(0))
    smooth = tuple(name for name in names if name in SMOOTH_PARAMETERS)
    problem = AxisProblem(nothing, smooth, TiltHistory(log), longest, delays)
    search = how.search
    guess = problem.first_guesses(dead_time=search.delay_guesses_s)
    if look:
        guess = np.vstack((guess, guess_from(look, problem)))
    brief = fit_from_guesses(log, problem, search.first_window_s, guess, 2e-3, how)
    rms = np.sqrt(brief.problem.misfit(brief.found.linearisation.r)[0])
    usual = float(np.median(rms[find_moving(brief.problem.windows, how.hold_out.min_motion_m)]))
    pushed = brief.problem.windows.begin[rms > search.disturbed_residual_ratio * usual]
    log = log.without(pushed, search.first_window_s)
    frictions = search.friction_guesses_m_s2
    guess = np.array([[brief.value(name) for name in names]]).repeat(2 * len(frictions), axis=0)
    by_tilt = search.tilt_gain_m_s2 * problem.tilt.scale
    guess[: len(frictions), 0] = np.copysign(by_tilt, guess[0, 0])
    if "friction" in names:
        guess[:, names.index("friction")] = np.tile(frictions, 2)
    problem = replace(problem, names=names)
    if look:
        guess = np.vstack((guess, guess_from(look, problem)))
    sigma = brief.sigma * longest / search.first_window_s
    fit = fit_from_guesses(log, problem, longest, guess, sigma, how)
    return replace(fit, noise=brief.sigma, pushed=search.first_window_s * len(pushed))


def guess_from(look: FirstLook, problem: AxisProblem) -> Array:
    """A guess of the parameters by a first look, shape (1, P).

    Gain, dead time, level, friction, camber and damping are those of the look. Its delay is all
    taken as dead time, so the lag is zero. A parameter that the look does not contain has its usual
    first guess.

    Args:
        look: At the log that is fitted.
        problem: The fit with the parameters to guess.
    """
    seen = {"gain": look.gain * problem.tilt.scale, "dead_time": look.delay, "lag": 0.0}
    seen |= {"level": look.level, "friction": look.friction, "camber": look.camber}
    seen |= {"viscous": look.damping}
    return problem.first_guesses(**{k: [v] for k, v in seen.items() if k in problem.names})


def fit_from_guesses(
    log: AxisLog,
    problem: AxisProblem,
    longest: float,
    guess: Array,
    sigma: float,
    how: AxisFitting,
) -> AxisFit:
    """The best fit from C guesses, shape (C, P), for a first guess of the residual in m.

    Args:
        log: What is fitted.
        problem: Of which names, input and bounds are taken.
        longest: Length of the windows in s.
        guess: First guesses.
        sigma: The residual.
        how: All constants of the fit.
    """
    windows = axis_windows(log, *spans(log, longest))
    if len(windows) < 3:
        raise LogError(
            f"{plural(len(windows), 'stretch', 'stretches')} of {MIN_WINDOW_SHARE * longest:.2g} s "
            f"with the ball seen every {MAX_COMMAND_GAP_S:g} s, at least 3 are needed: record for "
            "longer, or see the ball more often"
        )
    base = windows.weight
    # a ball that rests leaves no residual, which would make every motion an outlier
    moving = find_moving(windows, how.hold_out.min_motion_m)
    windows = replace(windows, weight=base / sigma)
    problem = replace(problem, windows=windows, longest=longest + SAMPLE_BIN_S)
    search = how.search
    control = search.control
    starts = fit_starts_from_scratch(problem, guess, 4)
    found = minimise(problem, guess, starts, 8, 3, control=control).best(3)
    found = minimise(problem, found.theta, found.starts, 20, 3, control=control)
    for last in (False, False, True):
        best = found.best(1)
        theta, starts = best.theta, best.starts
        off = np.abs(problem.simulate_samples(theta, starts)[0][0] - windows.ball) * base
        each = 1.4826 * np.nanmedian(np.where(base > 0, off, np.nan), axis=1)
        sigma = max(float(np.median(each[moving])), 1e-5)
        good = off < search.outlier_ratio * np.maximum(each, sigma)[:, None]
        weight = np.where(good, base, 0.0) / sigma
        problem = replace(problem, windows=replace(windows, weight=weight))
        if last and "lag" in problem.names:
            theta = _add_lag_guesses(theta, problem.names, problem.delays, search.lag_guesses_s)
            starts = fit_starts(problem, theta, np.repeat(starts, len(theta), axis=1), 4)
            tried = minimise(problem, theta, starts, search.lag_steps, 3, 2, control)
            theta, starts = tried.best(search.continued_lags)[:2]
        steps, polish = (30, 2) if last else (6, 0)
        found = minimise(problem, theta, starts, steps, 3, polish, control)
    return AxisFit(problem, found.best(1), log, sigma, how=how)


def _add_lag_guesses(
    theta: Array, names: tuple[str, ...], delays: tuple[float, float], lags: Sequence[float]
) -> Array:
    """Guesses with other lags and the same sum of dead time and lag, next to the given one.

    Only the shape of a response distinguishes the two. Without a lag its slope is zero, so no step
    would ever leave there.
    """
    return np.concatenate((theta, set_lags(theta.repeat(len(lags), axis=0), names, lags, delays)))


def set_lags(
    theta: Array, names: tuple[str, ...], lags: Sequence[float] | Array, delays: tuple[float, float]
) -> Array:
    """Give candidates other lags and as much dead time less, shape (C, P)."""
    at, lag = names.index("dead_time"), names.index("lag")
    both, found = theta[:, at] + theta[:, lag], theta.copy()
    found[:, lag] = np.clip(lags, 0.0, np.maximum(both - delays[0], 0.0))
    found[:, at] = np.clip(both - found[:, lag], *delays)
    return found
