"""The plain model of any rig's axis, fitted to simulated windows whose beginnings are free.

    x'' = gain u(t - dead time) + level + camber x - viscous x' - friction sign(x')

u is the command behind a first-order lag, or the measured angle; a ball that friction can hold
rests. Axes are independent of one another. Dead time is all between command and measured ball.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from controllers.arrays import Array
from twin.errors import LogError
from twin.identify.judged import (
    BOUNDED,
    CORRELATED,
    EVERY,
    HORIZONS,
    IDENTIFIED,
    LEAD,
    MOVES,
    NEAR,
    NOT,
    PREDICTORS,
    Identified,
    ParameterVerdict,
    Predicted,
    _baselines,
    _quantile,
    score,
)
from twin.identify.logs import BALLS, GAP, AnyLog, AxisLog
from twin.identify.parameters import PLAIN, IdentifiedParameter
from twin.identify.search import (
    TOLERATED,
    Estimate,
    Fitting,
    Linearisation,
    Minimum,
    estimated,
    fit_starts,
    minimise,
)
from twin.identify.windows import BIN, SHORT, AxisWindows, spans

GRID = 0.008
"""Step of the simulation in s."""


FINE = 0.002
"""Step of the lag in s."""


PRIOR = np.diag(np.array([0.02, 0.3]) ** -2.0)
"""Weak knowledge of a start: m and m/s."""


START_STEPS = np.array([1e-4, 1e-3, 1e-3])
"""Steps of finite differences of a start: m, m/s, and m/s^2 of a level of its own."""


class Tilt:
    """What tilts the plate, at any time, behind lags.

    Attributes:
        scale: How far it swings: what one unit of the fit's gain is for.
    """

    def __init__(self, log: AxisLog, usual: float | None = None) -> None:
        """Of a log; ``usual`` is the swing of another one that it was fitted to."""
        time, tilt = log.time, log.tilt
        self.begin = float(time[0])
        self.scale = usual or float(np.std(tilt)) or 1.0
        area = tilt[:-1] if log.held else (tilt[:-1] + tilt[1:]) / 2
        covered = np.concatenate(([0.0], np.cumsum(area * np.diff(time))))
        fine = self.begin + FINE * np.arange(int((time[-1] - self.begin) / FINE) + 2)
        # the mean of each step, so that no command's time is rounded to a step
        mean = np.diff(np.interp(fine, time, covered)) / FINE
        self.time, self.mean = fine[1:], mean / self.scale
        self.lagged: dict[float, Array] = {}

    def at(self, time: Array, lag: float) -> Array:
        """Behind a lag in s, at times in s of any shape."""
        if lag not in self.lagged:
            if len(self.lagged) > 40:
                self.lagged.clear()
            stay = float(np.exp(-FINE / lag)) if lag > 1e-4 else 0.0
            first = [stay * self.mean[0]]
            self.lagged[lag] = lfilter([1.0 - stay], [1.0, -stay], self.mean, zi=first)[0]
        return np.interp(time, self.time, self.lagged[lag])


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

    windows: AxisWindows
    names: tuple[str, ...]
    tilt: Tilt
    longest: float
    delays: tuple[float, float]
    drift: float = 0.0
    about = PLAIN
    start_steps = START_STEPS
    prior = PRIOR

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Least and largest values of the parameters, shapes (P,)."""
        least, most = super().bounds
        at = self.names.index("dead_time")
        least[at], most[at] = self.delays
        return least, most

    def cost(self, r: Array) -> Array:
        """Robust (Cauchy): what a window costs rises with the logarithm of its misfit, (C,)."""
        each = self.windows.size * TOLERATED * np.log1p(self.misfit(r) / TOLERATED)
        return np.asarray(each.sum(axis=-1))

    def weights(self, r: Array) -> Array:
        """How much each window counts, 1 for a perfect one, shape (C, W)."""
        return np.asarray(1 / (1 + self.misfit(r) / TOLERATED))

    def initial_starts(self) -> Array:
        """A straight line through the first samples of each window, shape (2 or 3, 1, W)."""
        out = np.zeros((3 if self.drift else 2, 1, len(self.windows)))
        for w, (time, ball, weight) in enumerate(
            zip(self.windows.time, self.windows.ball, self.windows.weight, strict=True)
        ):
            first = np.flatnonzero(weight > 0)
            first = first[time[first] < max(0.3, time[first[2]] if len(first) > 2 else 0.0) + 1e-6]
            line = np.stack((np.ones_like(first), time[first]), axis=-1)
            out[:2, 0, w] = np.linalg.lstsq(line, ball[first], rcond=1e-6)[0]
        return out

    def simulated(self, theta: Array, starts: Array) -> Array:
        """Positions in m every ``GRID``, shape (N, C, W).

        Args:
            theta: Parameters, shape (C, P) or (C, W, P), in which case dead time and lag of a
                candidate are those of its first window.
            starts: Position, velocity and, where the level is followed, what it is off.
        """
        each = theta if theta.ndim > 2 else theta[:, None]
        values = {name: each[..., k] for k, name in enumerate(self.names)}
        zero = np.zeros((len(theta), 1))
        gain, level, camber, viscous, friction, lag = (
            values.get(name, zero)
            for name in ("gain", "level", "camber", "viscous", "friction", "lag")
        )
        steps = int(np.ceil(self.longest / GRID)) + 1
        grid = self.windows.begin + GRID * np.arange(steps)[:, None]
        pairs = np.stack((values["dead_time"][:, 0], lag[:, 0]), axis=-1)
        pairs, which = np.unique(pairs, axis=0, return_inverse=True)
        inputs = np.stack([self.tilt.at(grid - delay, each) for delay, each in pairs], axis=1)
        p, v = starts[0], starts[1]
        own = level + starts[2] if len(starts) > 2 else level + 0 * p
        out = np.empty((steps, *p.shape))
        out[0] = p
        push = gain * inputs[0][which] + own
        for n in range(steps - 1):
            ahead = gain * inputs[n + 1][which] + own
            a = push + camber * p - viscous * v
            after = v + GRID * a
            a = (a + ahead + camber * (p + GRID * v) - viscous * after) / 2
            pull = v / GRID + a
            after = GRID * (pull - np.clip(pull, -friction, friction))
            p = p + (GRID / 2) * (v + after)
            v, push = after, ahead
            out[n + 1] = p
        return out

    def reported(self, theta: Array, starts: Array) -> tuple[Array, Array]:
        """A simulation at the samples in m, and its rate in m/s, shape (C, W, B)."""
        places = self.simulated(theta, starts)
        at = self.windows.time / GRID
        low = np.minimum(at.astype(int), len(places) - 2)
        rows = np.arange(len(self.windows))[:, None]
        first, second = (np.moveaxis(places[low + k, :, rows], -1, 0) for k in (0, 1))
        found = np.asarray(first + (at - low) * (second - first))
        return found, (second - first) / GRID

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
        prior = np.diag([*np.diag(PRIOR), 1e-6])
        return Linearisation(r, by_start, np.pad(found.by_parameter, room), prior)


FRICTIONS = (0.0, 0.02, 0.08, 0.25)
"""First guesses of friction, m/s^2."""


DELAYS = (0.02, 0.1, 0.2, 0.35)
"""First guesses of the dead time, s."""


LAGS = (0.02, 0.045, 0.07, 0.1, 0.14)
"""Lags in s that are tried in place of dead time."""


BY_TILT = 6.5
"""A first guess of the gain, m/s^2 per rad: between a hollow ball and a solid one."""


BRIEF = 0.8
"""Length in s of the windows of the first fit, which finds its way from any guess."""


PUSHED = 5.0
"""Residual of such a window over the usual one above which a hand, the rim or a false ball was at
work: no longer window goes over it."""


OUTLIER = 4.0
"""Residual of a sample over that of its window above which it is left out."""


SMOOTH = ("gain", "dead_time", "lag", "level")
"""What is always fitted; the lag is 0 of a measured angle."""


@dataclass(frozen=True)
class AxisFit:
    """The fit of an axis.

    Attributes:
        log: What was fitted, without the parts where something else moved the ball.
        problem: What was fitted, weighed by the usual residual.
        found: The minimum, of one candidate.
        sigma: The usual residual in m.
        noise: What windows of ``BRIEF`` leave, m.
        pushed: Seconds left out.
    """

    log: AxisLog
    problem: PlainProblem
    found: Minimum
    sigma: float
    noise: float = 0.0
    pushed: float = 0.0

    def value(self, name: str) -> float:
        """A parameter; 0 if it is not fitted."""
        names = self.problem.names
        return float(self.found.theta[0, names.index(name)]) if name in names else 0.0

    def estimate(self) -> Estimate:
        """The parameters and their uncertainty, every window an independent observation."""
        return estimated(self.problem, self.found.theta[0], self.found.linearisation)

    def again(self, log: AxisLog, names: tuple[str, ...], longest: float) -> AxisFit:
        """The fit of other parameters, windows or parts of a log, begun from this one."""
        guess = np.array([[self.value(name) for name in names]])
        found = _fitted(
            log, self.problem.tilt, names, longest, guess, self.sigma, self.problem.delays
        )
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
    tilt = Tilt(log)
    smooth = tuple(name for name in names if name in SMOOTH)
    guess = np.array([[PLAIN[name].start for name in smooth]]).repeat(len(DELAYS), axis=0)
    guess[:, smooth.index("dead_time")] = DELAYS
    brief = _fitted(log, tilt, smooth, BRIEF, guess, 2e-3, delays)
    rms = np.sqrt(brief.problem.misfit(brief.found.linearisation.r)[0])
    pushed = brief.problem.windows.begin[rms > PUSHED * np.median(rms)]
    into = log.sampled - pushed[:, None]
    kept = ~((into >= 0) & (into <= BRIEF)).any(axis=0)
    log = replace(log, sampled=log.sampled[kept], ball=log.ball[kept])
    guess = np.array([[brief.value(name) for name in names]]).repeat(2 * len(FRICTIONS), axis=0)
    guess[: len(FRICTIONS), 0] = np.copysign(BY_TILT * tilt.scale, guess[0, 0])
    if "friction" in names:
        guess[:, names.index("friction")] = np.tile(FRICTIONS, 2)
    fit = _fitted(log, tilt, names, longest, guess, brief.sigma * longest / BRIEF, delays)
    return replace(fit, noise=brief.sigma, pushed=BRIEF * len(pushed))


def _fitted(
    log: AxisLog,
    tilt: Tilt,
    names: tuple[str, ...],
    longest: float,
    guess: Array,
    sigma: float,
    delays: tuple[float, float],
) -> AxisFit:
    """The best fit from C guesses, shape (C, P), for a first guess of the residual in m."""
    windows = AxisWindows.of(log, *spans(log, longest))
    if len(windows) < 3:
        raise LogError(
            f"{len(windows)} stretches of {SHORT * longest:.2g} s with the ball seen every {GAP:g} "
            "s, at least 3 are needed: record for longer, or see the ball more often"
        )
    base, there = windows.weight, windows.weight > 0
    problem = PlainProblem(
        replace(windows, weight=base / sigma), names, tilt, longest + BIN, delays
    )
    starts = np.repeat(problem.initial_starts(), len(guess), axis=1)
    found = minimise(problem, guess, fit_starts(problem, guess, starts, 4), 8, 6)
    best = np.argsort(found.cost)[:3]
    found = minimise(problem, found.theta[best], found.starts[:, best], 20, 6)
    for last in (False, False, True):
        best = np.argsort(found.cost)[:1]
        theta, starts = found.theta[best], found.starts[:, best]
        off = problem.reported(theta, starts)[0][0] - windows.ball
        off = np.where(there, np.abs(off) * base, np.nan)
        each = 1.4826 * np.nanmedian(off, axis=1)
        sigma = max(float(np.median(each)), 1e-5)
        good = there & (off < OUTLIER * np.maximum(each, sigma)[:, None])
        weight = np.where(good, base, 0.0) / sigma
        problem = replace(problem, windows=replace(windows, weight=weight))
        if last and "lag" in names:
            theta = _along(theta, names, delays)
            starts = fit_starts(problem, theta, np.repeat(starts, len(theta), axis=1), 4)
        found = minimise(problem, theta, starts, 30 if last else 6, 4, 2 if last else 0)
    best = np.argsort(found.cost)[:1]
    r, by_start, by_parameter = (part[best] for part in found.linearisation[:3])
    line = Linearisation(r, by_start, by_parameter, PRIOR)
    found = Minimum(
        found.theta[best], found.starts[:, best], found.cost[best], line, found.termination
    )
    return AxisFit(log, problem, found, sigma)


def _along(theta: Array, names: tuple[str, ...], delays: tuple[float, float]) -> Array:
    """Guesses of the same dead time and lag together, for the two are told by their shapes only.

    Without a lag its slope is none, so that no step would ever leave there.
    """
    at, lag = names.index("dead_time"), names.index("lag")
    both = float(theta[0, at] + theta[0, lag])
    guesses = np.repeat(theta, 1 + len(LAGS), axis=0)
    guesses[1:, lag] = np.clip(LAGS, 0.0, max(both - delays[0], 0.0))
    guesses[1:, at] = both - guesses[1:, lag]
    return guesses


PAST = 2.4
"""Seconds of samples of which a level that is followed is known."""


FOLLOWED = 0.1
"""How far off in m/s^2 a level that is followed may be from that of the fit: standard deviation."""


def predicted(log: AxisLog, fit: AxisFit, at: Array, *, follow: bool = True) -> Predicted:
    """Predict from times in s on, shape (W,), by what was measured before.

    Args:
        log: The axis, held out.
        fit: The model.
        at: When predictions begin.
        follow: Whether a level that is followed is tried as well.
    """
    names, theta, tilt = fit.problem.names, fit.found.theta, Tilt(log, fit.problem.tilt.scale)
    windows = AxisWindows.of(log, at - LEAD, at + HORIZONS[-1] + NEAR)
    ahead, there = windows.time - LEAD, windows.weight > 0
    ball = np.where(there, windows.ball, np.nan)
    known = there & (ahead < 0)
    lead = replace(windows, weight=windows.weight / fit.noise * known)
    longest = LEAD + HORIZONS[-1] + 2 * NEAR
    problem = replace(fit.problem, windows=lead, tilt=tilt, longest=longest)

    def simulated(**changes: Array | float) -> Array:
        values = np.repeat(theta[:, None], len(at), axis=1)
        for name, change in changes.items():
            if name in names:
                values[..., names.index(name)] *= change if name == "friction" else 1.0
                values[..., names.index(name)] += change if name == "level" else 0.0
        starts = fit_starts(problem, values, problem.initial_starts(), 8)
        return np.asarray(problem.reported(values, starts)[0][0])

    by = {"model": simulated(), **_baselines(ahead, ball, known)}
    if follow:
        windows = AxisWindows.of(log, at - PAST, at)
        windows = replace(windows, weight=windows.weight / fit.sigma)
        past = replace(fit.problem, windows=windows, tilt=tilt, longest=PAST + NEAR, drift=FOLLOWED)
        starts = fit_starts(past, theta, past.initial_starts(), 8)
        by["without friction"] = simulated(friction=0.0)
        by["level followed"] = simulated(level=starts[2])
    found = Predicted(at, ahead, ball, by)
    return _switched(found) if follow else found


def _switched(found: Predicted) -> Predicted:
    """The level followed only while that has predicted better, in what had been seen by then."""
    gained = [np.log(np.maximum(np.abs(found.errors(name, 1.0)), 1e-4)) for name in PREDICTORS[:2]]
    gain = np.where(found.way > MOVES, gained[0] - gained[1], np.nan)
    seen = found.begin[:, None] >= found.begin + 1.0 + NEAR
    so_far = np.nansum(np.where(seen, gain, 0.0), axis=1)
    followed = np.where(so_far[:, None] > 0, found.by["level followed"], found.by["model"])
    return replace(found, by={**found.by, "level followed": followed})


def beginnings(log: AxisLog) -> Array:
    """When predictions begin: every half second with enough samples before and after, s."""
    time = log.sampled
    if len(time) < 10:
        return np.zeros(0)
    tries = np.arange(time[0] + PAST, time[-1] - HORIZONS[0], EVERY)
    step = float(np.median(np.diff(time)))
    before, past, after = (
        np.searchsorted(time, tries + last) - np.searchsorted(time, tries + first)
        for first, last in ((-LEAD, 0.0), (-PAST, 0.0), (0.0, HORIZONS[0] + NEAR))
    )
    return tries[(before >= max(3, 0.5 * LEAD / step)) & (past >= 0.5 * PAST / step) & (after > 0)]


def crossed(fit: AxisFit, names: tuple[str, ...], longest: float) -> float:
    """Error in m of fits of each half of a log by these parameters, in the other half.

    The geometric mean of the medians over all horizons where the ball moves; infinite if unknown.
    """
    time = fit.log.sampled
    middle = float(np.median(time))
    halves = fit.log.between(-np.inf, middle), fit.log.between(middle, np.inf)
    medians = []
    for fitted, tried in (halves, halves[::-1]):
        at = beginnings(tried)
        if len(at) < 3:
            return np.inf
        try:
            found = predicted(tried, fit.again(fitted, names, longest), at, follow=False)
        except LogError:  # a half has too few windows
            return np.inf
        moves = found.way > MOVES
        medians += [_quantile(found.errors("model", ahead)[moves], 0.5) for ahead in HORIZONS]
    return float(np.exp(np.mean(np.log(medians)))) if np.isfinite(medians).all() else np.inf


LONGEST = 2.5
"""Length of the windows in s, as a rule."""


BRIEFER = 0.5
"""Share of it of the windows of a second fit: a model error shows as another value there."""


OPTIONAL = ("camber", "viscous")
"""Fitted where it pays, unless asked for."""


PAYS = 0.9
"""Share of the error across the halves of the log that is left with a parameter that pays."""


NO_BOUNDS = np.array([-np.inf, np.inf])


PAUSE = 10.0
"""Time in s between two logs that are fitted as one."""


@dataclass(frozen=True, kw_only=True)
class AnyIdentification(Identified):
    """What logs of any rig show.

    Attributes:
        fits: Axis to its fit.
        unit: Axis to the unit of its command: rad or count.
        factor: Share of gravity that accelerates the ball.
    """

    fits: Mapping[str, AxisFit]
    unit: Mapping[str, str]
    factor: float


def identify_any(
    logs: list[AnyLog],
    held: list[AnyLog] | float,
    names: tuple[str, ...] = (),
    factor: float = BALLS["hollow"],
    longest: float = LONGEST,
    progress: Callable[[float], None] = lambda _: None,
) -> AnyIdentification:
    """Fit the plain model to logs and try it on others, or on their last share.

    Args:
        logs: What is fitted.
        held: What is held out: other logs of the same rig, or a share of each log's time.
        names: Parameters that are fitted beside gain, dead time, lag and level; none for friction
            and what pays.
        factor: Share of gravity that accelerates the ball: 3/5 of a hollow one, 5/7 of a solid one.
        longest: Length of the windows in s.
        progress: Called with the share of the work done.

    Raises:
        LogError: If no axis can be identified: what each of them lacks.
    """
    notes = [note for log in logs for note in log.notes]
    fits: dict[str, AxisFit] = {}
    found: list[ParameterVerdict] = []
    reasons, predictions = [], {}
    axes = list(logs[0].axes)
    parts = [_parts(log, held) if isinstance(held, float) else (log.axes, {}) for log in logs]
    others = [p[1] for p in parts] if isinstance(held, float) else [log.axes for log in held]
    for k, axis in enumerate(axes):
        unit = logs[0].unit[axis]
        try:
            log = _joined([part[0][axis] for part in parts])
            _check_excited(log)
            fit, about = _chosen(log, names, longest)
            notes += [f"{axis}: {each}" for each in about]
        except LogError as error:
            reasons.append(f"{axis}: {error}")
            found += [
                ParameterVerdict(about=_about(name, unit), name=f"{name}_{axis}", why=str(error))
                for name in (*SMOOTH, "friction")
            ]
            continue
        fits[axis] = fit
        found += _verdicts(fit, axis, unit, longest)
        if fit.pushed:
            notes.append(f"{axis}: {fit.pushed:.1f} s left out: a hand, the rim or a false ball")
        if there := [other[axis] for other in others if axis in other]:
            predictions[axis] = _joined(there)
        progress((k + 1) / len(axes))
    if not fits:
        raise LogError(f"{logs[0].source}: no axis can be identified: {'; '.join(reasons)}")
    notes += [f"not identified: {each}" for each in reasons]
    tried = _predictions(predictions, fits)
    scores = [score({axis: each}) for axis, each in tried.items()]
    if len(tried) > 1:
        scores.append(score(tried))
    return AnyIdentification(
        source=logs[0].source,
        seconds=sum(float(np.ptp(part[0][axes[0]].sampled)) for part in parts),
        verdicts=tuple(found),
        scores=tuple(scores),
        predictions=tried,
        notes=tuple(notes),
        fits=fits,
        unit=logs[0].unit,
        factor=factor,
    )


def _parts(log: AnyLog, share: float) -> tuple[dict[str, AxisLog], dict[str, AxisLog]]:
    """The axes of a log before and after a share of its time from the end."""
    border = min(each.sampled[0] + (1 - share) * np.ptp(each.sampled) for each in log.axes.values())
    return (
        {axis: each.between(-np.inf, border) for axis, each in log.axes.items()},
        {axis: each.between(border, np.inf) for axis, each in log.axes.items()},
    )


def _joined(logs: list[AxisLog]) -> AxisLog:
    """Logs of an axis one after another, with a pause between."""
    start, shifted = 0.0, []
    for each in logs:
        shift = start - float(each.sampled[0] if len(each.sampled) else each.time[0])
        shifted.append((each.time + shift, each.tilt, each.sampled + shift, each.ball))
        start = float(each.time[-1]) + shift + PAUSE
    time, tilt, sampled, ball = (np.concatenate(part) for part in zip(*shifted, strict=True))
    return AxisLog(time, tilt, logs[0].held, sampled, ball)


def _check_excited(log: AxisLog) -> None:
    if float(np.ptp(log.tilt)) == 0.0:
        raise LogError("nobody moved this axis in the log; tilt it to and fro to identify it")
    if len(log.sampled) < 30 or float(np.ptp(log.ball)) < 0.005:
        way = 1000 * float(np.ptp(log.ball)) if len(log.ball) else 0.0
        raise LogError(
            f"{len(log.sampled)} ball positions within {way:.1f} mm; let it roll some centimetres"
        )


def _chosen(log: AxisLog, names: tuple[str, ...], longest: float) -> tuple[AxisFit, list[str]]:
    """The fit with the parameters that pay, and what is to be said of it."""
    notes: list[str] = []
    asked = tuple(name for name in PLAIN if name in names and name not in SMOOTH)
    chosen = (*(each for each in SMOOTH if log.held or each != "lag"), *(asked or ("friction",)))
    delays = (0.0, 0.5) if log.held else (-0.1, 0.5)
    fit = fit_axis(log, chosen, longest, delays)
    least, most = delays
    if not least + 0.01 < fit.value("dead_time") < most - 0.01 and (
        not log.held or fit.value("dead_time") > 0.25
    ):
        fit = fit_axis(log, chosen, longest, (0.0 if log.held else -0.5, 1.0))
        notes.append("dead time at a bound, which was widened to 1 s")
    if not names:
        best = crossed(fit, chosen, longest)
        for name in OPTIONAL:
            richer = (*chosen, name)
            left = crossed(fit, richer, longest)
            if left < PAYS * best:
                notes.append(
                    f"{name} fitted along: with it one half of the log predicts the other to "
                    f"{1000 * left:.1f} mm, without it to {1000 * best:.1f} mm"
                )
                chosen, best = richer, left
        if len(chosen) > len(fit.problem.names):
            fit = fit.again(fit.log, chosen, longest)
    return fit, notes


def _predictions(logs: Mapping[str, AxisLog], fits: Mapping[str, AxisFit]) -> dict[str, Predicted]:
    """Predictions of all axes from the same times on: the ball is seen in both or in neither."""
    at = beginnings(next(iter(logs.values()))) if logs else np.zeros(0)
    return {axis: predicted(log, fits[axis], at) for axis, log in logs.items() if len(at)}


def _about(name: str, unit: str) -> IdentifiedParameter:
    about = PLAIN[name]
    return replace(about, unit=f"m/s^2 by {unit}") if name == "gain" else about


def _verdicts(fit: AxisFit, axis: str, unit: str, longest: float) -> list[ParameterVerdict]:
    """Value, interval and verdict of each parameter of an axis."""
    names = fit.problem.names
    own = fit.estimate()
    low, high = own.value - own.half_width, own.value + own.half_width
    unlike = np.zeros(len(names), bool)
    try:
        other = fit.again(fit.log, names, BRIEFER * longest).estimate()
        apart = np.abs(own.value - other.value)
        unlike = apart > np.hypot(own.half_width, other.half_width)
        low = np.where(unlike, np.minimum(low, other.value - other.half_width), low)
        high = np.where(unlike, np.maximum(high, other.value + other.half_width), high)
    except LogError:
        pass
    alike = np.abs(own.correlation) > CORRELATED
    ends = np.transpose(fit.problem.bounds)
    found = []
    for k, name in enumerate(names):
        scale = 1 / fit.problem.tilt.scale if name == "gain" else 1.0
        others = [PLAIN[each].key for j, each in enumerate(names) if alike[k, j] and j != k]
        reasons = (
            ["shorter windows give another value, which the interval holds: a model error"]
            if unlike[k]
            else []
        )
        values = (own.value[k], low[k], high[k])
        found.append(
            _verdict(_about(name, unit), f"{name}_{axis}", values, ends[k], reasons, others, scale)
        )
    if "lag" in names:  # the two together are told where neither is
        pair = [names.index("dead_time"), names.index("lag")]
        both = Estimate(
            own.value[pair].sum(),
            own.draws[:, pair].sum(axis=1),
            np.asarray(own.identifiable[pair].all()),
            own.degrees_of_freedom[pair].min(),
        )
        about = replace(PLAIN["dead_time"], key="dead time + lag")
        values = (both.value, both.value - both.half_width, both.value + both.half_width)
        found.insert(3, _verdict(about, f"delay_{axis}", values, NO_BOUNDS, [], []))
    return found


def _verdict(
    about: IdentifiedParameter,
    name: str,
    values: tuple[Array, Array, Array],
    ends: Array,
    reasons: list[str],
    alike: list[str],
    scale: float = 1.0,
) -> ParameterVerdict:
    """The verdict of one parameter.

    Args:
        about: Which.
        name: With its axis.
        values: The fit and both ends of its interval.
        ends: Least and largest value of a fit.
        reasons: What has been found wrong so far.
        alike: Keys of what it cannot be told from.
        scale: From these values to those that are told.
    """
    (value, low, high), (least, most) = map(float, values), map(float, ends)
    if not math.isfinite(high - low):
        why = f"the log does not show it; {about.experiment}"
        return ParameterVerdict(about=about, name=name, why=why)
    low, high = min(low, value - about.floor), max(high, value + about.floor)
    low, high = max(low, least), min(high, most)
    half = (high - low) / 2
    found = ParameterVerdict(
        about=about, name=name, value=scale * value, low=scale * low, high=scale * high
    )
    slack = 1e-3 * (most - least)
    at_bound = value < least + slack or value > most - slack
    if value < least + slack and least == 0:
        reasons.append(f"not told from none; {about.experiment}")
    elif at_bound:
        reasons.append(f"at its bound of {value:.3g}; {about.experiment}")
    if name.startswith("gain") and low <= 0 <= high:
        reasons.append(f"not told from none: another column, exchanged axes, or {about.experiment}")
        return replace(found, word=NOT, why="; ".join(reasons))
    if half <= max(about.tolerance, about.relative * abs(value)) and not at_bound:
        return replace(found, word=IDENTIFIED, why="; ".join(reasons))
    if alike:
        reasons.append(f"told together with {' and '.join(alike)} only")
    elif not at_bound:
        reasons.append(f"its interval is wide; {about.experiment}")
    bounded = at_bound or low <= least or high >= most
    return replace(found, word=BOUNDED if bounded else NOT, why="; ".join(reasons))
