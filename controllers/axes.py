"""The two axes of the flat model (6.44) as one: the same chain of integrators, of opposite sign."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from controllers.ballplate import BallPlate
from controllers.interfaces import Array

SIGN = np.array((1.0, -1.0))
"""Sense in which a positive plate angle accelerates the ball along x and along y, (6.45)."""


class Chain(NamedTuple):
    """Both axes of the flat model in Brunovsky form: y^(4) = a (u - tan(angle) rate^2) (6.48)."""

    z: Array
    """Position and three derivatives of each axis, shape (..., 2, 4)."""
    angle: Array
    """Plate angles (phi, theta) in rad, shape (..., 2)."""
    rate: Array
    """Plate rates in rad/s, shape (..., 2)."""
    a: Array
    """Input gain +-k1 cos(angle) in m/s^2, shape (..., 2)."""


def wished(r: Array) -> Array:
    """The position and k - 1 derivatives of a reference, (k, ..., 2), as a chain, (..., 2, k)."""
    return r.T if r.ndim == 2 else np.moveaxis(r, 0, -1)


def chain(model: BallPlate, x: Array) -> Chain:
    """Brunovsky form of the flat model at the state x, shape (..., 8)."""
    axes = x.reshape(*x.shape[:-1], 2, 4)
    angle, rate = axes[..., 2], axes[..., 3]
    k = model.k1 * SIGN
    a = k * np.cos(angle)
    z = axes.copy()
    z[..., 2] = k * np.sin(angle)
    z[..., 3] = a * rate
    return Chain(z, angle, rate, a)
