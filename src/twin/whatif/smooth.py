"""The ball's path as a log shows it: smoothed, and put where it was when it was touched."""

from __future__ import annotations

import numpy as np

from controllers.arrays import Array
from twin.identify.log import Log

HALF = 0.08
"""Half of the time in s over which a parabola is fitted."""
FEWEST = 5
"""Touches that a parabola needs."""


def touches(log: Log, dead_time: float) -> tuple[Array, Array]:
    """When the ball was where, shapes (K,) in s and (K, 2) in m: one entry a new sample.

    Args:
        log: The log.
        dead_time: Time in s from a touch to its arrival.
    """
    shown = log.time - log.age - dead_time
    seen = log.touched & np.isfinite(log.ball).all(axis=1) & np.isfinite(shown)
    time, ball = shown[seen], log.ball[seen]
    # a sample that waits is one and the same, read again
    new = np.concatenate(([True], np.diff(time) > 1e-6)) if len(time) else np.zeros(0, bool)
    return time[new], ball[new]


def path(time: Array, samples: tuple[Array, Array]) -> tuple[Array, Array]:
    """Position in m and velocity in m/s at some times, each (M, 2); NaN where too little is known.

    Of a parabola through the samples about each time, by least squares.

    Args:
        time: In s, shape (M,).
        samples: Times in s, shape (K,), and positions in m, shape (K, 2).
    """
    known, ball = samples
    found = np.full((len(time), 2, 2), np.nan)
    first, last = np.searchsorted(known, time - HALF), np.searchsorted(known, time + HALF)
    for row, (now, begin, end) in enumerate(zip(time, first, last, strict=True)):
        if end - begin < FEWEST or known[begin] > now or known[end - 1] < now:
            continue
        s = (known[begin:end] - now) / HALF
        powers = np.stack((np.ones_like(s), s, s * s), axis=-1)
        fitted = np.linalg.solve(powers.T @ powers, powers.T @ ball[begin:end])
        found[row, 0], found[row, 1] = fitted[0], fitted[1] / HALF
    return found[:, 0], found[:, 1]
