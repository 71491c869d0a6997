"""Smooth curves through points: cubic pieces with continuous second derivative."""

from __future__ import annotations

import numpy as np

from controllers.arrays import Array


def cubic(grid: Array, values: Array) -> Array:
    """Cubic pieces through points, whose first two and last two join as one ("not a knot").

    The slopes s at the points follow from a continuous second derivative. Between pieces of length
    h, whose chords have the slope d,

        h_i s_(i-1) + 2 (h_(i-1) + h_i) s_i + h_(i-1) s_(i+1) = 3 (h_i d_(i-1) + h_(i-1) d_i),

    and at both ends from a continuous third one (de Boor, A Practical Guide to Splines, chapter 4).
    ``scipy.interpolate`` gives the same, but takes longer to import than all else of a plant.

    Args:
        grid: Where, rising, shape (n,), n at least 4.
        values: The points, shape (n, ...).

    Returns:
        Coefficients of powers 0 to 3 counted from the lower end of each piece, (4, n - 1, ...).
    """
    n = len(grid)
    points = values.reshape(n, -1)
    h = np.diff(grid)
    d = np.diff(points, axis=0) / h[:, None]
    left, right = h[:-1, None], h[1:, None]
    system, wanted = np.zeros((n, n)), np.empty_like(points)
    inner = np.arange(1, n - 1)
    system[inner, inner - 1], system[inner, inner + 1] = h[1:], h[:-1]
    system[inner, inner] = 2 * (h[:-1] + h[1:])
    wanted[1:-1] = 3 * (right * d[:-1] + left * d[1:])
    for end, near in ((0, 1), (-1, -2)):
        a, b = h[end], h[near]
        system[end, end], system[end, near] = b, a + b
        wanted[end] = ((3 * a + 2 * b) * b * d[end] + a**2 * d[near]) / (a + b)
    s = np.linalg.solve(system, wanted)
    h = h[:, None]
    pieces = points[:-1], s[:-1], (3 * d - 2 * s[:-1] - s[1:]) / h, (s[:-1] + s[1:] - 2 * d) / h**2
    return np.array(pieces).reshape(4, n - 1, *values.shape[1:])
