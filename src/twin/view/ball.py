"""A ball that is seen to roll: its colours, and how it lies after a way over the screen."""

from __future__ import annotations

import numpy as np
import rerun as rr

from controllers.arrays import Array


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


def marked_ball(radius: float, upright: float) -> rr.Mesh3D:
    """A ball in two colours with a dark cap, so that one sees it roll; half axes in m."""
    rings, sectors = 24, 32
    lat, lon = np.meshgrid(
        np.linspace(0, np.pi, rings + 1), np.linspace(0, 2 * np.pi, sectors + 1), indexing="ij"
    )
    unit = np.stack((np.sin(lat) * np.cos(lon), np.sin(lat) * np.sin(lon), np.cos(lat)), axis=-1)
    corner = np.arange(rings * (sectors + 1)).reshape(rings, sectors + 1)[:, :-1].ravel()
    below = corner + sectors + 1
    quads = np.concatenate(
        (np.stack((corner, below, below + 1), 1), np.stack((corner, below + 1, corner + 1), 1))
    )
    points = unit.reshape(-1, 3)
    # triangles share no corners, so that the colours meet in a sharp line
    flat = points[quads].reshape(-1, 3)
    middle = np.repeat(points[quads].mean(axis=1), 3, axis=0)
    white, orange, dark = [248, 246, 238], [238, 120, 20], [25, 25, 25]
    odd = (middle[:, 0] * middle[:, 1] * middle[:, 2] > 0)[:, None]
    colours = np.where(odd, orange, white)
    colours = np.where((np.abs(middle) > 0.93).any(axis=1)[:, None], dark, colours)
    return rr.Mesh3D(
        vertex_positions=flat * [radius, radius, upright],
        vertex_normals=flat,
        vertex_colors=colours.astype(np.uint8),
    )
