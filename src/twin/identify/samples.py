"""Properties of samples that they show by themselves: resolution, noise, runs of one state."""

from __future__ import annotations

import numpy as np

from controllers.arrays import Array, Mask


def resolution(measured: Array) -> float:
    """Smallest step between two different readings, 0 if there is none."""
    steps = np.diff(np.unique(measured))
    steps = steps[steps > 1e-9]
    return float(steps.min()) if len(steps) else 0.0


def are_copies(first: Array, second: Array) -> bool:
    """Whether two columns that change have the same number, or its negative, in every row.

    Args:
        first: Numbers, NaN where there is none, shape (K,).
        second: Of the other column, any shape.
    """
    known = np.isfinite(first)
    if len(first) != len(second) or (known != np.isfinite(second)).any() or not known.any():
        return False
    a, b = first[known], second[known]
    equal = np.allclose(a, b, rtol=1e-9, atol=0.0) or np.allclose(a, -b, rtol=1e-9, atol=0.0)
    return bool(np.ptp(a) > 0 and equal)


MAX_QUICK_SHARE = 0.1
"""Share of new readings that follow another in less than half the usual rows, at most, where a slow
sensor's are held over rows."""


def find_held(readings: Array) -> tuple[Mask, int]:
    """Rows that repeat the last reading of a sensor that is slower than the rows.

    Its readings change every n rows, hardly ever sooner, and mostly by more than its resolution: a
    slow ball repeats coarse readings, too, but a fast one does not. Of a ball at rest one row in n
    is a reading of its own.

    Args:
        readings: Successive ones, shape (K,) or (K, A).

    Returns:
        The repeating rows, shape (K,), none where the sensor is as fast as the rows; and n.
    """
    readings = readings.reshape(len(readings), -1)
    steps = np.abs(np.diff(readings, axis=0))
    new = np.concatenate(([0], np.flatnonzero(steps.any(axis=1)) + 1))
    lengths = np.diff(new, append=len(readings))
    held = np.zeros(len(readings), bool)
    if len(new) < 10:
        return held, 1
    period = int(np.median(lengths[:-1]))
    quick = float(np.mean(lengths[:-1] < max(2.0, period / 2)))
    grid = np.array([resolution(each) for each in readings.T])
    coarse = float(np.median((steps[new[1:] - 1] / np.maximum(grid, 1e-12)).max(axis=1))) < 1.5
    if period < 2 or quick > MAX_QUICK_SHARE or coarse:
        return held, 1
    since = np.arange(len(readings)) - np.repeat(new, lengths)
    # a late reading after an early one is no second one
    own = np.maximum(1, np.floor(np.repeat(lengths, lengths) / period + 0.4))
    return np.asarray((since % period != 0) | (since // period >= own)), period


def find_noise(samples: Array) -> Array:
    """Standard deviation of the noise of evenly spaced samples of a smooth motion.

    The second difference of white noise of standard deviation s has sqrt(6) s, and the median of
    the absolute value of a normal number is 0.6745 standard deviations. What the motion itself
    bends in two steps is taken to be less than the noise.

    Args:
        samples: Along the first axis, shape (K,) or (K, A).

    Returns:
        In the unit of the samples, shape () or (A,).
    """
    bend = np.diff(samples, n=2, axis=0)
    return np.asarray(np.median(np.abs(bend), axis=0) / (0.6745 * np.sqrt(6)))


def runs(mask: Mask) -> list[tuple[int, int]]:
    """First index and one past the last of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
