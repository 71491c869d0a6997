"""Gravity as a rig sees it whose base does not stand level."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from controllers.arrays import Array


def tilted_gravity(level: ArrayLike, gravity: float) -> Array:
    """Gravity in the axes of a rig that stands tilted, m/s^2, shape (..., 3).

    Args:
        level: Tilt of the base about y and x, (phi, theta) in rad, shape (..., 2), with the signs
            of the plate's own angles: positive phi lowers the +x side, positive theta lifts +y.
        gravity: Its amount in m/s^2.
    """
    phi, theta = np.moveaxis(np.asarray(level, float), -1, 0)
    down = np.cos(theta)
    return np.stack(
        (
            gravity * np.sin(phi) * down,
            -gravity * np.sin(theta),
            -gravity * np.cos(phi) * down,
        ),
        axis=-1,
    )


def from_plate(vector: Array, phi: Array, theta: Array) -> Array:
    """A vector of plate axes in rig axes, R v with R = Rx(theta) Ry(phi), shape (..., 3)."""
    a, b, c = vector[..., 0], vector[..., 1], vector[..., 2]
    x = np.cos(phi) * a + np.sin(phi) * c
    z = np.cos(phi) * c - np.sin(phi) * a
    y = np.cos(theta) * b - np.sin(theta) * z
    return np.stack((x, y, np.sin(theta) * b + np.cos(theta) * z), axis=-1)
