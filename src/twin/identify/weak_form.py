"""The weak form of an axis: windows of a log, and least squares over delays and lags, in a second.

With a test function w that is zero, with its slope, at both ends of a window of time T,

    int w'' x dt = gain int w u(t - d) dt + camber int w x dt + (level - friction sign(v)) int w dt,

is linear in gain, camber, level and friction at each delay d. The noise of the positions matters on
the left only, where they are differentiated; the tilt has none. Either only windows are taken in
which the ball rolls in one direction and touches no end of its way, so that neither sticking nor an
end stop is part of the equation; or longer windows of any motion.

A clock that drifts makes the delay grow with time, which is one column more of the same equation,
as is an offset of the clock of each recording where several are joined.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d
from scipy.signal import fftconvolve, savgol_filter

from controllers.arrays import Array, Mask
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
        moving_slow_shares: Shares of a window of any motion in which a ball that is slower than the
            smallest speed may rest, and friction balance the tilt: largest ones of windows in which
            it hardly rests.
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


class Linkage(NamedTuple):
    """What changes a tilt before it moves the ball, next to dead time and lag.

    Attributes:
        lever: How far above the plate's axis the ball is as good as, m.
        play: Half the width of a gap between drive and plate, in swings of the tilt.
    """

    lever: float = 0.0
    play: float = 0.0


@dataclass(frozen=True, eq=False)
class GridTilt:
    """The tilt of an axis at evenly spaced times, behind lags and linkages.

    Attributes:
        history: The tilt without a lever.
        time: From the largest dead time before the first position to a step after the last, s,
            shape (T,).
    """

    history: TiltHistory
    time: Array
    _known: dict[tuple[float, float], tuple[Array, Array]] = field(default_factory=dict, repr=False)

    def behind(self, lag: float, play: float) -> tuple[Array, Array]:
        """The tilt in swings, and what a lever of 1 m adds to it, shape (T,) each.

        Args:
            lag: s.
            play: Half the width of the gap, in swings.
        """
        if (lag, play) not in self._known:
            tilt, with_lever = (
                self.history.at(self.time, lag, 0.0, play, 0.0, lever) for lever in (0.0, 1.0)
            )
            self._known[lag, play] = tilt, with_lever - tilt
        return self._known[lag, play]


@dataclass(frozen=True, eq=False)
class WeakGrid:
    """Evenly spaced positions of an axis, its tilt, and the test function of one length.

    Attributes:
        log: The axis.
        tilt: Its tilt, which grids of windows of other lengths share.
        how: Constants.
        half: Half a window in steps.
        time: s, shape (N,).
        ball: m, shape (N,).
        weight: Test function, shape (2 half + 1,).
        slope: Its derivative, shape (2 half + 1,).
        bend: Its second derivative, shape (2 half + 1,).
    """

    log: AxisLog
    tilt: GridTilt
    how: WeakForm
    half: int
    time: Array
    ball: Array
    weight: Array
    slope: Array
    bend: Array
    _pushed: dict[tuple[float, float], tuple[Array, Array]] = field(
        default_factory=dict, repr=False
    )
    _solved: dict[tuple[bytes, tuple[str, ...], Linkage], WeakSolution | None] = field(
        default_factory=dict, repr=False
    )

    @property
    def scale(self) -> float:
        """Swing of the tilt."""
        return self.tilt.history.scale

    @property
    def linkage(self) -> Linkage:
        """That of the log: without play, and without a lever if none is known."""
        return Linkage(self.log.lever or 0.0)

    @property
    def stride(self) -> int:
        """Steps between the middles of windows, four of which begin in half a window."""
        return max(1, self.half // 4)

    def apply(self, values: Array, function: Array) -> Array:
        """Integrals of values on the grid times a function, by the middles of the windows."""
        return np.asarray(fftconvolve(values, function[::-1], "same"))

    @cached_property
    def left(self) -> Array:
        """Left side of the equation by the middles of the windows, shape (N,)."""
        return self.apply(self.ball - self.ball.mean(), self.bend)

    def noise_share(self, rows: NDArray[np.intp]) -> float:
        """Variance of the left side by the noise of the samples in some windows, as a share."""
        noise = float(find_noise(self.log.ball))
        sample_step = float(np.median(np.diff(self.log.sampled)))
        variance = noise**2 * (self.bend @ self.bend) * max(sample_step / self.how.step_s, 1.0)
        return float(variance / max(float(np.var(self.left[rows])), 1e-30))

    def push(self, rows: NDArray[np.intp], lag: float, linkage: Linkage) -> Array:
        """Integrals of the tilt in swings at each delay, and a step less and more, (K + 2, R).

        Args:
            rows: Middles of R windows.
            lag: s.
            linkage: Lever and play.
        """
        first, last = (round(each / self.how.step_s) for each in self.how.delays_s)
        key = lag, linkage.play
        if key not in self._pushed:
            tilt, by_lever = (self.apply(each, self.weight) for each in self.tilt.behind(*key))
            self._pushed[key] = tilt, by_lever
        tilt, by_lever = self._pushed[key]
        delays = np.arange(first - 1, last + 2)[:, None]
        return np.asarray((tilt + linkage.lever * by_lever)[rows + last + 1 - delays])

    def delayed_tilt(self, delay: float, lag: float, linkage: Linkage) -> Array:
        """The tilt in swings on the grid behind a dead time of whole steps, shape (N,).

        Args:
            delay: s.
            lag: s.
            linkage: Lever and play.
        """
        tilt, by_lever = self.tilt.behind(lag, linkage.play)
        _, last = self.how.delays_s
        first = round((last - delay) / self.how.step_s) + 1
        return (tilt + linkage.lever * by_lever)[first : first + len(self.time)]


def make_grids(
    log: AxisLog, windows_s: Sequence[float], how: WeakForm = WEAK_FORM
) -> list[WeakGrid]:
    """Grids of a log for windows of several lengths, which share its tilt.

    Without those of which the log is shorter than two windows; none if nothing was tilted.

    Args:
        log: The axis.
        windows_s: Lengths of the windows.
        how: Constants.
    """
    h = how.step_s
    time = np.arange(log.sampled[0], log.sampled[-1], h)
    steps = np.arange(-round(how.delays_s[1] / h) - 1, len(time) + 1)
    tilt = GridTilt(TiltHistory(replace(log, lever=None)), log.sampled[0] + h * steps)
    ball = np.interp(time, log.sampled, log.ball)
    halves = [round(each / h / 2) for each in windows_s if np.ptp(log.tilt)]
    return [
        WeakGrid(log, tilt, how, half, time, ball, *_make_test_function(half, h))
        for half in halves
        if len(time) >= 4 * half
    ]


@dataclass(frozen=True, eq=False)
class WeakWindows:
    """Windows of one kind, R of them.

    Attributes:
        grid: Of which they are windows.
        rows: Indices of their middles on the grid, shape (R,).
        speed: Of the ball on the grid, m/s, shape (N,).
        near: When the ball is near the lower and the upper end of its way, shape (N,) each.
        rolling: Whether the ball rolls in one direction in all of them, or moves in any way.
    """

    grid: WeakGrid
    rows: NDArray[np.intp]
    speed: Array
    near: tuple[Mask, Mask]
    rolling: bool

    @classmethod
    def of(
        cls, grid: WeakGrid, *, rolling: bool, max_slow_share: float = 1.0
    ) -> WeakWindows | None:
        """The windows of a grid; None if they are too few, or noise is most of them.

        Args:
            grid: Of a log.
            rolling: Whether the ball has to roll in one direction all the time.
            max_slow_share: Share of a window of any motion above which the ball may rest there.
        """
        free, speed, near = _find_free_windows(grid, max_slow_share, rolling=rolling)
        rows = np.flatnonzero(free)[:: grid.stride]
        how = grid.how
        if len(rows) < 4 * how.min_windows or grid.noise_share(rows) > how.max_noise_share:
            return None
        return cls(grid, rows, speed, near, rolling)

    @property
    def sticks(self) -> bool:
        """Whether friction may hold the ball, and balance the tilt, in most of the windows."""
        how = self.grid.how
        slow = _find_slow_shares(self.grid, self.speed)[self.rows]
        return bool(np.median(slow) > how.moving_slow_shares[0])

    def solve(self, terms: tuple[str, ...], linkage: Linkage) -> WeakSolution | None:
        """Least squares over delays and lags, without outliers; None of too few windows.

        No friction is negative: where it would be, it is zero, and the others are those without it.

        Args:
            terms: Terms next to gain, delay and level: damping, friction, camber.
            linkage: Lever and play.
        """
        # windows of another kind may be the same ones
        known, key = self.grid._solved, (self.rows.tobytes(), terms, linkage)
        if key not in known:
            known[key] = self._solve_anew(terms, linkage)
        return known[key]

    @cached_property
    def _columns(self) -> dict[str, Array]:
        """Column of the equation by its term, shape (R,)."""
        grid = self.grid
        direction = np.clip(self.speed / grid.how.friction_speed_m_s, -1.0, 1.0)
        return {
            "level": np.full(len(self.rows), grid.weight.sum()),
            "damping": grid.apply(grid.ball, grid.slope)[self.rows],
            "friction": grid.apply(-direction, grid.weight)[self.rows],
            "camber": grid.apply(grid.ball, grid.weight)[self.rows],
        }

    def _solve_anew(self, terms: tuple[str, ...], linkage: Linkage) -> WeakSolution | None:
        """As ``solve``, computed."""
        others = np.stack([self._columns[term] for term in ("level", *terms)], axis=-1)
        found = _solve(self.grid, self.rows, others, linkage)
        if found is None or "friction" not in terms:
            return found
        k = 2 + terms.index("friction")
        if found.values[k] >= 0:
            return found
        without = self.solve(tuple(term for term in terms if term != "friction"), linkage)
        if without is None:
            return None
        values, stds = np.insert(without.values, k, 0.0), np.insert(without.stds, k, found.stds[k])
        return replace(without, values=values, stds=stds)


@dataclass(frozen=True, eq=False)
class WeakSolution:
    """Least-squares solution of the equation of R windows.

    Attributes:
        lag: The best lag, s.
        delay: The best dead time, s.
        values: Gain by swing of the tilt, m/s^2, level and terms in their order, shape (2 + T,).
        stds: Their standard deviations, shape (2 + T,).
        residuals: Of the equation in the windows, shape (R,).
        kept: Windows that are no outliers, shape (R,).
        explained: Share of the variance of the left side.
        independent: Number of windows end to end.
        drift: By how much the delay grows with time, and its standard deviation.
        delay_std: Standard deviation of the delay, s.
    """

    lag: float
    delay: float
    values: Array
    stds: Array
    residuals: Array
    kept: Mask
    explained: float
    independent: float
    drift: tuple[float, float]
    delay_std: float


def _solve(
    grid: WeakGrid, rows: NDArray[np.intp], others: Array, linkage: Linkage
) -> WeakSolution | None:
    """Least squares over delays and lags, without outliers; None of too few windows.

    Args:
        grid: Positions and tilt.
        rows: Middles of the windows, R of them.
        others: Columns of the equation next to the tilt's, shape (R, C).
        linkage: Lever and play.
    """
    how, left = grid.how, grid.left[rows]
    h = how.step_s
    # one step more at each end, for the slope by the delay
    every = {lag: grid.push(rows, lag, linkage) for lag in how.lags_s}
    pushed = {lag: (each, each[1:-1] ** 2) for lag, each in every.items()}
    kept, columns, off = np.ones(len(rows), bool), others, left
    lag, k = 0.0, 0
    for _ in range(3):
        if kept.sum() < 4 * how.min_windows:
            return None
        lag, k = _find_delay(pushed, others, left, kept)
        columns = np.column_stack((every[lag][k], others))
        found = np.linalg.lstsq(columns[kept], left[kept], rcond=1e-9)[0]
        off = columns @ found - left
        usual = 1.4826 * float(np.median(np.abs(off[kept])))
        kept = np.abs(off) < how.outlier_ratio * usual
    # windows overlap: as many are independent as fit end to end
    independent = float(kept.sum() * grid.stride / grid.half)
    scatter = float((off[kept] ** 2).mean())
    share = independent / kept.sum()
    stds = _deviations(columns[kept], scatter, share)
    turned = (every[lag][k + 1] - every[lag][k - 1]) / (2 * h)
    changes = grid.log.clock_columns(grid.time[rows])
    wider = np.column_stack((columns, turned, turned[:, None] * changes))
    values = np.linalg.lstsq(wider[kept], left[kept], rcond=1e-9)[0]
    rest = float(((wider @ values - left)[kept] ** 2).mean())
    by_delay = _deviations(wider[kept], rest, share) / abs(float(found[0]))
    return WeakSolution(
        lag=lag,
        delay=(round(how.delays_s[0] / h) - 1 + k) * h,
        values=found,
        stds=stds,
        residuals=off,
        kept=kept,
        explained=1 - scatter / max(float(np.var(left[kept])), 1e-30),
        independent=independent,
        drift=(float(values[-1] / found[0]), float(by_delay[-1])),
        delay_std=float(by_delay[columns.shape[1]]),
    )


def _find_delay(
    pushed: Mapping[float, tuple[Array, Array]], others: Array, left: Array, kept: Mask
) -> tuple[float, int]:
    """The lag and the index of the delay with the least residual.

    Args:
        pushed: Lag to the tilt's integrals at each delay and a step less and more, shape
            (K + 2, R), and their squares at each delay, shape (K, R).
        others: The other columns, shape (R, C).
        left: Left side, shape (R,).
        kept: Windows that count, shape (R,).
    """
    basis = np.linalg.qr(others[kept])[0]
    target = left[kept] - basis @ (basis.T @ left[kept])
    sides = np.zeros((len(kept), basis.shape[1] + 1))
    sides[kept] = np.column_stack((basis, target))
    gained = {}
    for lag, (every, squares) in pushed.items():
        product, size = every[1:-1] @ sides, squares @ kept
        # what is left of the tilt next to the other columns, by Pythagoras
        rest = size - (product[:, :-1] ** 2).sum(axis=1)
        gained[lag] = product[:, -1] ** 2 / np.maximum(rest, 1e-12 * size + 1e-30)
    lag = max(gained, key=lambda each: float(gained[each].max()))
    return lag, 1 + int(gained[lag].argmax())


def _deviations(columns: Array, scatter: float, share: float) -> Array:
    """Standard deviations of a solution; a share of the rows are independent of each other."""
    normal = columns.T @ columns * share
    return np.asarray(np.sqrt(scatter * np.diagonal(np.linalg.pinv(normal))))


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


def _find_slow_shares(grid: WeakGrid, speed: Array) -> Array:
    """Share of a window in which the ball may rest, by the middle of the window, shape (N,)."""
    slow = (np.abs(speed) < grid.how.min_speed_m_s).astype(float)
    return np.asarray(uniform_filter1d(slow, 2 * grid.half + 1))


def _find_free_windows(
    grid: WeakGrid, max_slow_share: float, *, rolling: bool
) -> tuple[Mask, Array, tuple[Mask, Mask]]:
    """Middles of windows without gap and end stop, the speed, and when the ball is at either end.

    Args:
        grid: Positions of the axis.
        max_slow_share: Share of a window of any motion above which the ball may rest there.
        rolling: Whether the ball has to roll in one direction all the time.
    """
    log, how = grid.log, grid.how
    time, ball, size = grid.time, grid.ball, 2 * grid.half + 1
    samples = max(5, round(how.speed_window_s / how.step_s) | 1)
    speed = savgol_filter(ball, samples, 2, deriv=1, delta=how.step_s)
    fastest, slowest = (each(speed, size) for each in (maximum_filter1d, minimum_filter1d))
    least = np.maximum(slowest, -fastest) if rolling else np.maximum(fastest, -slowest)
    rolls = least > how.min_speed_m_s
    if not rolling and max_slow_share < 1:
        rolls = rolls & (_find_slow_shares(grid, speed) < max_slow_share)
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
