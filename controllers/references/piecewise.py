"""Piecewise polynomials with four derivatives, and the smooth join of Appendix D."""

from __future__ import annotations

from collections.abc import Sequence
from math import factorial, perm

import numpy as np

from controllers.arrays import Array

TERMS = 10
"""Coefficients of a polynomial of degree nine: five conditions at either end fix it."""
SLOPES = np.array([[perm(j, k) for j in range(TERMS)] for k in range(5)], dtype=float)
"""d^k(t^j)/dt^k = SLOPES[k, j] t^POWERS[k, j]."""
POWERS = np.array([[max(j - k, 0) for j in range(TERMS)] for k in range(5)])


def join(start: Array, end: Array, duration: float) -> Array:
    """Coefficients of the polynomial that takes one motion over into another, (D.2)-(D.4).

    Args:
        start: Value and four derivatives at t = 0, shape (5, n).
        end: Value and four derivatives at t = duration, shape (5, n).
        duration: Time in s, positive.

    Returns:
        Coefficients of t^0 ... t^9, shape (10, n).
    """
    scale = duration ** np.arange(TERMS)[:, None]
    coefficients = np.zeros((TERMS, start.shape[1]))
    for k in range(5):
        coefficients[k] = start[k] * scale[k] / factorial(k)
    rest = end * scale[:5] - SLOPES[:, :5] @ coefficients[:5]
    coefficients[5:] = np.linalg.solve(SLOPES[:, 5:], rest)
    return coefficients / scale


class Piecewise:
    """Polynomials one after another; the first holds for all time before, the last ever after.

    Args:
        origins: Where each piece counts its time from, m of them.
        pieces: Coefficients of t^0, t^1, ... of each piece, shape (m, up to 10, n); a piece is
            left for the next at the next one's origin.
    """

    def __init__(self, origins: Sequence[float], pieces: Array) -> None:
        self.origins = np.array(origins, dtype=float)
        self.pieces = pieces
        self._slopes = SLOPES[:, : pieces.shape[1]]
        self._powers = POWERS[:, : pieces.shape[1]]

    def __call__(self, t: float | Array) -> Array:
        """Value and four derivatives at t, shape (5, *shape(t), n)."""
        t = np.asarray(t, dtype=float)
        i = self.origins[1:].searchsorted(t, side="right")
        tau = t - self.origins[i]
        # One row of powers a derivative, times the coefficients of the piece t lies in.
        out = (self._slopes * tau[..., None, None] ** self._powers) @ self.pieces[i]
        return out if out.ndim == 2 else np.moveaxis(out, -2, 0)


def at_rest(place: Sequence[float] | Array) -> Array:
    """Value and four derivatives of a ball that stays where it is, shape (5, n)."""
    out = np.zeros((5, len(place)))
    out[0] = place
    return out


def still(place: Sequence[float] | Array) -> Array:
    """Coefficients of the constant polynomial, shape (10, n)."""
    out = np.zeros((TERMS, len(place)))
    out[0] = place
    return out
