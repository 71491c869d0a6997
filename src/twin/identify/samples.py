"""Samples in a log: which rows bring a new one of the ball, how noisy and how fine they are."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import median_filter

from controllers.arrays import Array, Mask
from twin.identify.log import Log


def ball_samples(log: Log, period: float, notes: list[str]) -> tuple[Mask, Array]:
    """Rows that bring a usable ball sample, and the standard deviation of one in m, shape (2,).

    Args:
        log: K rows.
        period: Seconds between two of them.
        notes: Gets what had to be left out, in words.
    """
    usable = log.touched & np.isfinite(log.ball).all(axis=-1)
    if (log.touched & ~usable).any():
        missing = int((log.touched & ~usable).sum())
        notes.append(f"{missing} rows without ball position left out")
    fresh = usable & _new_position(log.age, log.ball, period)
    sigma = _noise(log.ball[fresh])
    spikes = np.zeros_like(fresh)
    spikes[fresh] = _spikes(log.ball[fresh], sigma)
    if spikes.any():
        notes.append(f"{int(spikes.sum())} ball positions far off their neighbours left out")
    return fresh & ~spikes, sigma


def _new_position(age: Array, ball: Array, period: float) -> Mask:
    """Rows that bring a new ball position, not one held from before."""
    if np.ptp(age) > period / 2:
        return np.concatenate(([True], np.diff(age) < period / 2))
    change = np.concatenate(([True], (np.diff(ball, axis=0) != 0).any(axis=-1)))
    at = np.flatnonzero(change)
    lengths = np.diff(at)
    lengths = lengths[lengths * period < 0.1]
    held = int(np.median(lengths)) if len(lengths) else 1
    if held <= 1:
        return np.ones_like(change)
    since = np.arange(len(ball)) - at[np.cumsum(change) - 1]
    return np.asarray(since % held == 0)


def _noise(ball: Array) -> Array:
    """Standard deviation of one sample, from how three in a row differ from a line."""
    bend = np.diff(ball, n=2, axis=0)
    spread = np.median(np.abs(bend), axis=0) / (0.6745 * np.sqrt(6))
    grid = np.array([resolution(ball[:, axis]) for axis in (0, 1)])
    return np.asarray(np.maximum(np.maximum(spread, grid / np.sqrt(12)), 1e-6))


def _spikes(ball: Array, sigma: Array) -> Mask:
    usual = median_filter(ball, size=(9, 1), mode="nearest")
    return np.asarray((np.abs(ball - usual) > np.maximum(8 * sigma, 0.003)).any(axis=-1))


def resolution(measured: Array) -> float:
    """Smallest step between two different readings, 0 if there is none."""
    steps = np.diff(np.unique(measured))
    steps = steps[steps > 1e-9]
    return float(steps.min()) if len(steps) else 0.0
