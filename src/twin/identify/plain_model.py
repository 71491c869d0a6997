"""The plain model of any rig's axis, fitted to simulated windows whose beginnings are free.

    x'' = gain (u - lever u''/g) + level + camber x - viscous x' - friction sign(x')

u is the command behind a first-order lag, or the measured angle, a dead time ago; a ball that
friction can hold rests. The lever is how far above the plate's axis the ball is as good as. Axes
are independent but for friction. Dead time is all between command and measured ball.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from controllers.arrays import Array
from controllers.ballplate import BallPlate
from twin.base.errors import LogError
from twin.identify.drives import (
    PROFILED_EFFECTS,
    TRIED_DEAD_BANDS,
    TiltHistory,
    residual_by_dead_band,
)
from twin.identify.judged import (
    HORIZON_TOLERANCE_S,
    HORIZONS_S,
    LEAD_S,
    MIN_MOTION_M,
    PREDICTION_INTERVAL_S,
    PREDICTOR_NAMES,
    Predicted,
    predict_windows,
    quantile,
)
from twin.identify.logs import MAX_COMMAND_GAP_S, AxisLog
from twin.identify.parameters import PLAIN_PARAMETERS
from twin.identify.search import (
    BOOTSTRAP_DRAWS,
    Estimate,
    Fit,
    Fitting,
    Linearisation,
    SampleWindows,
    fit_starts,
    fit_starts_from_scratch,
    minimise,
)
from twin.identify.windows import MIN_WINDOW_SHARE, SAMPLE_BIN_S, axis_windows, spans

SIMULATION_STEP_S = 0.008
"""Step of the simulation in s."""
MIN_CROSS_SPEED_RATIO = 0.3
"""Speed along the other axis by the most that a step changes one, from which on the two are one."""
START_PRECISION = np.diag(np.array([0.02, 0.3]) ** -2.0)
"""Weak knowledge of a start: m and m/s."""
START_STEPS = np.array([1e-4, 1e-3, 1e-3])
"""Steps of finite differences of a start: m, m/s, and m/s^2 of a level of its own."""


@dataclass(frozen=True)
class PlainProblem(Fitting):
    """What is fitted to what, of one axis.

    Attributes:
        windows: The samples.
        names: Of the parameters that are fitted.
        tilt: What tilts the plate.
        longest: Length of the simulation in s.
        delays: Least and largest dead time in s.
        drift: Standard deviation in m/s^2 of a level of each window's own, which is then the
            third number of its start; 0 for none.
    """

    windows: SampleWindows
    names: tuple[str, ...]
    tilt: TiltHistory
    longest: float
    delays: tuple[float, float]
    drift: float = 0.0
    about = PLAIN_PARAMETERS
    start_steps = START_STEPS
    prior = START_PRECISION
    grows = True

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Least and largest values of the parameters, shapes (P,)."""
        least, most = super().bounds
        at = self.names.index("dead_time")
        least[at], most[at] = self.delays
        return least, most

    def initial_starts(self) -> Array:
        """A straight line through the first samples of each window, shape (2 or 3, 1, W)."""
        out = np.zeros((3 if self.drift else 2, 1, len(self.windows)))
        windows = self.windows
        each = zip(windows.time, windows.ball[..., 0], windows.weight[..., 0], strict=True)
        for w, (time, ball, weight) in enumerate(each):
            first = np.flatnonzero(weight > 0)
            first = first[time[first] < max(0.3, time[first[2]] if len(first) > 2 else 0.0) + 1e-6]
            line = np.stack((np.ones_like(first), time[first]), axis=-1)
            out[:2, 0, w] = np.linalg.lstsq(line, ball[first], rcond=1e-6)[0]
        return out

    def simulated(self, theta: Array, starts: Array) -> Array:
        """Positions in m every ``STEP``, shape (N, C, W).

        Args:
            theta: Parameters, shape (C, P) or (C, W, P), in which case dead time and lag of a
                candidate are those of its first window.
            starts: Position, velocity and, where the level is followed, what it is off.
        """
        each = theta if theta.ndim > 2 else theta[:, None]
        values = {name: each[..., k] for k, name in enumerate(self.names)}
        zero = np.zeros((len(theta), 1))
        gain, level, camber, viscous, friction = (
            values.get(name, zero) for name in ("gain", "level", "camber", "viscous", "friction")
        )
        steps = int(np.ceil(self.longest / SIMULATION_STEP_S)) + 1
        grid = self.windows.begin + SIMULATION_STEP_S * np.arange(steps)[:, None]
        told = (values.get(name, zero)[:, 0] for name in ("dead_time", "lag", *PROFILED_EFFECTS))
        kinds, which = np.unique(np.stack(tuple(told), axis=-1), axis=0, return_inverse=True)
        inputs = np.stack([self.tilt.at(grid - delay, *each) for delay, *each in kinds], axis=1)
        p, v = starts[0], starts[1]
        push = gain * inputs[:, which] + (level + starts[2] if len(starts) > 2 else level + 0 * p)
        # a step of Heun's method is linear in what is pushed, p and v, but for friction
        given = SIMULATION_STEP_S * (
            (push[:-1] + push[1:]) / 2 - (SIMULATION_STEP_S / 2) * viscous * push[:-1]
        )
        by_place = SIMULATION_STEP_S * camber * (1 - (SIMULATION_STEP_S / 2) * viscous)
        kept = 1 + SIMULATION_STEP_S * ((SIMULATION_STEP_S / 2) * (camber + viscous**2) - viscous)
        most = SIMULATION_STEP_S * friction + 0 * p
        ways = self.tilt.log.across
        across = np.interp(grid, *ways)[:, None] if ways[1].any() else [None] * steps
        out = np.empty((steps, *p.shape))
        out[0] = p
        for n in range(steps - 1):
            free = given[n] + by_place * p + kept * v
            after = _apply_friction(v, free, most, across[n])
            p = p + (SIMULATION_STEP_S / 2) * (v + after)
            v = after
            out[n + 1] = p
        return out

    def reported(self, theta: Array, starts: Array) -> tuple[Array, Array]:
        """A simulation at the samples in m, and its rate in m/s, shape (C, W, B, 1)."""
        places = self.simulated(theta, starts)
        at = self.windows.time / SIMULATION_STEP_S
        low = np.minimum(at.astype(int), len(places) - 2)
        rows = np.arange(len(self.windows))[:, None]
        first, second = (np.moveaxis(places[low + k, :, rows], -1, 0) for k in (0, 1))
        found = np.asarray(first + (at - low) * (second - first))
        return found[..., None], ((second - first) / SIMULATION_STEP_S)[..., None]

    def linearise(self, theta: Array, starts: Array, *, slopes: bool = True) -> Linearisation:
        """Residuals and slopes of C candidates, and how far a window's own level is off."""
        found = super().linearise(theta, starts, slopes=slopes)
        if not self.drift:
            return found
        # one value more: how far the window's own level is off that of all
        r = np.concatenate((found.r, starts[2][..., None] / self.drift), axis=-1)
        room = [*[(0, 0)] * 2, (0, 1), (0, 0)]
        by_start = np.pad(found.by_start, room)
        by_start[..., -1, 2] = 1 / self.drift
        prior = np.diag([*np.diag(START_PRECISION), 1e-6])
        return Linearisation(r, by_start, np.pad(found.by_parameter, room), prior)


def _apply_friction(v: Array, free: Array, most: Array, across: Array | None) -> Array:
    """Velocity in m/s after a step in which friction takes up to ``most`` of the ``free`` one.

    Of a ball that turns it acts against the old way, then against the new one; of one that goes
    along the other axis as well, against the mean way.

    Args:
        v: Velocity before, shape (C, W).
        free: After the step without friction.
        most: m/s, same shape.
        across: How fast the ball goes along the other axis; None for not at all.
    """
    after = free - np.minimum(np.maximum(free, -most), most)
    at = np.flatnonzero(v * after <= 0)
    if at.size:
        was, end, taken = v.take(at), free.take(at), most.take(at)
        pushed = np.abs(end - was)
        share = np.maximum(pushed - taken, 0.0) / np.maximum(pushed + taken, 1e-300)
        turned = (end - np.copysign(taken, was)) * share
        after.put(at, np.where(was == 0, after.take(at), turned))
    if across is None:
        return after
    before = np.maximum(np.hypot(v, across), 1e-300)
    end = free - most * v / before
    mean = (v + end) / (before + np.hypot(end, across))
    aslant = across >= MIN_CROSS_SPEED_RATIO * (np.abs(free - v) + most)
    return np.where(aslant, free - most * mean, after)


FRICTION_GUESSES = (0.0, 0.02, 0.08, 0.25)
"""First guesses of friction, m/s^2."""
DELAY_GUESSES_S = (0.02, 0.1, 0.2, 0.35)
"""First guesses of the dead time, s."""
LAG_GUESSES_S = (0.02, 0.045, 0.07, 0.1, 0.14)
"""Lags in s that are tried in place of dead time."""
BY_TILT = 6.5
"""A first guess of the gain, m/s^2 per rad: between a hollow ball and a solid one."""
FIRST_WINDOW_S = 0.8
"""Length in s of the windows of the first fit, which finds its way from any guess."""
DISTURBED_RESIDUAL_RATIO = 5.0
"""Residual of such a window over the usual one above which a hand, the rim or a false ball was at
work: no longer window goes over it."""
OUTLIER_RATIO = 4.0
"""Residual of a sample over that of its window above which it is left out."""
SMOOTH_PARAMETERS = ("gain", "dead_time", "lag", "level")
"""What is always fitted; the lag is 0 of a measured angle."""


NEAR_BY = np.array([0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 1.0, 1.005, 1.01, 1.02, 1.05, 1.1, 1.2])
"""What is tried beside a value that was found, by it."""
PROFILE_POINTS = 200
"""Values between those tried at which the costs of windows are interpolated."""
HEIGHT_STD_M = 0.005
"""How far off in m a height that is told may be: standard deviation."""
ACCEPTED_RESIDUAL_SHARE = 0.9
"""Share of the usual residual that is left with what is taken."""
DEAD_BAND_RESIDUAL_SHARE = 0.7
"""Share of what an ideal drive leaves unexplained that is left with a dead band worth a fit."""


@dataclass(frozen=True)
class Profile:
    """Fits with a parameter held at one value after another.

    Attributes:
        name: The parameter.
        names: Of all of them.
        theta: The fits, rising in it, shape (K, P).
        costs: What each window costs, shape (K, W).
        own: Which of them is the fit that is told.
        known: Whether it is a lever that is known, and how far off that is.
    """

    name: str
    names: tuple[str, ...]
    theta: Array
    costs: Array
    own: int
    known: bool = False

    @cached_property
    def moved(self) -> dict[str, Array]:
        """How far parameters are off in the best fits of windows drawn at random, (DRAWS,) each.

        The Bayesian bootstrap: each window counts by an exponential number. A lever is drawn by its
        likelihood, as the largest of Gumbel's numbers and its logarithm, and is as far off as a
        ruler; one that is known by that alone, whatever the windows say.
        """
        held = self.theta[:, self.names.index(self.name)]
        fine = np.interp(np.linspace(0, len(held) - 1, PROFILE_POINTS), np.arange(len(held)), held)
        costs, theta = (
            np.stack([np.interp(fine, held, each) for each in part.T], axis=-1)
            for part in (self.costs, self.theta - self.theta[self.own])
        )
        rng = np.random.default_rng(1)
        drawn = rng.exponential(size=(BOOTSTRAP_DRAWS, costs.shape[1])) @ costs.T
        if self.name == "lever":  # windows of one frequency agree in what they hardly know
            drawn -= 2 * rng.gumbel(size=drawn.shape)
            best = 0.0 if self.known else fine[drawn.argmin(axis=1), None]
            drawn = (fine - best - rng.normal(0.0, HEIGHT_STD_M, (BOOTSTRAP_DRAWS, 1))) ** 2
        return dict(zip(self.names, theta[drawn.argmin(axis=1)].T, strict=True))


def profile(fit: AxisFit, name: str, values: Sequence[float] | Array) -> Profile:
    """Fits with a parameter at each of K rising values, begun from one fit.

    Those of a lever behind a lag are begun from those beside as well, and the better taken: a ball
    that sticks for a moment has many a minimum.
    """
    names = tuple(dict.fromkeys((*fit.problem.names, name)))
    problem, at, K = replace(fit.problem, names=names), names.index(name), len(values)  # noqa: N806
    theta = np.array([[fit.value(each) for each in names]]).repeat(K, axis=0)
    starts, costs = fit.found.starts.repeat(K, axis=1), np.full((K, 1), np.inf)
    own = int(np.abs(np.subtract(values, theta[0, at])).argmin())
    hides = name == "lever" and "lag" in names
    for beside in (0, 1, -1)[: 3 if hides else 1]:
        source = np.clip(np.arange(K) + beside, 0, K - 1)
        guess = theta[source]
        guess[:, at] = values
        if hides:  # to second order lag^2 / 2 - lever / g shows, and the sum of lag and dead time
            more = 2 / BallPlate.gravity * (guess[:, at] - theta[source, at])
            lags = np.sqrt(np.maximum(guess[:, names.index("lag")] ** 2 + more, 1e-6))
            guess = _with_lags(guess, names, lags, problem.delays)
        begin = fit_starts(problem, guess, starts[:, source], 4)
        found = minimise(problem, guess, begin, 12, 2, 2)
        each = problem.costs(found.linearisation.r)
        better = each.sum(axis=1, keepdims=True) < costs.sum(axis=1, keepdims=True)
        theta, costs = np.where(better, found.theta, theta), np.where(better, each, costs)
        starts = np.where(better, found.starts, starts)
    known = name == "lever" and fit.log.lever is not None
    return Profile(name, names, theta, costs, own, known)


def with_drives(fit: AxisFit, longest: float) -> AxisFit:
    """The fit with what the log shows of its drives: dead band, play, slew."""
    tilt, windows = fit.problem.tilt, fit.problem.windows
    rest = residual_by_dead_band(tilt, windows, fit.value("dead_time"), fit.value("lag"))
    few = np.argsort(rest)[:8]
    bands = TRIED_DEAD_BANDS[np.sort(few[rest[few] < DEAD_BAND_RESIDUAL_SHARE * rest[0]])]
    for name in tilt.tried:
        values, other = (
            bands if name == "dead_band" else np.array(PLAIN_PARAMETERS[name].tried),
            fit,
        )
        while values.any():
            found = profile(other, name, values)
            theta = found.theta[[found.costs.sum(axis=1).argmin()]]
            more = replace(fit.problem, names=found.names)
            begun_from = replace(other, problem=more, found=fit.found._replace(theta=theta))
            last = other.problem.names == found.names
            other = begun_from.again(fit.log, found.names, longest)
            values = NEAR_BY * theta[0, found.names.index(name)] * (not last)
        if other.value(name) and other.sigma < ACCEPTED_RESIDUAL_SHARE * fit.sigma:
            fit = other
    return fit


def profile_drives(fit: AxisFit) -> AxisFit:
    """The fit with profiles of drives and lever, by which its intervals know of them."""
    near = {name: NEAR_BY * fit.value(name) for name in fit.problem.tilt.tried}
    tried = {
        name: sorted({*PLAIN_PARAMETERS[name].tried, *values}) for name, values in near.items()
    }
    tried.setdefault("lever", [-2 * HEIGHT_STD_M, 0.0, 2 * HEIGHT_STD_M])  # of one that is known
    return replace(fit, profiles=tuple(profile(fit, *each) for each in tried.items()))


@dataclass(frozen=True)
class AxisFit(Fit):
    """The fit of an axis, weighed by the usual residual.

    Attributes:
        log: What was fitted, without the parts where something else moved the ball.
        sigma: The usual residual in m.
        noise: What windows of ``BRIEF`` leave, m.
        pushed: Seconds left out.
        windowed: The fit to windows of one level, where this one predicts better.
        briefer: The fits to shorter windows, if there are enough.
    """

    log: AxisLog
    sigma: float
    noise: float = 0.0
    pushed: float = 0.0
    windowed: AxisFit | None = None
    briefer: tuple[AxisFit, ...] = ()
    profiles: tuple[Profile, ...] = ()

    def estimate(self) -> Estimate:
        """The parameters, as uncertain as what drives and lever may be makes them, too."""
        own, names = super().estimate(), self.problem.names
        for each in self.profiles:
            for at, name in enumerate(names):
                own.draws[:, at] += each.moved[name]
                if name == each.name:
                    own.identifiable[at] = True
                    own.degrees_of_freedom[at] = max(len(self.problem.windows) - len(names), 1)
        return own

    def again(self, log: AxisLog, names: tuple[str, ...], longest: float) -> AxisFit:
        """The fit of other parameters, windows or parts of a log, begun from this one."""
        guess = np.array([[self.value(name) for name in names]])
        problem = replace(self.problem, names=names)
        found = _fit_from_guesses(log, problem, longest, guess, self.sigma)
        return replace(found, noise=self.noise, pushed=self.pushed)


def fit_axis(
    log: AxisLog, names: tuple[str, ...], longest: float, delays: tuple[float, float]
) -> AxisFit:
    """Fit an axis from no first guess.

    Windows of ``BRIEF`` without friction find gain, dead time and level, and what pushed the
    ball; from there, and from the gain of a mere tilt, the long ones begin with several frictions.

    Args:
        log: Of the axis.
        names: Of the parameters.
        longest: Length of the windows in s.
        delays: Least and largest dead time in s.

    Raises:
        LogError: If there are too few windows.
    """
    nothing = axis_windows(log, np.zeros(0), np.zeros(0))
    smooth = tuple(name for name in names if name in SMOOTH_PARAMETERS)
    problem = PlainProblem(nothing, smooth, TiltHistory(log), longest, delays)
    brief = _fit_from_guesses(
        log, problem, FIRST_WINDOW_S, problem.first_guesses(dead_time=DELAY_GUESSES_S), 2e-3
    )
    rms = np.sqrt(brief.problem.misfit(brief.found.linearisation.r)[0])
    pushed = brief.problem.windows.begin[rms > DISTURBED_RESIDUAL_RATIO * np.median(rms)]
    log = log.without(pushed, FIRST_WINDOW_S)
    guess = np.array([[brief.value(name) for name in names]]).repeat(
        2 * len(FRICTION_GUESSES), axis=0
    )
    guess[: len(FRICTION_GUESSES), 0] = np.copysign(BY_TILT * problem.tilt.scale, guess[0, 0])
    if "friction" in names:
        guess[:, names.index("friction")] = np.tile(FRICTION_GUESSES, 2)
    problem = replace(problem, names=names)
    fit = _fit_from_guesses(log, problem, longest, guess, brief.sigma * longest / FIRST_WINDOW_S)
    return replace(fit, noise=brief.sigma, pushed=FIRST_WINDOW_S * len(pushed))


def _fit_from_guesses(
    log: AxisLog, problem: PlainProblem, longest: float, guess: Array, sigma: float
) -> AxisFit:
    """The best fit from C guesses, shape (C, P), for a first guess of the residual in m.

    Args:
        log: What is fitted.
        problem: Of which names, input and bounds are taken.
        longest: Length of the windows in s.
        guess: First guesses.
        sigma: The residual.
    """
    windows = axis_windows(log, *spans(log, longest))
    if len(windows) < 3:
        raise LogError(
            f"{len(windows)} stretches of {MIN_WINDOW_SHARE * longest:.2g} s with the ball seen "
            f"every {MAX_COMMAND_GAP_S:g} s, at least 3 are needed: record for longer, or see the "
            "ball more often"
        )
    base = windows.weight
    windows = replace(windows, weight=base / sigma)
    problem = replace(problem, windows=windows, longest=longest + SAMPLE_BIN_S)
    found = minimise(problem, guess, fit_starts_from_scratch(problem, guess, 4), 8, 6).ahead(3)
    found = minimise(problem, found.theta, found.starts, 20, 6)
    for last in (False, False, True):
        best = found.ahead(1)
        theta, starts = best.theta, best.starts
        off = np.abs(problem.reported(theta, starts)[0][0] - windows.ball) * base
        each = 1.4826 * np.nanmedian(np.where(base > 0, off, np.nan), axis=1)
        sigma = max(float(np.median(each)), 1e-5)
        good = off < OUTLIER_RATIO * np.maximum(each, sigma)[:, None]
        weight = np.where(good, base, 0.0) / sigma
        problem = replace(problem, windows=replace(windows, weight=weight))
        if last and "lag" in problem.names:
            theta = _along(theta, problem.names, problem.delays)
            starts = fit_starts(problem, theta, np.repeat(starts, len(theta), axis=1), 4)
        found = minimise(problem, theta, starts, 30 if last else 6, 4, 2 if last else 0)
    return AxisFit(problem, found.ahead(1), log, sigma)


def _along(theta: Array, names: tuple[str, ...], delays: tuple[float, float]) -> Array:
    """Guesses of the same dead time and lag together, for the two are told by their shapes only.

    Without a lag its slope is none, so that no step would ever leave there.
    """
    guesses = _with_lags(theta.repeat(len(LAG_GUESSES_S), axis=0), names, LAG_GUESSES_S, delays)
    return np.concatenate((theta, guesses))


def _with_lags(
    theta: Array, names: tuple[str, ...], lags: Sequence[float] | Array, delays: tuple[float, float]
) -> Array:
    """C candidates, shape (C, P), with other lags and as much dead time less."""
    at, lag = names.index("dead_time"), names.index("lag")
    both, found = theta[:, at] + theta[:, lag], theta.copy()
    found[:, lag] = np.clip(lags, 0.0, np.maximum(both - delays[0], 0.0))
    found[:, at] = np.clip(both - found[:, lag], *delays)
    return found


LEVEL_HISTORY_S = 2.4
"""Seconds of samples of which a level that is followed is known."""
LEVEL_STD_M_S2 = 0.1
"""How far off in m/s^2 a level that is followed may be from that of the fit: standard deviation."""


def axis_predicted(log: AxisLog, fit: AxisFit, at: Array, *, follow: bool = True) -> Predicted:
    """Predict from times in s on, shape (W,), by what was measured before.

    Args:
        log: The axis, held out.
        fit: The model.
        at: When predictions begin.
        follow: Whether a level that is followed is tried as well, and the model without friction.
    """
    log = replace(log, across=log.across * fit.log.across[1].any())
    theta, tilt = fit.found.theta, TiltHistory(log, fit.problem.tilt.scale)
    by = {"model": theta}
    if follow:
        windows = axis_windows(log, at - LEVEL_HISTORY_S, at)
        windows = replace(windows, weight=windows.weight / fit.sigma)
        past = replace(
            fit.problem,
            windows=windows,
            tilt=tilt,
            longest=LEVEL_HISTORY_S + HORIZON_TOLERANCE_S,
            drift=LEVEL_STD_M_S2,
        )
        own = fit_starts_from_scratch(past, theta, 8)[2]
        for who, name, values in (
            ("without friction", "friction", 0.0),
            ("level followed", "level", fit.value("level") + own),
        ):
            by[who] = np.repeat(theta[:, None], len(at), axis=1)
            if name in fit.problem.names:
                by[who][..., fit.problem.names.index(name)] = values
    found = predict_windows(_ahead(log, fit, at), LEAD_S, by, "x")["x"]
    return _choose_level(found) if follow else found


def _ahead(log: AxisLog, fit: AxisFit, at: Array) -> PlainProblem:
    """Windows from before the times ``at`` in s to the last horizon."""
    windows = axis_windows(log, at - LEAD_S, at + HORIZONS_S[-1] + HORIZON_TOLERANCE_S)
    windows = replace(windows, weight=windows.weight / fit.noise)
    tilt = TiltHistory(log, fit.problem.tilt.scale)
    longest = LEAD_S + HORIZONS_S[-1] + 2 * HORIZON_TOLERANCE_S
    problem: PlainProblem = fit.problem
    return replace(problem, windows=windows, tilt=tilt, longest=longest, drift=0.0)


HUBER_ERROR_M = 0.003
"""Error of a prediction in m from which on it counts by its size, no longer by its square."""
ACCEPTED_ERROR_SHARE = 0.9
"""Share of an error that is left with what pays."""
MAX_DELAY_AND_LAG_S = 0.4
"""Most dead time and lag of such a fit in s."""
USUAL_GUESSES = {"dead_time": 0.1, "lag": 0.1, "friction": 0.03}
"""First guesses of that fit, beside those of a fit to windows."""


def predicting(fit: AxisFit, longest: float) -> AxisFit:
    """The fit that predicts its own log best where the one to windows does so badly.

    A model in error, such as of servos with a dead band, explains a window best by other values
    than those by which it predicts, for with its start free it may bend its whole way; a level
    that drifts is taken for gain and friction unless each window has its own.
    """
    own = _typical(fit, fit.log, follow=True)
    if own < HUBER_ERROR_M:
        return fit
    found, least = fit, own
    drifting = replace(fit, problem=replace(fit.problem, drift=LEVEL_STD_M_S2))
    for other in (
        drifting.again(fit.log, fit.problem.names, longest),
        replace(fit, found=fit.found._replace(theta=_by_predictions(fit))),
    ):
        left = _typical(other, fit.log, follow=True)
        if left < least:
            found, least = replace(other, windowed=fit, profiles=fit.profiles), left
    return found


def _by_predictions(fit: AxisFit) -> Array:
    """Parameters fitted to predictions of the log, the best of several beginnings, (1, P)."""
    problem = _ahead(fit.log, fit, beginnings(fit.log))
    windows, names = problem.windows, problem.names
    known = windows.time < LEAD_S
    part = replace(windows, weight=windows.weight * known[..., None])
    before = replace(problem, windows=part, longest=LEAD_S + HORIZON_TOLERANCE_S)
    target = (windows.weight[..., 0] > 0) & ~known
    # what has no slope stays as it is
    step = np.array([PLAIN_PARAMETERS[name].difference or 1e-12 for name in names])
    least, most = problem.bounds
    most[[name in ("dead_time", "lag") for name in names]] = MAX_DELAY_AND_LAG_S

    def off(theta: Array) -> Array:
        theta = np.atleast_2d(theta)
        places = problem.reported(theta, fit_starts_from_scratch(before, theta, 4))[0]
        each = np.clip((places - windows.ball)[:, target, 0] / HUBER_ERROR_M, -1e3, 1e3)
        return np.asarray(np.squeeze(each))

    def slopes(theta: Array) -> Array:
        moved = theta + np.diag(np.where(theta + step > most, -step, step))
        each = off(np.concatenate((theta[None], moved)))
        return np.asarray(((each[1:] - each[0]) / np.diagonal(moved - theta)[:, None]).T)

    usual = {"gain": (*fit.briefer, fit)[0].value("gain")} | USUAL_GUESSES
    usual |= {name: fit.value(name) for name in PROFILED_EFFECTS}
    first = [[usual.get(name, 0.0) for name in names]]
    first += [[each.value(name) for name in names] for each in (fit, *fit.briefer)]
    begun_at = np.clip(first, least + 1e-6, most - 1e-6)
    how: Any = {"bounds": (least, most), "x_scale": step, "loss": "soft_l1", "max_nfev": 100}
    tried = [least_squares(off, guess, slopes, **how) for guess in begun_at]
    found = min(tried, key=lambda each: float(each.cost))
    return np.asarray(found.x[None])


def _choose_level(found: Predicted) -> Predicted:
    """The level followed only while that has predicted better, in what had been seen by then."""
    gained = [
        np.log(np.maximum(np.abs(found.errors(name, 1.0)), 1e-4)) for name in PREDICTOR_NAMES[:2]
    ]
    gain = np.where(found.way > MIN_MOTION_M, gained[0] - gained[1], np.nan)
    seen = found.begin[:, None] >= found.begin + 1.0 + HORIZON_TOLERANCE_S
    so_far = np.nansum(np.where(seen, gain, 0.0), axis=1)
    followed = np.where(so_far[:, None] > 0, found.by["level followed"], found.by["model"])
    return replace(found, by={**found.by, "level followed": followed})


def beginnings(log: AxisLog) -> Array:
    """When predictions begin: every half second with enough samples before and after, s."""
    time = log.sampled
    if len(time) < 10:
        return np.zeros(0)
    tries = np.arange(time[0] + LEVEL_HISTORY_S, time[-1] - HORIZONS_S[0], PREDICTION_INTERVAL_S)
    step = float(np.median(np.diff(time)))
    before, past, after = (
        np.searchsorted(time, tries + last) - np.searchsorted(time, tries + first)
        for first, last in (
            (-LEAD_S, 0.0),
            (-LEVEL_HISTORY_S, 0.0),
            (0.0, HORIZONS_S[0] + HORIZON_TOLERANCE_S),
        )
    )
    return tries[
        (before >= max(3, 0.5 * LEAD_S / step))
        & (past >= 0.5 * LEVEL_HISTORY_S / step)
        & (after > 0)
    ]


def cross_validate(fit: AxisFit, names: tuple[str, ...], longest: float) -> float:
    """Error in m of fits of each half of a log by these parameters, in the other half.

    See ``_typical``.
    """
    time = fit.log.sampled
    middle = float(np.median(time))
    halves = fit.log.between(-np.inf, middle), fit.log.between(middle, np.inf)
    try:
        each = [
            _typical(fit.again(fitted, names, longest), tried, follow=fit.problem.drift > 0)
            for fitted, tried in (halves, halves[::-1])
        ]
    except LogError:  # a half has too few windows
        return np.inf
    return float(np.sqrt(np.prod(each)))


def _typical(fit: AxisFit, log: AxisLog, *, follow: bool = False) -> float:
    """Geometric mean over the horizons of the median error in m where the ball moves.

    Infinite if one is unknown; of the better of model and level that is followed.
    """
    at = beginnings(log)
    if len(at) < 3:
        return np.inf
    found = axis_predicted(log, fit, at, follow=follow)
    moves = found.way > MIN_MOTION_M
    medians = [
        [quantile(found.errors(who, ahead)[moves], 0.5) for ahead in HORIZONS_S]
        for who in PREDICTOR_NAMES[: 1 + follow]
    ]
    each = np.exp(np.mean(np.log(medians), axis=1))
    return float(np.min(each)) if np.isfinite(each).all() else np.inf
