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
    enough = np.flatnonzero(last - first >= FEWEST)
    about = known[first[enough]] <= time[enough], known[last[enough] - 1] >= time[enough]
    rows = enough[about[0] & about[1]]
    at = first[rows, None] + np.arange(np.max(last - first, initial=0))
    there = at < last[rows, None]
    at = np.minimum(at, len(known) - 1)
    s = np.where(there, (known[at] - time[rows, None]) / HALF, 0.0)
    powers = there[..., None] * s[..., None] ** np.arange(3)
    flipped = powers.swapaxes(1, 2)
    fitted = np.linalg.solve(flipped @ powers, flipped @ ball[at])
    found[rows, 0], found[rows, 1] = fitted[:, 0], fitted[:, 1] / HALF
    return found[:, 0], found[:, 1]
