"""Stable inverse of a plant that first moves the wrong way, from an input known ahead."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from controllers.arrays import Array


class Tilts(NamedTuple):
    """Slope of the plate and its two time derivatives, all of one shape."""

    angle: Array
    rate: Array
    acceleration: Array


class TwoSided:
    """The bounded solution a of a - a'' / Z^2 = w for a w that is known some time ahead.

    The ball's x'' = k1 phi - c2 phi'' has a zero in the right half plane at Z = sqrt(k1 / c2), so
    that the slope for a wished x'' = k1 w has a pole there, whose bounded answer comes before its
    cause:

        a = (p + q) / 2,    p' = Z (w - p) forward in time,    q' = Z (q - w) backward.

    Between two samples w is a straight line; beyond the last one known it stays as it is.

    Args:
        Z: Zero of the plant in rad/s.
        period: Time from one sample to the next, s.
        count: Samples of a slice.
        length: Samples of a window.
    """

    def __init__(self, Z: float, period: float, count: int, length: int) -> None:
        self._Z, self._count = Z, count
        step = Z * period
        decay = math.exp(-step)
        # weights of the two ends of a straight line, the nearer one first
        self._far = (1 - decay) / step - decay
        self._near = 1 - decay - self._far
        self._decay = decay
        self._powers = decay ** np.arange(length + 1)
        self._p: Array | None = None

    def lay(self, w: Array) -> Tilts:
        """a, a' and a'' of a slice, each shape (count, ...), from a window that begins with it.

        Every sample makes use of the same time ahead, that of the slice's last one.

        Args:
            w: The window, shape (length, ...).
        """
        count, near, far = self._count, self._near, self._far
        powers = self._powers.reshape(-1, *[1] * (w.ndim - 1))
        reach = len(w) - count
        total = np.zeros_like(w)
        np.cumsum(powers[: len(w) - 1] * (near * w[:-1] + far * w[1:]), axis=0, out=total[1:])
        q = (total[reach:] - total[:count]) / powers[:count] + powers[reach] * w[reach:]
        begin = w[0] if self._p is None else self._p
        following = w[1 : count + 1]
        if reach == 0:
            following = np.concatenate((following, w[-1:]))
        ends = near * following + far * w[:count]
        grown = np.cumsum(ends / powers[1 : count + 1], axis=0)
        after = powers[1 : count + 1] * (begin + grown)
        p = np.concatenate((begin[None], after[:-1]))
        self._p = after[-1]
        a = (p + q) / 2
        return Tilts(a, self._Z * (q - p) / 2, self._Z**2 * (a - w[:count]))
