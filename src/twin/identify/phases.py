"""Where in a log the ball rests and where it rolls, and the windows to replay that follow."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.signal import savgol_filter

from controllers.arrays import Array, Mask

REST, ROLL = 0.004, 0.008
"""Measured speeds in m/s below which the ball rests and above which it rolls."""
SPAN = 0.3
"""Time in s over which the speed is measured, and shortest rest."""


class Spans(NamedTuple):
    """Windows: when their samples begin, how long they last, and whether the ball rests first."""

    begin: Array
    length: Array
    resting: Mask


def speed(time: Array, ball: Array) -> Array:
    """Speed of the ball by a local parabola through equally spaced samples, m/s, shape (K,)."""
    period = float(time[1] - time[0])
    samples = max(5, round(SPAN / period) | 1)
    velocity = savgol_filter(ball, samples, 2, deriv=1, delta=period, axis=0)
    return np.hypot(velocity[:, 0], velocity[:, 1])


def intervals(mask: Mask) -> list[tuple[int, int]]:
    """First index and one past the last of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def spans(time: Array, ball: Array, begin: float, end: float, longest: float) -> Spans:
    """Windows one after another between two times, each begun at rest or in full roll.

    A window goes on until the ball has come to rest again or the longest time is up. Of a rest
    only the end is in a window: the rest of it says nothing.

    Args:
        time: Equally spaced seconds, shape (K,).
        ball: Position at these times in m, shape (K, 2).
        begin: Seconds.
        end: Seconds.
        longest: Longest window in s.
    """
    moving = speed(time, ball)
    rests = [
        (time[a], time[b - 1]) for a, b in intervals(moving < REST) if time[b - 1] - time[a] > SPAN
    ]
    found: list[tuple[float, float, bool]] = []
    at = begin
    while at < end - SPAN:
        rest = next(((a, b) for a, b in rests if a - 1e-9 <= at < b), None)
        if rest is None and moving[int(np.searchsorted(time, at))] <= ROLL:
            at += 0.02
            continue
        if rest is not None and rest[1] > end - SPAN:
            break
        first = at if rest is None else max(at, rest[1] - SPAN)
        after = first if rest is None else rest[1]
        stop = next((a for a, _ in rests if a > after), end)
        last = min(first + longest, stop + SPAN, end)
        if last - first > SPAN:
            found.append((first, last - first, rest is not None))
        at = last
    columns = np.array(found, dtype=float).reshape(-1, 3)
    return Spans(columns[:, 0], columns[:, 1], columns[:, 2] > 0)
