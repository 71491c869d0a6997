"""How fast the ball goes in a log, and when it rests."""

from __future__ import annotations

import numpy as np
from scipy.signal import savgol_filter

from controllers.arrays import Array
from twin.identify.prepare import Segment, runs
from twin.identify.replay import PACE

REST, ROLL = 0.004, 0.008
"""Measured speeds in m/s below which the ball rests and above which it rolls."""
SPEED_SPAN = 0.3
"""Time in s over which the speed is measured, and shortest rest."""
CREPT = 6e-4
"""Way in m from the first to the last third of a rest from which on it is none: some times the
noise of these means."""
MEMORY = 200
"""Measured speeds before a replay that it is told of: of some seconds, as long as contacts age."""


def speed(time: Array, ball: Array) -> Array:
    """Speed of the ball by a local parabola through equally spaced samples, m/s, shape (K,)."""
    period = float(time[1] - time[0])
    samples = max(5, round(SPEED_SPAN / period) | 1)
    velocity = savgol_filter(ball, samples, 2, deriv=1, delta=period, axis=0)
    return np.hypot(velocity[:, 0], velocity[:, 1])


def rests(time: Array, ball: Array, moving: Array) -> list[tuple[float, float]]:
    """When the ball rests: first and last time of each, s.

    A ball that creeps, because what pushes it is hardly more than what holds it, does not rest:
    where it will be is decided by less than a log shows.

    Args:
        time: Equally spaced seconds, shape (K,).
        ball: m, shape (K, 2).
        moving: Speed of it, m/s, shape (K,).
    """
    found = []
    for a, b in runs(moving < REST):
        third = (b - a) // 3
        if time[b - 1] - time[a] > SPEED_SPAN:
            crept = ball[b - third : b].mean(axis=0) - ball[a : a + third].mean(axis=0)
            if np.hypot(*crept) < CREPT:
                found.append((float(time[a]), float(time[b - 1])))
    return found


def paces(segment: Segment, at: Array) -> Array:
    """Speeds of the ball before times in s, as ``Windows.paces`` has them, shape (W, K)."""
    time = segment.time
    moving = speed(time, segment.even_ball)
    still = moving.copy()
    for first, last in rests(time, segment.even_ball, moving):
        still[(time >= first) & (time <= last)] = 0.0
    return np.interp(at[:, None] - PACE * np.arange(MEMORY, 0, -1), time, still)
