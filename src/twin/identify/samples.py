"""Properties of samples that they show by themselves: resolution, noise, runs of one state."""

from __future__ import annotations

import numpy as np

from controllers.arrays import Array, Mask


def resolution(measured: Array) -> float:
    """Smallest step between two different readings, 0 if there is none."""
    steps = np.diff(np.unique(measured))
    steps = steps[steps > 1e-9]
    return float(steps.min()) if len(steps) else 0.0


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
