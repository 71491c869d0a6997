"""First look at an axis in a second: gain, delay and level by the weak form, without simulation.

With a test function w that is zero, with its slope, at both ends of a window of time T,

    int w'' x dt = gain int w u(t - d) dt + camber int w x dt + (level - friction sign(v)) int w dt,

is linear in gain, camber, level and friction at each delay d. The noise of the positions matters on
the left only, where they are differentiated; the tilt has none. Only windows are taken in which the
ball rolls in one direction and touches no end of its way, so that neither sticking nor an end stop
is part of the equation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d
from scipy.signal import fftconvolve, savgol_filter

from controllers.arrays import Array, Mask
from twin.base.page import digits
from twin.identify.command_model import TiltHistory
from twin.identify.logs import AxisLog


@dataclass(frozen=True, kw_only=True)
class WeakForm:
    """Constants of the first look.

    Attributes:
        step_s: Step of the grid on which integrals are computed.
        window_s: Length of a window.
        max_gap_steps: Longest time between two samples of a window, in median steps.
        speed_window_s: Time over which the speed is measured.
        min_speed_m_s: Speed above which the ball rolls, and its direction is known.
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
    """

    step_s: float = 0.005
    window_s: float = 0.4
    max_gap_steps: float = 4.0
    speed_window_s: float = 0.12
    min_speed_m_s: float = 0.02
    end_margin_m: float = 0.002
    min_end_share: float = 0.03
    delays_s: tuple[float, float] = (0.0, 0.5)
    lags_s: tuple[float, ...] = (0.0, 0.04, 0.08, 0.12)
    outlier_ratio: float = 4.0
    min_windows: int = 8
    min_gain_stds: float = 4.0
    max_residual_share: float = 0.7
    max_noise_share: float = 0.1


WEAK_FORM = WeakForm()


@dataclass(frozen=True)
class FirstLook:
    """Result of a first look at an axis.

    Attributes:
        gain: Acceleration of the ball by the tilt, in m/s^2 by its unit.
        gain_std: Its standard deviation.
        delay: Dead time and lag together, s.
        level: m/s^2.
        level_std: Its standard deviation.
        friction: m/s^2.
        camber: 1/s^2.
        windows: Number of windows in which the ball rolls freely.
        at_ends: Share of the time in which the ball is at an end stop.
    """

    gain: float
    gain_std: float
    delay: float
    level: float
    level_std: float
    friction: float
    camber: float
    windows: int
    at_ends: float

    def describe(self, axis: str, unit: str) -> str:
        """In a sentence.

        Args:
            axis: Its name.
            unit: Unit of the tilt.
        """
        ends = f"; {100 * self.at_ends:.0f} % at an end stop" if self.at_ends else ""
        return (
            f"first look, {axis}: gain {digits(self.gain)} +- {digits(2 * self.gain_std)} m/s^2 by "
            f"{unit}, dead time + lag {self.delay:.2f} s, level {digits(self.level)} +- "
            f"{digits(2 * self.level_std)} m/s^2, from {self.windows} windows of a ball that rolls "
            f"freely{ends}"
        )


def look_first(log: AxisLog, how: WeakForm = WEAK_FORM) -> FirstLook | None:
    """Gain, delay and level of an axis; None if too few windows show them.

    Args:
        log: The axis.
        how: Constants.
    """
    h, half = how.step_s, round(how.window_s / how.step_s / 2)
    time = np.arange(log.sampled[0], log.sampled[-1], h)
    if len(time) < 4 * half:
        return None
    weight, bend = _make_test_function(half, h)
    ball = np.interp(time, log.sampled, log.ball)
    free, direction, near = _find_free_windows(log, time, ball, half, how)
    rows = np.flatnonzero(free)[:: max(1, half // 4)]
    left = fftconvolve(ball - ball.mean(), bend, "same")[rows]
    if len(rows) < 4 * how.min_windows or _noise_share(log, left, bend, h) > how.max_noise_share:
        return None
    area = np.full(len(rows), weight.sum())
    bowed = fftconvolve(ball, weight, "same")[rows]
    both = np.stack((area, -area * direction[rows], bowed), axis=-1)
    tilt = TiltHistory(log)
    first, last = (round(each / h) for each in how.delays_s)
    whole = np.concatenate((time[0] - h * np.arange(last, 0, -1), time))
    pushed = {
        lag: fftconvolve(tilt.at(whole, lag), weight, "same")[
            rows + last - np.arange(first, last + 1)[:, None]
        ]
        for lag in how.lags_s
    }
    kept, found, off = np.ones(len(rows), bool), np.zeros(4), np.zeros(len(rows))
    delay, columns = 0.0, both
    for _ in range(3):
        if kept.sum() < 4 * how.min_windows:
            return None
        residuals = {}
        for lag, each in pushed.items():
            for k, push in enumerate(each):
                columns = np.column_stack((push, both))
                found = np.linalg.lstsq(columns[kept], left[kept], rcond=1e-9)[0]
                residuals[lag, k] = float(((columns @ found - left)[kept] ** 2).sum())
        lag, k = min(residuals, key=lambda each: residuals[each])
        delay, columns = lag + (first + k) * h, np.column_stack((pushed[lag][k], both))
        found = np.linalg.lstsq(columns[kept], left[kept], rcond=1e-9)[0]
        off = np.abs(columns @ found - left)
        kept = off < how.outlier_ratio * 1.4826 * float(np.median(off[kept]))
    # windows overlap: as many are independent as fit end to end
    independent = kept.sum() * max(1, half // 4) / half
    scatter = float((off[kept] ** 2).mean())
    # an end stop holds the ball against the tilt; where it only turns, the tilt pushes it back
    push = found[0] * tilt.at(time - delay + lag, lag) + found[1] + found[3] * ball
    rub = max(float(found[2]), 0.0)
    held = (near[0] & (push < -rub)) | (near[1] & (push > rub))
    at_ends = float(held.mean())
    normal = columns[kept].T @ columns[kept] * independent / kept.sum()
    std = np.sqrt(scatter * np.diagonal(np.linalg.pinv(normal)))
    explained = scatter <= how.max_residual_share**2 * np.var(left[kept])
    significant = abs(found[0]) > how.min_gain_stds * std[0]
    if independent < how.min_windows or not explained or not significant:
        return None
    return FirstLook(
        gain=float(found[0]) / tilt.scale,
        gain_std=float(std[0]) / tilt.scale,
        delay=delay,
        level=float(found[1]),
        level_std=float(std[1]),
        friction=rub,
        camber=float(found[3]),
        windows=round(independent),
        at_ends=at_ends if at_ends > how.min_end_share else 0.0,
    )


def _noise_share(log: AxisLog, left: Array, bend: Array, step: float) -> float:
    """Variance of the left side by the noise of the samples, as a share.

    Args:
        log: The axis.
        left: The left side in each window.
        bend: Its weights on the grid.
        step: Of the grid in s.
    """
    noise = np.median(np.abs(np.diff(log.ball, n=2))) / (0.6745 * np.sqrt(6))
    sample_step = float(np.median(np.diff(log.sampled)))
    variance = noise**2 * (bend @ bend) * max(sample_step / step, 1.0)
    return float(variance / max(float(np.var(left)), 1e-30))


def _make_test_function(half: int, step: float) -> tuple[Array, Array]:
    """The test function (1 - s^2)^3 and its second derivative as weights of samples, (2 half + 1,).

    The sums of the second are right for a parabola to the last digit: zero for a straight line, and
    the sum of the first for t^2 / 2.
    """
    s = np.arange(-half, half + 1) / half
    weight = step * (1 - s**2) ** 3
    bend = step * 6 * (1 - s**2) * (5 * s**2 - 1)
    lines = np.linalg.qr(np.stack((np.ones_like(s), s), axis=-1))[0]
    bend = bend - lines @ (lines.T @ bend)
    parabola = (half * step * s) ** 2 / 2
    return weight, bend * (weight.sum() / (bend @ parabola))


def _find_free_windows(
    log: AxisLog, time: Array, ball: Array, half: int, how: WeakForm
) -> tuple[Mask, Array, tuple[Mask, Mask]]:
    """Middles of windows of a freely rolling ball, its direction, and when it is at either end."""
    size = 2 * half + 1
    samples = max(5, round(how.speed_window_s / how.step_s) | 1)
    speed = savgol_filter(ball, samples, 2, deriv=1, delta=how.step_s)
    slowest = minimum_filter1d(speed, size), -maximum_filter1d(speed, size)
    rolls = np.maximum(*slowest) > how.min_speed_m_s
    low, high = np.percentile(ball, [0.5, 99.5])
    near = ball < low + how.end_margin_m, ball > high - how.end_margin_m
    stops = [each if each.mean() > how.min_end_share else np.zeros_like(each) for each in near]
    touched = maximum_filter1d((stops[0] | stops[1]).astype(np.uint8), size) > 0
    step = float(np.median(np.diff(log.sampled)))
    gap = np.diff(log.sampled) > how.max_gap_steps * step
    last = np.clip(np.searchsorted(log.sampled, time, "right") - 1, 0, len(gap) - 1)
    missing = maximum_filter1d(gap[last].astype(np.uint8), size) > 0
    inside = np.zeros(len(time), bool)
    inside[half : len(time) - half] = True
    free = inside & rolls & ~touched & ~missing
    return free, np.sign(speed), near
