"""First look at an axis in a second: gain, delay and level by the weak form, without simulation.

With a test function w that is zero, with its slope, at both ends of a window of time T,

    int w'' x dt = gain int w u(t - d) dt + camber int w x dt + (level - friction sign(v)) int w dt,

is linear in gain, camber, level and friction at each delay d. The noise of the positions matters on
the left only, where they are differentiated; the tilt has none. Only windows are taken in which the
ball rolls in one direction and touches no end of its way, so that neither sticking nor an end stop
is part of the equation. Where too few of them show anything, longer windows of any motion show
gain, level and damping, as a plain linear model has them, or friction and camber in place of it.

A clock that drifts makes the delay grow with time, which is one column more of the same equation,
as is an offset of the clock of each recording where several are joined.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d
from scipy.signal import fftconvolve, savgol_filter

from controllers.arrays import Array, Mask
from twin.base.errors import plural
from twin.base.page import digits
from twin.identify.axis_logs import AxisLog
from twin.identify.command_model import TiltHistory
from twin.identify.samples import find_noise


@dataclass(frozen=True, kw_only=True)
class WeakForm:
    """Constants of the first look.

    Attributes:
        step_s: Step of the grid on which integrals are computed.
        window_s: Length of a window.
        rolling_windows_s: Lengths of further windows of a ball that rolls in one direction.
        plain_windows_s: Lengths of windows of any motion, the best first.
        max_slow_share: Share of a window of any motion, above which a ball that is slower than the
            smallest speed may rest there, and friction balance the tilt.
        moving_slow_shares: Such shares of windows in which the ball hardly rests.
        max_gap_steps: Longest time between two samples of a window, in median steps.
        speed_window_s: Time over which the speed is measured.
        min_speed_m_s: Speed above which the ball rolls, and its direction is known.
        friction_speed_m_s: Speed below which friction is taken as proportional to it, where windows
            hold any motion.
        end_margin_m: Distance from the ends of the way within which an end stop may be touched.
        min_end_share: Share of the time near an end above which there may be an end stop.
        delays_s: Smallest and largest dead time.
        lags_s: Lags that are tried.
        outlier_ratio: Residual over the usual one above which a window is left out.
        min_windows: Smallest number of windows for an answer.
        min_gain_stds: Smallest gain, in its standard deviations, for an answer.
        max_residual_share: Largest residual of the equation, as a share of the left side, for an
            answer.
        max_noise_share: Largest variance of the left side by the noise of the samples, as a share,
            for an answer: a controller feeds the noise back, which biases the gain.
        min_damping_stds: Smallest damping, in its standard deviations, that is believed.
        min_drift_stds: Smallest drift of a clock, in its standard deviations, that is believed.
        min_drift: Smallest such drift, as a share.
        max_likelihood_ratio: Twice the logarithm of a likelihood ratio above which a lever is
            rejected: the 95 % quantile of chi-squared with one degree of freedom.
    """

    step_s: float = 0.005
    window_s: float = 0.4
    rolling_windows_s: tuple[float, ...] = (0.3, 0.5)
    plain_windows_s: tuple[float, ...] = (0.9, 0.6)
    max_slow_share: float = 1.0
    moving_slow_shares: tuple[float, ...] = (0.5, 0.3)
    max_gap_steps: float = 4.0
    speed_window_s: float = 0.12
    min_speed_m_s: float = 0.02
    friction_speed_m_s: float = 0.005
    end_margin_m: float = 0.002
    min_end_share: float = 0.03
    delays_s: tuple[float, float] = (0.0, 0.5)
    lags_s: tuple[float, ...] = (0.0, 0.04, 0.08, 0.12)
    outlier_ratio: float = 4.0
    min_windows: int = 8
    min_gain_stds: float = 4.0
    max_residual_share: float = 0.7
    max_noise_share: float = 0.1
    min_damping_stds: float = 3.0
    min_drift_stds: float = 6.0
    min_drift: float = 1e-4
    max_likelihood_ratio: float = 3.84


WEAK_FORM = WeakForm()


@dataclass(frozen=True, kw_only=True)
class FirstLook:
    """Result of a first look at an axis.

    Attributes:
        gain: Acceleration of the ball by the tilt, in m/s^2 by its unit.
        gain_std: Its standard deviation.
        delay: Dead time and lag together, s.
        delay_std: Its standard deviation.
        level: m/s^2.
        level_std: Its standard deviation.
        friction: m/s^2.
        friction_std: Its standard deviation.
        camber: 1/s^2.
        camber_std: Its standard deviation.
        damping: 1/s.
        damping_std: Its standard deviation.
        windows: Number of windows that are used.
        plain: Whether they hold any motion; else the ball rolls in one direction in each.
        explained: Share of the variance of the left side that the equation explains.
        at_ends: Share of the time in which the ball is at an end stop.
        drift: By how much the clock of the positions is faster than that of the commands.
        drift_std: Its standard deviation.
        terms: What the model has next to gain, delay and level: damping, friction, camber.
    """

    gain: float
    gain_std: float
    delay: float
    delay_std: float
    level: float
    level_std: float
    friction: float
    friction_std: float
    camber: float
    camber_std: float
    damping: float
    damping_std: float
    windows: int
    plain: bool
    explained: float
    at_ends: float
    drift: float
    drift_std: float
    terms: tuple[str, ...]

    @property
    def misfit(self) -> float:
        """Twice the negative logarithm of the likelihood, but for a constant of the windows."""
        return self.windows * float(np.log(max(1 - self.explained, 1e-12)))

    def drifts(self, how: WeakForm = WEAK_FORM) -> bool:
        """Whether the clock of the positions goes at a different speed."""
        return abs(self.drift) > max(how.min_drift_stds * self.drift_std, how.min_drift)

    def describe(self, axis: str, unit: str) -> str:
        """In a sentence.

        Args:
            axis: Its name.
            unit: Unit of the tilt.
        """
        ends = f"; {100 * self.at_ends:.0f} % at an end stop" if self.at_ends else ""
        rolls = "of any motion, by a plain model" if self.plain else "of a ball that rolls freely"
        without = " without friction, which makes the gain small" if self.plain else ""
        return (
            f"first look, {axis}: gain {digits(self.gain)} +- {digits(2 * self.gain_std)} m/s^2 by "
            f"{unit}, dead time + lag {self.delay:.2f} s, level {digits(self.level)} +- "
            f"{digits(2 * self.level_std)} m/s^2, from {plural(self.windows, 'window')} "
            f"{rolls}{without}; +- is scatter alone{ends}"
        )


def look_first(log: AxisLog, how: WeakForm = WEAK_FORM) -> FirstLook | None:
    """Gain, delay and level of an axis; None if too few windows show them.

    Args:
        log: The axis.
        how: Constants.
    """
    return look_at_rolling(log, how) or next(iter(look_plainly_in_several_ways(log, how)), None)


def look_plainly_in_several_ways(log: AxisLog, how: WeakForm = WEAK_FORM) -> list[FirstLook]:
    """The plain linear model of an axis by windows of several lengths, with damping and without.

    The first is the best: with damping only where it is significant. No damping is negative. How
    far they differ is how far the model is in error.
    """
    found = []
    for window_s in how.plain_windows_s:
        both = [look_plainly(log, window_s, how, terms) for terms in (("damping",), ())]
        each = [look for look in both if look and look.damping >= 0]
        weak = len(each) > 1 and each[0].damping < how.min_damping_stds * each[0].damping_std
        found += each[::-1] if weak else each
    return found


def look_at_moving(log: AxisLog, how: WeakForm = WEAK_FORM) -> list[FirstLook]:
    """Looks by windows of any motion in which the ball hardly rests.

    Friction of a ball at rest balances the tilt, and so makes the gain of other windows small.

    Args:
        log: The axis.
        how: Constants.
    """
    looks = [
        look_plainly(log, window_s, replace(how, max_slow_share=share), terms)
        for window_s in how.plain_windows_s
        for share in how.moving_slow_shares
        for terms in (("friction", "camber"), ("damping",))
    ]
    return [look for look in looks if look and look.damping >= 0]


def look_with_levers(
    log: AxisLog, levers: Sequence[float], how: WeakForm = WEAK_FORM
) -> list[FirstLook]:
    """Looks with friction and camber by windows of any motion, with levers that explain them.

    The plate's acceleration moves a ball that is a lever above its axis: x'' = gain (u - lever u''
    / g). Where a log hardly shows the lever, it does not show the gain of a quick motion either.

    Args:
        log: The axis.
        levers: Those that are tried, rising, m.
        how: Constants.

    Returns:
        For windows of each length the looks whose lever no likelihood ratio rejects and those next
        to them, as the true lever lies between two; the best one first.
    """
    found = []
    for window_s in how.plain_windows_s:
        every = [
            look_plainly(replace(log, lever=each), window_s, how, ("friction", "camber"))
            for each in levers
        ]
        found += _keep_possible(every, how)
    return found


def _keep_possible(every: Sequence[FirstLook | None], how: WeakForm) -> list[FirstLook]:
    """Of looks with rising levers those no likelihood ratio rejects and their neighbours, sorted.

    Args:
        every: The looks, None where there is none.
        how: Constants.
    """
    if not any(every):
        return []
    misfits = np.array([each.misfit if each else np.inf for each in every])
    may_be = (misfits - misfits.min() < how.max_likelihood_ratio).astype(np.uint8)
    near = maximum_filter1d(may_be, 3, mode="nearest") > 0
    return [look for k in np.argsort(misfits).tolist() if near[k] and (look := every[k])]


def look_plainly(
    log: AxisLog,
    window_s: float,
    how: WeakForm = WEAK_FORM,
    terms: tuple[str, ...] = ("damping",),
) -> FirstLook | None:
    """A model of an axis by windows of any motion; None if they do not show it.

    Args:
        log: The axis.
        window_s: Length of the windows.
        how: Constants.
        terms: Terms next to gain, delay and level: damping, friction, camber.
    """
    return _look(log, replace(how, window_s=window_s), terms, rolling=False)


def look_at_rolling(
    log: AxisLog, how: WeakForm = WEAK_FORM, terms: tuple[str, ...] = ("friction", "camber")
) -> FirstLook | None:
    """Gain, delay, level and terms by windows of a ball that rolls in one direction.

    None if too few of them show these.

    Args:
        log: The axis.
        how: Constants.
        terms: Terms next to gain, delay and level: friction, camber.
    """
    return _look(log, how, terms, rolling=True)


def _look(
    log: AxisLog, how: WeakForm, terms: tuple[str, ...], *, rolling: bool
) -> FirstLook | None:
    """Gain, delay, level and terms of an axis; None if too few windows show them.

    Args:
        log: The axis.
        how: Constants.
        terms: Terms next to gain, delay and level: damping, friction, camber.
        rolling: Whether the ball rolls in one direction in all windows, or moves in any way.
    """
    grid = _Grid.of(log, how)
    if grid is None:
        return None
    free, speed, near = _find_free_windows(log, grid, how, rolling=rolling)
    rows = grid.thin(free)
    if len(rows) < 4 * how.min_windows or grid.noise_share(log, rows) > how.max_noise_share:
        return None
    columns = {
        "damping": (grid.ball, grid.slope),
        "friction": (-np.clip(speed / how.friction_speed_m_s, -1.0, 1.0), grid.weight),
        "camber": (grid.ball, grid.weight),
    }
    others = [np.full(len(rows), grid.weight.sum())]
    others += [grid.apply(*columns[term])[rows] for term in terms]
    found = _solve(log, grid, rows, np.stack(others, axis=-1), how)
    return _describe_solution(log, grid, found, near, how, ("level", *terms), plain=not rolling)


def look_at_rolling_in_several_ways(
    log: AxisLog, levers: Sequence[float], how: WeakForm = WEAK_FORM
) -> list[FirstLook]:
    """Looks at a ball that rolls in one direction by windows of several lengths, the usual first.

    Each with friction and camber, without camber, and with the levers that explain them. How far
    they differ is how far the model is in error.

    Args:
        log: The axis.
        levers: Those that are tried, rising, m.
        how: Constants.
    """
    found = []
    for window_s in (how.window_s, *how.rolling_windows_s):
        each_how = replace(how, window_s=window_s)
        plain = (look_at_rolling(log, each_how), look_at_rolling(log, each_how, ("friction",)))
        every = [look_at_rolling(replace(log, lever=each), each_how) for each in levers]
        found += [*filter(None, plain), *_keep_possible(every, each_how)]
    return found


@dataclass(frozen=True)
class _Grid:
    """Evenly spaced positions of an axis, and the test function.

    Attributes:
        step: s.
        half: Half a window in steps.
        time: s, shape (N,).
        ball: m, shape (N,).
        weight: Test function, shape (2 half + 1,).
        slope: Its derivative.
        bend: Its second derivative.
    """

    step: float
    half: int
    time: Array
    ball: Array
    weight: Array
    slope: Array
    bend: Array

    @classmethod
    def of(cls, log: AxisLog, how: WeakForm) -> _Grid | None:
        """The grid of a log; None if it is shorter than two windows, or nothing was tilted."""
        h, half = how.step_s, round(how.window_s / how.step_s / 2)
        time = np.arange(log.sampled[0], log.sampled[-1], h)
        if len(time) < 4 * half or not np.ptp(log.tilt):
            return None
        ball = np.interp(time, log.sampled, log.ball)
        return cls(h, half, time, ball, *_make_test_function(half, h))

    def thin(self, free: Mask) -> NDArray[np.intp]:
        """Indices of the middles of windows, four of which begin in half a window."""
        return np.flatnonzero(free)[:: max(1, self.half // 4)]

    def apply(self, values: Array, function: Array) -> Array:
        """Integrals of values on the grid times a function, by the middles of the windows."""
        return np.asarray(fftconvolve(values, function[::-1], "same"))

    def left(self, rows: NDArray[np.intp]) -> Array:
        """Left side of the equation in windows with these middles."""
        return self.apply(self.ball - self.ball.mean(), self.bend)[rows]

    def noise_share(self, log: AxisLog, rows: NDArray[np.intp]) -> float:
        """Variance of the left side by the noise of the samples, as a share."""
        noise = float(find_noise(log.ball))
        sample_step = float(np.median(np.diff(log.sampled)))
        variance = noise**2 * (self.bend @ self.bend) * max(sample_step / self.step, 1.0)
        return float(variance / max(float(np.var(self.left(rows))), 1e-30))


@dataclass(frozen=True)
class _Solution:
    """Least-squares solution of the equation of R windows.

    Attributes:
        rows: Indices of their middles on the grid, shape (R,).
        lag: The best lag, s.
        delay: The best dead time, s.
        values: Gain by swing of the tilt, and the other values.
        stds: Their standard deviations.
        kept: Windows that are no outliers, shape (R,).
        explained: Share of the variance of the left side.
        independent: Number of windows end to end.
        drift: By how much the delay grows with time, and its standard deviation.
        delay_std: Standard deviation of the delay, s.
    """

    rows: NDArray[np.intp]
    lag: float
    delay: float
    values: Array
    stds: Array
    kept: Mask
    explained: float
    independent: float
    drift: tuple[float, float]
    delay_std: float


def _solve(
    log: AxisLog, grid: _Grid, rows: NDArray[np.intp], others: Array, how: WeakForm
) -> _Solution | None:
    """Least squares over delays and lags, without outliers; None of too few windows.

    Args:
        log: The axis.
        grid: Its positions.
        rows: Middles of the windows, R of them.
        others: Columns of the equation next to the tilt's, shape (R, C).
        how: Constants.
    """
    h, tilt = grid.step, TiltHistory(log)
    left = grid.left(rows)
    # one step more at each end, for the slope by the delay
    first, last = (round(each / h) for each in how.delays_s)
    back = h * np.arange(last + 1, 0, -1)
    whole = np.concatenate((grid.time[0] - back, grid.time, grid.time[-1] + h * np.arange(1, 2)))
    pushed = {
        lag: grid.apply(tilt.at(whole, lag), grid.weight)[
            rows + last + 1 - np.arange(first - 1, last + 2)[:, None]
        ]
        for lag in how.lags_s
    }
    kept, columns, off = np.ones(len(rows), bool), others, left
    lag, k = 0.0, 0
    for _ in range(3):
        if kept.sum() < 4 * how.min_windows:
            return None
        lag, k = _find_delay(pushed, others, left, kept)
        columns = np.column_stack((pushed[lag][k], others))
        found = np.linalg.lstsq(columns[kept], left[kept], rcond=1e-9)[0]
        off = np.abs(columns @ found - left)
        kept = off < how.outlier_ratio * 1.4826 * float(np.median(off[kept]))
    # windows overlap: as many are independent as fit end to end
    independent = float(kept.sum() * max(1, grid.half // 4) / grid.half)
    scatter = float((off[kept] ** 2).mean())
    share = independent / kept.sum()
    stds = _deviations(columns[kept], scatter, share)
    turned = (pushed[lag][k + 1] - pushed[lag][k - 1]) / (2 * h)
    changes = log.clock_columns(grid.time[rows])
    wider = np.column_stack((columns, turned, turned[:, None] * changes))
    values = np.linalg.lstsq(wider[kept], left[kept], rcond=1e-9)[0]
    rest = float(((wider @ values - left)[kept] ** 2).mean())
    by_delay = _deviations(wider[kept], rest, share) / abs(float(found[0]))
    return _Solution(
        rows=rows,
        lag=lag,
        delay=(first - 1 + k) * h,
        values=found,
        stds=stds,
        kept=kept,
        explained=1 - scatter / max(float(np.var(left[kept])), 1e-30),
        independent=independent,
        drift=(float(values[-1] / found[0]), float(by_delay[-1])),
        delay_std=float(by_delay[columns.shape[1]]),
    )


def _find_delay(
    pushed: Mapping[float, Array], others: Array, left: Array, kept: Mask
) -> tuple[float, int]:
    """The lag and the index of the delay with the least residual.

    Args:
        pushed: Lag to the tilt's integrals at each delay, shape (K, R).
        others: The other columns, shape (R, C).
        left: Left side, shape (R,).
        kept: Windows that count, shape (R,).
    """
    basis = np.linalg.qr(others[kept])[0]
    target = left[kept] - basis @ (basis.T @ left[kept])
    gained = {}
    for lag, every in pushed.items():
        each = every[1:-1, kept]
        each = each - (each @ basis) @ basis.T
        size = np.maximum((each**2).sum(axis=1), 1e-30)
        gained[lag] = (each @ target) ** 2 / size
    lag = max(gained, key=lambda each: float(gained[each].max()))
    return lag, 1 + int(gained[lag].argmax())


def _deviations(columns: Array, scatter: float, share: float) -> Array:
    """Standard deviations of a solution; a share of the rows are independent of each other."""
    normal = columns.T @ columns * share
    return np.asarray(np.sqrt(scatter * np.diagonal(np.linalg.pinv(normal))))


def _describe_solution(
    log: AxisLog,
    grid: _Grid,
    found: _Solution | None,
    near: tuple[Mask, Mask],
    how: WeakForm,
    names: tuple[str, ...],
    *,
    plain: bool,
) -> FirstLook | None:
    """The look of a solution; None if it is none.

    Args:
        log: The axis.
        grid: Its positions.
        found: The solution.
        near: When the ball is near either end.
        how: Constants.
        names: Of the values behind the gain.
        plain: Whether the windows hold any motion.
    """
    if found is None:
        return None
    enough = found.independent >= how.min_windows
    explains = 1 - found.explained <= how.max_residual_share**2
    if not (enough and explains and abs(found.values[0]) > how.min_gain_stds * found.stds[0]):
        return None
    tilt = TiltHistory(log)
    value = dict(zip(names, found.values[1:].tolist(), strict=False))
    std = dict(zip(names, found.stds[1:].tolist(), strict=False))
    # an end stop holds the ball against the tilt; where it only turns, the tilt pushes it back
    push = found.values[0] * tilt.at(grid.time - found.delay, found.lag)
    push = push + value["level"] + value.get("camber", 0.0) * grid.ball
    rub = max(value.get("friction", 0.0), 0.0)
    held = (near[0] & (push < -rub)) | (near[1] & (push > rub))
    at_ends = 0.0 if plain else float(held.mean())
    return FirstLook(
        gain=float(found.values[0]) / tilt.scale,
        gain_std=float(found.stds[0]) / tilt.scale,
        delay=found.delay + found.lag,
        delay_std=max(found.delay_std, grid.step / 2),
        level=value["level"],
        level_std=std["level"],
        friction=rub,
        friction_std=std.get("friction", 0.0),
        camber=value.get("camber", 0.0),
        camber_std=std.get("camber", 0.0),
        damping=value.get("damping", 0.0),
        damping_std=std.get("damping", 0.0),
        windows=round(found.independent),
        plain=plain,
        explained=found.explained,
        at_ends=at_ends if at_ends > how.min_end_share else 0.0,
        drift=found.drift[0],
        drift_std=found.drift[1],
        terms=tuple(names[1:]),
    )


def _make_test_function(half: int, step: float) -> tuple[Array, Array, Array]:
    """The test function (1 - s^2)^3 and its two derivatives as weights of samples, (2 half + 1,).

    The sums of the second are right for a parabola to the last digit: zero for a straight line, and
    the sum of the first for t^2 / 2.
    """
    s = np.arange(-half, half + 1) / half
    weight = step * (1 - s**2) ** 3
    slope = -6 * s * (1 - s**2) ** 2 / half
    bend = step * 6 * (1 - s**2) * (5 * s**2 - 1)
    lines = np.linalg.qr(np.stack((np.ones_like(s), s), axis=-1))[0]
    bend = bend - lines @ (lines.T @ bend)
    parabola = (half * step * s) ** 2 / 2
    return weight, slope, bend * (weight.sum() / (bend @ parabola))


def _find_free_windows(
    log: AxisLog, grid: _Grid, how: WeakForm, *, rolling: bool
) -> tuple[Mask, Array, tuple[Mask, Mask]]:
    """Middles of windows without gap and end stop, the speed, and when the ball is at either end.

    Args:
        log: The axis.
        grid: Its positions.
        how: Constants.
        rolling: Whether the ball has to roll in one direction all the time.
    """
    time, ball, size = grid.time, grid.ball, 2 * grid.half + 1
    samples = max(5, round(how.speed_window_s / how.step_s) | 1)
    speed = savgol_filter(ball, samples, 2, deriv=1, delta=how.step_s)
    fastest, slowest = (each(speed, size) for each in (maximum_filter1d, minimum_filter1d))
    least = np.maximum(slowest, -fastest) if rolling else np.maximum(fastest, -slowest)
    rolls = least > how.min_speed_m_s
    if not rolling and how.max_slow_share < 1:
        slow = (np.abs(speed) < how.min_speed_m_s).astype(float)
        rolls = rolls & (uniform_filter1d(slow, size) < how.max_slow_share)
    low, high = np.percentile(ball, [0.5, 99.5])
    near = ball < low + how.end_margin_m, ball > high - how.end_margin_m
    stops = [each if each.mean() > how.min_end_share else np.zeros_like(each) for each in near]
    known = np.interp(time, log.sampled, log.touching) > 0
    touched = maximum_filter1d((stops[0] | stops[1] | known).astype(np.uint8), size) > 0
    step = float(np.median(np.diff(log.sampled)))
    gap = np.diff(log.sampled) > how.max_gap_steps * step
    last = np.clip(np.searchsorted(log.sampled, time, "right") - 1, 0, len(gap) - 1)
    missing = maximum_filter1d(gap[last].astype(np.uint8), size) > 0
    inside = np.zeros(len(time), bool)
    inside[grid.half : len(time) - grid.half] = True
    free = inside & rolls & ~touched & ~missing
    return free, speed, near
