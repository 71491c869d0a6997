"""Turns in space as quaternions (x, y, z, w), many at once."""

from __future__ import annotations

import numpy as np

from controllers.arrays import Array


def about(axis: Array, angle: Array) -> Array:
    """Quaternions xyzw of turns by angles (K,) in rad about a unit axis (3,), shape (K, 4)."""
    half = angle[:, None] / 2
    return np.concatenate((np.sin(half) * axis, np.cos(half)), axis=1)


def rotate(quaternion: Array, vector: Array) -> Array:
    """Vectors (K, 3) turned by quaternions xyzw (K, 4)."""
    u, w = quaternion[:, :3], quaternion[:, 3:]
    cross = 2 * np.cross(u, vector)
    turned: Array = vector + w * cross + np.cross(u, cross)
    return turned


def to_rig(vector: Array, phi: Array, theta: Array) -> Array:
    """Plate axes to rig axes, R = Rx(theta) Ry(phi) (4.5), shape (K, 3)."""
    tilted = rotate(about(np.array([0.0, 1.0, 0.0]), phi), vector)
    return rotate(about(np.array([1.0, 0.0, 0.0]), theta), tilted)


def rolled(turn: Array, position: Array, radius: float) -> Array:
    """How a ball lies that rolls without slip along positions (K, 2), quaternions (K, 4).

    A way d along the screen turns it by |d| / radius about the axis (-d_y, d_x, 0), in plate axes.
    The first entry is ``turn``, the way it lay at the first position. Spin about the normal is not
    seen in positions and so left out.
    """
    steps = np.diff(position, axis=0)
    way = np.hypot(steps[:, 0], steps[:, 1])
    safe = np.where(way > 0, way, 1.0)[:, None]
    axis = np.stack((-steps[:, 1], steps[:, 0], np.zeros(len(way))), axis=1) / safe
    half = way[:, None] / radius / 2
    each = np.concatenate((np.sin(half) * axis, np.cos(half)), axis=1)
    out = np.empty((len(position), 4))
    out[0] = x, y, z, w = turn
    for k, (a, b, c, d) in enumerate(each.tolist(), start=1):
        x, y, z, w = (
            d * x + a * w + b * z - c * y,
            d * y - a * z + b * w + c * x,
            d * z + a * y - b * x + c * w,
            d * w - a * x - b * y - c * z,
        )
        out[k] = x, y, z, w
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    return out
