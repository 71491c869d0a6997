"""Piecewise polynomials with four derivatives, and the smooth join of Appendix D."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy

from controllers.arrays import Array

DEGREE = 9
"""Degree of the joins: five conditions at either end."""


def join(start: Array, end: Array, duration: float) -> Array:
    """Polynomial of degree nine that takes one motion over into another, (D.2)-(D.4).

    Args:
        start: Value and four derivatives at t = 0, shape (5, n).
        end: Value and four derivatives at t = duration, shape (5, n).
        duration: Time in s, positive.

    Returns:
        Coefficients of t^9 ... t^0, shape (10, n).
    """
    # Counted from the start: the rounding of a constant would be in all coefficients.
    ends = np.array((start, end)) - at_rest(start[0])
    bernstein = scipy.interpolate.BPoly.from_derivatives(np.array((0.0, duration)), ends)
    powers = scipy.interpolate.PPoly.from_bernstein_basis(bernstein).c[:, 0]
    powers[-1] += start[0]
    return powers


def linear(start: Array) -> Array:
    """Coefficients as of ``join`` of a motion that keeps its velocity.

    Args:
        start: Value and at least one derivative at t = 0, shape (2 or more, n).
    """
    out = np.zeros((DEGREE + 1, start.shape[1]))
    out[-1], out[-2] = start[:2]
    return out


def at_rest(place: Sequence[float] | Array) -> Array:
    """Value and four derivatives of a ball that stays where it is, shape (5, n)."""
    out = np.zeros((5, len(place)))
    out[0] = place
    return out


def in_turn(origins: Sequence[float], pieces: Sequence[Array]) -> scipy.interpolate.PPoly:
    """Polynomials one after another; the first holds for all time before, the last ever after.

    Args:
        origins: Where each piece counts its time from; it is left for the next at the next one's.
        pieces: Coefficients of each piece, highest power first, each of shape (10, n).
    """
    # Two that coincide may be in the wrong order by rounding.
    x = np.maximum.accumulate((*origins, origins[-1]))
    return scipy.interpolate.PPoly(np.stack(pieces, axis=1), x)


class WithDerivatives:
    """A piecewise polynomial evaluated together with its first four derivatives.

    Args:
        polynomial: Of values of shape (n,).
    """

    def __init__(self, polynomial: scipy.interpolate.PPoly) -> None:
        c = np.zeros((*polynomial.c.shape[:2], 5, polynomial.c.shape[2]))
        for k in range(5):
            derived = polynomial.derivative(k).c
            c[-len(derived) :, :, k] = derived
        self._all = scipy.interpolate.PPoly(c, polynomial.x)

    def __call__(self, t: float | Array) -> Array:
        """Value and four derivatives at t, shape (5, *shape(t), n)."""
        return np.moveaxis(self._all(t), -2, 0)
