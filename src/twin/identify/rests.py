"""When the ball of a log rests, and for how long it has."""

from __future__ import annotations

import numpy as np
from scipy.signal import savgol_filter

from controllers.arrays import Array
from twin.identify.prepare import Segment, runs

REST, ROLL = 0.004, 0.008
"""Measured speeds in m/s below which the ball rests and above which it rolls."""
SPEED_SPAN = 0.3
"""Time in s over which the speed is measured, and shortest rest."""


def speed(time: Array, ball: Array) -> Array:
    """Speed of the ball by a local parabola through equally spaced samples, m/s, shape (K,)."""
    period = float(time[1] - time[0])
    samples = max(5, round(SPEED_SPAN / period) | 1)
    velocity = savgol_filter(ball, samples, 2, deriv=1, delta=period, axis=0)
    return np.hypot(velocity[:, 0], velocity[:, 1])


def rests_of(time: Array, moving: Array) -> list[tuple[float, float]]:
    """When the ball rests, from its speed in m/s: first and last time of each, s."""
    found = [(float(time[a]), float(time[b - 1])) for a, b in runs(moving < REST)]
    return [(first, last) for first, last in found if last - first > SPEED_SPAN]


def rested(segment: Segment, at: Array) -> Array:
    """For how long the ball has rested at times in s, as ``Windows.rested`` has it, shape (W,)."""
    time = segment.time
    rests = rests_of(time, speed(time, segment.even_ball))
    # before all of them it is at rest from nothing until nothing
    begin, end = np.array([(-np.inf, -np.inf), *rests]).T
    last = np.searchsorted(begin, at, side="right") - 1
    since = np.where(begin[last] > time[0], begin[last], -np.inf)
    return np.where(at < end[last], at - since, 0.0)
