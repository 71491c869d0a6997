"""A plain model of an axis with five numbers, fitted by scipy, as a rival of identify.

x'' = gain u(t - dead time) + level - damping x' - friction sign(x')

Each window is one prediction: its start is fitted to the first samples, and the five numbers to
the errors of what follows. So the fit minimises what the predictions are compared by. None of the
twin's code is used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from controllers.arrays import Array, Mask

LEAD_S, AHEAD_S = 0.4, 1.0
"""Time from which a prediction starts, and its length."""
LEAD_SAMPLES = 3.5
"""Smallest such time in steps between samples, where a camera is slow."""
STEP_S = 0.01
"""Step of the simulation."""
TOLERANCE_S = 0.06
"""Largest time between the end of a prediction and the sample that stands for it."""
DEAD_TIMES_S = (0.02, 0.06, 0.1, 0.15, 0.2, 0.3)
"""First guesses of the dead time."""
MAX_DEAD_TIME_S, MAX_FRICTION, MAX_DAMPING = 0.6, 2.0, 10.0
"""Largest values of the fit, in s, m/s^2 and 1/s."""
SMALL_ERROR_M = 0.003
"""Error below which the cost is quadratic; beyond it is linear."""
START_STEPS = np.array([1e-4, 1e-3])
"""Finite differences of a start: m and m/s."""
WINDOWS = 120
"""Largest number of windows of a fit."""


@dataclass(frozen=True)
class FiveNumbers:
    """The model.

    Attributes:
        gain: m/s^2 by the unit of the command.
        level: m/s^2.
        dead_time: s.
        friction: m/s^2.
        damping: 1/s.
    """

    gain: float
    level: float
    dead_time: float
    friction: float
    damping: float


@dataclass(frozen=True)
class _Windows:
    """W windows with up to B samples each.

    Attributes:
        begin: When each begins, s, shape (W,).
        lead_s: Time from which a prediction starts, s.
        since: Time of the samples since then, s, shape (W, B).
        ball: Positions, m, shape (W, B).
        there: Whether there is a sample, shape (W, B).
        grid: Times of the commands on an even grid, s, shape (N,).
        covered: Integral of the command up to each of them, shape (N,).
    """

    begin: Array
    lead_s: float
    since: Array
    ball: Array
    there: Mask
    grid: Array
    covered: Array

    @classmethod
    def of(cls, time: Array, command: Array, sampled: Array, ball: Array, at: Array) -> _Windows:
        """The windows of predictions that begin at some times in s."""
        lead_s = find_lead(sampled)
        begin = at - lead_s
        rows = [slice(*np.searchsorted(sampled, (b, b + lead_s + AHEAD_S + 0.05))) for b in begin]
        size = max([5, *(row.stop - row.start for row in rows)])
        since, places = np.zeros((2, len(begin), size))
        there = np.zeros((len(begin), size), bool)
        for w, row in enumerate(rows):
            n = row.stop - row.start
            since[w, :n], places[w, :n] = sampled[row] - begin[w], ball[row]
            there[w, :n] = True
        steps = np.append(time, max(time[-1], sampled[-1]) + 1.0)
        covered = np.concatenate(([0.0], np.cumsum(command * np.diff(steps))))
        return cls(begin, lead_s, since, places, there, steps, covered)

    @property
    def lead(self) -> Mask:
        """Samples before a prediction begins."""
        return self.there & (self.since < self.lead_s)

    def simulate(self, values: Array, starts: Array, length: float) -> Array:
        """Positions at the samples, shape (C, W, B).

        Args:
            values: The five numbers, shape (C, 5).
            starts: Position in m and velocity in m/s, shape (2, C, W).
            length: Length of the simulation in s.
        """
        gain, level, dead_time, friction, damping = values.T[..., None]
        steps = round(length / STEP_S)
        at = self.begin + STEP_S * np.arange(steps + 1)[:, None]
        sent = np.interp(at[:, None] - dead_time, self.grid, self.covered)
        push = gain * np.diff(sent, axis=0) + STEP_S * level
        x, v = starts
        places = np.empty((steps + 1, *x.shape))
        places[0], keep = x, np.exp(-damping * STEP_S)
        for n in range(steps):
            free = keep * v + push[n]
            after = np.sign(free) * np.maximum(np.abs(free) - STEP_S * friction, 0.0)
            x = x + STEP_S * (v + after) / 2
            v, places[n + 1] = after, x
        place = np.minimum(self.since / STEP_S, steps - 1e-6)
        low = place.astype(int)
        row = np.arange(len(self.begin))[:, None]
        first, second = (np.moveaxis(places[low + k, :, row], -1, 0) for k in (0, 1))
        return np.asarray(first + (place - low) * (second - first))

    def predict(self, values: Array) -> Array:
        """Errors of the predictions at all samples in m, shape (C, W, B).

        The start is that of least squares to the first samples, by Gauss and Newton.
        """
        lead = self.lead
        starts = np.zeros((2, len(values), len(self.begin)))
        starts[0] = (self.ball * lead).sum(axis=1) / np.maximum(lead.sum(axis=1), 1)
        for _ in range(3):
            batch = np.stack([starts, starts, starts], axis=1)
            batch[0, 1] += START_STEPS[0]
            batch[1, 2] += START_STEPS[1]
            many = np.tile(values, (3, 1))
            each = self.simulate(many, batch.reshape(2, -1, len(self.begin)), self.lead_s + STEP_S)
            own, *moved = each.reshape(3, len(values), *self.ball.shape)
            slopes = np.stack([(m - own) / s for m, s in zip(moved, START_STEPS, strict=True)], -1)
            slopes = slopes * lead[..., None]
            off = (own - self.ball) * lead
            normal = np.einsum("cwbi,cwbj->cwij", slopes, slopes) + 1e-6 * np.eye(2)
            score = np.einsum("cwbi,cwb->cwi", slopes, off)
            starts = starts - np.moveaxis(np.linalg.solve(normal, score[..., None])[..., 0], -1, 0)
        return self.simulate(values, starts, self.lead_s + AHEAD_S + 0.06) - self.ball


def find_lead(sampled: Array) -> float:
    """Time from which a prediction starts, s, for samples at these times in s."""
    return max(LEAD_S, LEAD_SAMPLES * float(np.median(np.diff(sampled))))


def _guess(windows: _Windows, dead_time: float) -> Array:
    """The five numbers at a dead time by one regression: without friction and damping."""
    zero = np.zeros((2, 1, len(windows.begin)))
    ways = [
        windows.simulate(np.array([each]), zero, windows.lead_s + AHEAD_S + 0.06)[0]
        for each in ((1.0, 0.0, dead_time, 0.0, 0.0), (0.0, 1.0, dead_time, 0.0, 0.0))
    ]
    normal = np.zeros((3, 3))
    for w, there in enumerate(windows.there):
        if there.sum() < 5:
            continue
        since = windows.since[w, there]
        start = np.linalg.qr(np.stack((np.ones_like(since), since), axis=-1))[0]
        free = np.stack((ways[0][w, there], ways[1][w, there], windows.ball[w, there]), axis=-1)
        free = free - start @ (start.T @ free)
        normal += free.T @ free
    gain, level = np.linalg.lstsq(normal[:2, :2], normal[:2, 2], rcond=1e-12)[0]
    return np.array([gain, level, dead_time, 0.01, 0.1])


def fit_five_numbers_by_scipy(
    time: Array, command: Array, sampled: Array, ball: Array
) -> FiveNumbers:
    """The model by robust least squares of predictions over 1 s, from several first guesses.

    Args:
        time: When each command begins, s, shape (K,).
        command: In any unit, shape (K,).
        sampled: When each position was measured, s, shape (M,).
        ball: m, shape (M,).
    """
    at = np.arange(sampled[0] + find_lead(sampled), sampled[-1] - AHEAD_S, 0.25)
    at = at[:: max(1, -(-len(at) // WINDOWS))]
    windows = _Windows.of(time, command, sampled, ball, at)
    counts = windows.there & ~windows.lead & (windows.lead.sum(axis=1) > 2)[:, None]
    scale = np.array([1.0 / max(float(np.std(command)), 1e-9), 1.0, 0.1, 0.1, 1.0])
    least = np.array([-np.inf, -np.inf, 0.0, 0.0, 0.0])
    most = np.array([np.inf, np.inf, MAX_DEAD_TIME_S, MAX_FRICTION, MAX_DAMPING])

    def off(values: Array) -> Array:
        errors = windows.predict(np.atleast_2d(values))[:, counts] / SMALL_ERROR_M
        return np.squeeze(np.clip(errors, -1e3, 1e3))

    def slopes(values: Array) -> Array:
        step = 1e-3 * scale
        moved = values + np.diag(np.where(values + step > most, -step, step))
        each = off(np.concatenate((values[None], moved)))
        return ((each[1:] - each[0]) / np.diagonal(moved - values)[:, None]).T

    guesses = np.array([_guess(windows, each) for each in DEAD_TIMES_S])
    rough = (np.sqrt(1 + off(guesses) ** 2) - 1).sum(axis=-1)
    found = [
        least_squares(
            off, guess, slopes, bounds=(least, most), x_scale=scale, loss="soft_l1", max_nfev=30
        )
        for guess in guesses[np.argsort(rough)[:2]]
    ]
    return FiveNumbers(*min(found, key=lambda each: float(each.cost)).x.tolist())


def predict_five_numbers(
    model: FiveNumbers, time: Array, command: Array, sampled: Array, ball: Array, begin: Array
) -> Array:
    """Errors of its predictions after 1 s in m, from some times in s on; NaN without a sample."""
    windows = _Windows.of(time, command, sampled, ball, begin)
    values = np.array([[model.gain, model.level, model.dead_time, model.friction, model.damping]])
    off = np.where(windows.there, np.abs(windows.since - windows.lead_s - AHEAD_S), np.inf)
    last = off.argmin(axis=1)[:, None]
    errors = np.take_along_axis(windows.predict(values)[0], last, axis=1)[:, 0]
    near = np.take_along_axis(off, last, axis=1)[:, 0] <= TOLERANCE_S
    return np.where(near & (windows.lead.sum(axis=1) > 2), errors, np.nan)
