"""The stable, two-sided inverse of a ball on a plate that first moves the wrong way."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from controllers.arrays import Array
from controllers.ballplate import BallPlate
from controllers.preview import Preview


def inverse(model: BallPlate, preview: Preview, period: float) -> TwoSided:
    """The inverse of a plant for the windows of a preview."""
    return TwoSided(math.sqrt(model.k1 / model.c2), period, preview.count, preview.length)


class Tilts(NamedTuple):
    """Slope of the plate and its two time derivatives, all of one shape."""

    angle: Array
    rate: Array
    acceleration: Array


class TwoSided:
    """The bounded solution a of a - a'' / Z^2 = w for a w that is known some time in advance.

    The ball's x'' = k1 phi - c2 phi'' has a zero in the right half plane at Z = sqrt(k1 / c2), so
    that the slope for a desired x'' = k1 w has a pole there; its bounded response precedes its
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
        self.Z, self._count, self._period = Z, count, period
        step = Z * period
        decay = math.exp(-step)
        # weights of the two ends of a straight line, the nearer one first
        far = (1 - decay) / step - decay
        near = 1 - decay - far
        self.weights = decay, near, far
        """Weights of p or q one sample before, and of the nearer and farther end of the line."""
        forward, backward = np.zeros((count + 1, count + 1)), np.zeros((count, length))
        reach = length - count
        behind = decay ** np.arange(reach + 1)
        for k in range(count):
            forward[k + 1] = decay * forward[k]
            forward[k + 1, k : k + 2] += far, near
            backward[k, k : k + reach] += near * behind[:-1]
            backward[k, k + 1 : k + reach + 1] += far * behind[:-1]
            backward[k, k + reach] += behind[-1]
        self._forward, self._backward = forward, backward
        self._begun = decay ** np.arange(count + 1)[:, None]
        self._p: Array | None = None
        self.jerk: Array = np.empty(0)
        """Third derivative of a in the slice planned last, shape (count, ...)."""

    def plan(self, w: Array) -> Tilts:
        """Return a, a' and a'' of a slice, each (count, ...), from a window that begins with it.

        Every sample uses the same preview time, the one of the slice's last sample.

        Args:
            w: The window, shape (length, ..., axes).
        """
        count = self._count
        # every rig by itself, so that it gets the same bits in any batch
        rows = w.swapaxes(0, -2)
        here = rows[..., : count + 1, :]
        if len(w) == count:
            here = np.concatenate((here, rows[..., -1:, :]), axis=-2)
        begin = here[..., :1, :] if self._p is None else self._p
        p = self._forward @ here + self._begun * begin
        q = self._backward @ rows
        self._p = p[..., count:, :]
        change = (here[..., 1:, :] - here[..., :count, :]) / self._period
        p, here = p[..., :count, :], here[..., :count, :]
        a = (p + q) / 2
        slopes = a, self.Z * (q - p) / 2, self.Z**2 * (a - here)
        self.jerk = (self.Z**2 * (slopes[1] - change)).swapaxes(-2, 0)
        return Tilts(*(each.swapaxes(-2, 0) for each in slopes))
