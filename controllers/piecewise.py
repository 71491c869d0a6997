"""Piecewise polynomials that join motions smoothly (Appendix D), and references in closed form."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from math import comb, perm
from typing import Any, NamedTuple

import numpy as np

from controllers.arrays import Array

JOIN_DEGREE = 9
"""Degree of the joins: five conditions at either end."""


def join(start: Array, end: Array, duration: float) -> Array:
    """Polynomial of degree nine from the end of one motion to the start of the next, (D.2)-(D.4).

    Args:
        start: Value and four derivatives at t = 0, shape (5, n).
        end: Value and four derivatives at t = duration, shape (5, n).
        duration: Time in s, positive.

    Returns:
        Coefficients of t^9 ... t^0, shape (10, n).
    """
    # Counted from the start: the rounding of a constant would be in all coefficients.
    before, after = np.array((start, end)) - at_rest(start[0])
    powers = _powers(_control_points(before, after, duration), duration)
    powers[-1] += start[0]
    return powers


def _control_points(start: Array, end: Array, duration: float) -> Array:
    """Coefficients in the Bernstein basis of the polynomial of ``join``, shape (10, n).

    Its q-th derivative at an end is 9!/(9 - q)! T^-q times the q-th difference of the control
    points there, which gives the points in turn.
    """
    n, T = JOIN_DEGREE + 1, np.float64(duration)
    c = np.empty((n, start.shape[1]))
    for q in range(5):
        c[q] = start[q] / perm(JOIN_DEGREE, q) * T**q
        for j in range(q):
            c[q] -= (-1) ** (j + q) * comb(q, j) * c[j]
    for q in range(5):
        c[-q - 1] = end[q] / perm(JOIN_DEGREE, q) * (-1) ** q * T**q
        for j in range(q):
            c[-q - 1] -= (-1) ** (j + 1) * comb(q, j + 1) * c[-q + j]
    return c


def _powers(control: Array, duration: float) -> Array:
    """Coefficients of t^9 ... t^0 from those in the Bernstein basis, both of shape (10, n)."""
    T, c = np.array([duration]), np.zeros_like(control)
    for a, point in enumerate(control):
        factor = (-1) ** a * comb(JOIN_DEGREE, a) * point
        for s in range(a, JOIN_DEGREE + 1):
            c[JOIN_DEGREE - s] += factor * (comb(JOIN_DEGREE - a, s - a) * (-1) ** s) / T**s
    return c


def linear(start: Array) -> Array:
    """Coefficients as of ``join`` of a motion that keeps its velocity.

    Args:
        start: Value and at least one derivative at t = 0, shape (2 or more, n).
    """
    out = np.zeros((JOIN_DEGREE + 1, start.shape[1]))
    out[-1], out[-2] = start[:2]
    return out


def at_rest(place: Sequence[float] | Array) -> Array:
    """Value and four derivatives of a ball that stays where it is, shape (5, n)."""
    out = np.zeros((5, len(place)))
    out[0] = place
    return out


class WithDerivatives:
    """A piecewise polynomial evaluated together with its first four derivatives.

    The first piece holds for all time before, the last ever after.

    Args:
        coefficients: Of each piece from the highest power to the constant, (powers, pieces, n).
        breaks: Where each piece counts its time from, and where the last ends, (pieces + 1,).
    """

    BLOCK = 1024
    """Times that are worked out at once."""

    def __init__(self, coefficients: Array, breaks: Array) -> None:
        rising = coefficients[::-1]
        count, pieces, n = rising.shape
        self._breaks, self._list = breaks, breaks.tolist()
        self._last = pieces - 1
        self._rising = np.zeros((pieces, count, 5, n))
        """Coefficients of t^0, t^1 ... of value and derivatives."""
        for k in range(5):
            for power in range(k, count):
                self._rising[:, power - k, k] = perm(power, k) * rising[power]

    def __call__(self, t: float | Array) -> Array:
        """Value and four derivatives at t, shape (5, *shape(t), n)."""
        time = np.asarray(t, float)
        if time.size > self.BLOCK:  # what is multiplied needs ten times the room of the result
            flat, n = time.reshape(-1), self._rising.shape[-1]
            found = np.empty((time.size, 5, n))
            for first in range(0, time.size, self.BLOCK):
                block = slice(first, first + self.BLOCK)
                found[block] = np.moveaxis(self(flat[block]), 0, 1)
            return np.moveaxis(found.reshape(*time.shape, 5, n), -2, 0)
        piece: Any
        if time.ndim:
            places = self._breaks.searchsorted(time, "right") - 1
            piece = np.minimum(np.maximum(places, 0), self._last)
        else:  # the same in plain numbers, several times faster
            piece = min(max(bisect_right(self._list, t) - 1, 0), self._last)
        powers = np.ones((*time.shape, self._rising.shape[1]))
        powers[..., 1:] = (time - self._breaks[piece])[..., None]
        terms = self._rising[piece] * np.multiply.accumulate(powers, axis=-1)[..., None, None]
        values: Array = np.add.reduce(terms, axis=-3)
        return np.moveaxis(values, -2, 0) if time.ndim else values

    def form(self) -> ClosedForm:
        """The same as a closed form; of the first piece only what holds from its start on."""
        pieces = len(self._rising)
        return ClosedForm(self._breaks[:pieces], np.zeros((pieces, 2)), self._rising)


def in_turn(origins: Sequence[float], pieces: Sequence[Array]) -> WithDerivatives:
    """Polynomials in sequence; the first holds for all earlier times, the last for all later ones.

    Args:
        origins: Where each piece counts its time from; it is left for the next at the next one's.
        pieces: Coefficients of each piece, highest power first, each of shape (10, n).
    """
    # Two that coincide may be in the wrong order by rounding.
    breaks = np.maximum.accumulate((*origins, origins[-1]))
    return WithDerivatives(np.stack(pieces, axis=1), breaks)


class Harmonic(NamedTuple):
    """S sin(omega t) + C cos(omega t) from a time on.

    Attributes:
        since: Time in s from which it holds.
        omega: For x and y, rad/s, shape (2,).
        sine: S of position and four derivatives, shape (5, 2).
        cosine: C of them, shape (5, 2).
    """

    since: float
    omega: Array
    sine: Array
    cosine: Array


class ClosedForm(NamedTuple):
    """A reference as pieces of offset + exp(-decay s) sum of terms s^power, s = t - start >= 0.

    Attributes:
        starts: Time from which each piece holds, s, shape (pieces,); the first holds before, too.
        offsets: Offset of the position in m, shape (pieces, 2).
        terms: Of s^0, s^1, ... for position and four derivatives, shape (pieces, powers, 5, 2).
        decay: In 1/s; 0 for polynomials.
        harmonic: The motion that holds from its time on, in place of the pieces, if any.
    """

    starts: Array
    offsets: Array
    terms: Array
    decay: float = 0.0
    harmonic: Harmonic | None = None
