"""What a ball is to do, some time ahead: a reference asked slice by slice, its jumps spread."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from controllers.arrays import Array
from controllers.interfaces import Reference

SLICE = 25
"""Control periods that are laid at once: few, so that none of them takes long."""
JUMP = 2e-3
"""Distance in m from one period to the next, beyond what the speed covers, that is a jump."""
LENGTH = 0.15
"""Length of a jump in m to which its time refers."""


class _Jump(NamedTuple):
    """A jump that is spread: when it comes in s, what it is in m, and over how long in s."""

    time: float
    way: Array
    duration: Array


class Preview:
    """Position, velocity and acceleration of a reference over a window that moves with time.

    A jump of the reference is taken in smoothly after it, over a time that grows with the root of
    its length; so is the way from where the ball is at the start.

    Args:
        reference: The path.
        start: Where the ball is at the start, m, shape (..., 2).
        period: Control period in s.
        horizon: How far the reference is asked ahead, s; 0 for not at all.
        spread: Time in s over which a jump of 0.15 m is spread; 0 leaves jumps as they are.
    """

    def __init__(
        self, reference: Reference, start: Array, period: float, horizon: float, spread: float
    ) -> None:
        self._reference, self._period, self._spread = reference, period, spread
        ahead = math.floor(horizon / period + 1e-9)
        self.count = min(SLICE, ahead + 1)
        """Ticks of a slice."""
        self.length = ahead + 1
        """Ticks of the window."""
        self._known = 0
        self._window = np.empty((3, 0, *start.shape))
        self._jumps: list[_Jump] = []
        self._last = np.stack((start, 0 * start))

    def advance(self) -> Array:
        """The window of the next slice: it begins with it and ends the horizon after its begin.

        Returns:
            Position, velocity, acceleration, in m and s, shape (3, K, ..., 2).
        """
        kept = self._window[:, self.count :]
        new = self._asked(self.length - kept.shape[1])
        self._window = np.concatenate((kept, new), axis=1)
        return self._window

    def _asked(self, count: int) -> Array:
        """Further samples of the reference, their jumps spread, shape (3, count, ..., 2)."""
        T, first = self._period, self._known
        times = (first + np.arange(count)) * T
        r = self._reference(times)[:3]
        rigs = self._window.shape[2:-1]
        r = r.reshape(3, count, *r.shape[2:-1] or [1] * len(rigs), 2)
        r = np.array(np.broadcast_to(r, (3, count, *rigs, 2)))
        self._known += count
        if not self._spread:
            return r
        position = np.concatenate((self._last[:1], r[0]))
        velocity = np.concatenate((self._last[1:], r[1]))
        self._last = np.stack((r[0, -1], r[1, -1]))
        way = np.diff(position, axis=0)
        if first:
            way -= T / 2 * (velocity[1:] + velocity[:-1])
        else:
            way[1:] -= T / 2 * (velocity[2:] + velocity[1:-1])
        for i in np.flatnonzero((np.abs(way) > JUMP).reshape(count, -1).any(axis=1)).tolist():
            length = np.hypot(way[i, ..., :1], way[i, ..., 1:])
            duration = np.maximum(self._spread * np.sqrt(length / LENGTH), T)
            self._jumps.append(_Jump(float(times[i]), way[i], duration))
        for jump in self._jumps:
            r += _left(times - jump.time, jump)
        ended = times[-1]
        self._jumps = [each for each in self._jumps if each.time + each.duration.max() > ended]
        return r


def _left(time: Array, jump: _Jump) -> Array:
    """What is left of a spread jump some time after it: 0 before, then from the whole to nothing.

    Args:
        time: Since the jump, s, shape (K,).
        jump: The jump.

    Returns:
        Position, velocity, acceleration, shape (3, K, ..., 2).
    """
    time = time.reshape(-1, *[1] * jump.way.ndim)
    t = np.minimum(np.maximum(time / jump.duration, 0.0), 1.0)
    share = np.stack(
        (
            1 - t**3 * (10 - 15 * t + 6 * t * t),
            -30 * t * t * (1 - t) ** 2 / jump.duration,
            -60 * t * (1 - t) * (1 - 2 * t) / jump.duration**2,
        )
    )
    left: Array = np.where(time >= 0, -share * jump.way, 0.0)
    return left
