"""Piecewise polynomials with four derivatives, and the smooth join of Appendix D.

References through points: a transition between two, a path through many.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import comb, factorial, perm
from typing import Any, ClassVar

import numpy as np
import scipy

from controllers.arrays import Array
from controllers.interfaces import Reference
from controllers.ranges import Positive

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
    before, after = np.array((start, end)) - at_rest(start[0])
    powers = _powers(_control_points(before, after, duration), duration)
    powers[-1] += start[0]
    return powers


def _control_points(start: Array, end: Array, duration: float) -> Array:
    """Coefficients in the Bernstein basis of the polynomial of ``join``, shape (10, n).

    Its q-th derivative at an end is 9!/(9 - q)! T^-q times the q-th difference of the control
    points there, which gives one after another.
    """
    n, T = DEGREE + 1, np.float64(duration)
    c = np.empty((n, start.shape[1]))
    for q in range(5):
        c[q] = start[q] / perm(DEGREE, q) * T**q
        for j in range(q):
            c[q] -= (-1) ** (j + q) * comb(q, j) * c[j]
    for q in range(5):
        c[-q - 1] = end[q] / perm(DEGREE, q) * (-1) ** q * T**q
        for j in range(q):
            c[-q - 1] -= (-1) ** (j + 1) * comb(q, j + 1) * c[-q + j]
    return c


def _powers(control: Array, duration: float) -> Array:
    """Coefficients of t^9 ... t^0 from those in the Bernstein basis, both of shape (10, n)."""
    T, c = np.array([duration]), np.zeros_like(control)
    for a, point in enumerate(control):
        factor = (-1) ** a * comb(DEGREE, a) * point
        for s in range(a, DEGREE + 1):
            c[DEGREE - s] += factor * (comb(DEGREE - a, s - a) * (-1) ** s) / T**s
    return c


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


class WithDerivatives:
    """A piecewise polynomial evaluated together with its first four derivatives.

    The first piece holds for all time before, the last ever after.

    Args:
        coefficients: Of each piece from the highest power to the constant, (powers, pieces, n).
        breaks: Where each piece counts its time from, and where the last ends, (pieces + 1,).
    """

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
        piece: Any
        if time.ndim:
            found = self._breaks.searchsorted(time, "right") - 1
            piece = np.minimum(np.maximum(found, 0), self._last)
        else:  # the same in plain numbers, several times faster
            piece = min(max(bisect_right(self._list, t) - 1, 0), self._last)
        powers = np.ones((*time.shape, self._rising.shape[1]))
        powers[..., 1:] = (time - self._breaks[piece])[..., None]
        terms = self._rising[piece] * np.multiply.accumulate(powers, axis=-1)[..., None, None]
        values: Array = np.add.reduce(terms, axis=-3)
        return np.moveaxis(values, -2, 0) if time.ndim else values


def in_turn(origins: Sequence[float], pieces: Sequence[Array]) -> WithDerivatives:
    """Polynomials one after another; the first holds for all time before, the last ever after.

    Args:
        origins: Where each piece counts its time from; it is left for the next at the next one's.
        pieces: Coefficients of each piece, highest power first, each of shape (10, n).
    """
    # Two that coincide may be in the wrong order by rounding.
    breaks = np.maximum.accumulate((*origins, origins[-1]))
    return WithDerivatives(np.stack(pieces, axis=1), breaks)


@dataclass(frozen=True, kw_only=True)
class Transition(Reference):
    """On a straight line from rest at one point to rest at another, in a given time.

    The polynomial of degree nine keeps the position smooth to the fourth derivative.

    Raises:
        ValueError: If a setting is not finite or the duration not positive.
    """

    name: ClassVar[str] = "transition"

    start: tuple[float, float] = (0.0, 0.0)
    """Position (x, y) up to ``time`` in m, plate axes."""
    end: tuple[float, float] = (0.15, 0.1)
    """Position (x, y) from ``time + duration`` on in m, plate axes."""
    time: float = 0.0
    """Time at which the ball sets off in s."""
    duration: Positive = 3.0
    """Time it takes in s."""

    _motion: WithDerivatives = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check the settings and join the two points."""
        super().__post_init__()
        before, after = at_rest(self.start), at_rest(self.end)
        pieces = (linear(before), join(before, after, self.duration), linear(after))
        motion = in_turn((self.time, self.time, self.time + self.duration), pieces)
        object.__setattr__(self, "_motion", motion)

    def __call__(self, t: float | Array) -> Array:
        """Position and four derivatives at t, shape (5, *shape(t), 2)."""
        return self._motion(t)


@dataclass(frozen=True, kw_only=True)
class Path(Reference):
    """A smooth curve through points, from rest to rest or round and round.

    The curve is the quintic spline over the length of the polygon through the points; the ball runs
    along it after a schedule that gathers speed, keeps it and, on an open path, sheds it again.
    Both, and so the path in time, are smooth to the fourth derivative.

    Raises:
        ValueError: If there are too few points, two in a row coincide, or a time does not fit.
    """

    name: ClassVar[str] = "path"

    points: tuple[tuple[float, float], ...] = ((0.0, 0.0), (0.15, 0.05), (0.1, -0.1), (-0.1, 0.0))
    """The points (x, y) in order in m, plate axes; two or more, three or more of a closed path."""
    duration: Positive = 8.0
    """Time in s from the first point to the last or, on a closed path, for a lap at full speed."""
    closed: bool = False
    """Whether the path returns to its first point and goes on for ever."""
    time: float = 0.0
    """Time at which the ball sets off in s; it waits at the first point until then."""
    ramp: Positive | None = None
    """Time in s to gather full speed, and to shed it; at most half the duration on an open path.
    Default: a quarter of the duration."""

    _curve: WithDerivatives = field(init=False, repr=False, compare=False)
    _schedule: WithDerivatives = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check the settings, lay the curve and make the schedule."""
        super().__post_init__()
        object.__setattr__(self, "_curve", _curve(np.array(self.points, float), self.closed))
        duration, time = self.duration, self.time
        ramp = duration / 4 if self.ramp is None else self.ramp
        if not self.closed and ramp > duration / 2:
            raise ValueError(f"ramp must be at most half the duration, {duration / 2}, got {ramp}")
        schedule = _schedule(time, duration, ramp, self.closed)
        object.__setattr__(self, "_schedule", schedule)

    def __call__(self, t: float | Array) -> Array:
        """Position and four derivatives at t, shape (5, *shape(t), 2)."""
        s, s1, s2, s3, s4 = self._schedule(t)
        p, p1, p2, p3, p4 = self._curve((s % 1.0 if self.closed else s)[..., 0])
        out = np.empty((5, *p.shape))
        out[0] = p
        # The chain rule, four times over.
        out[1] = p1 * s1
        out[2] = p2 * s1**2 + p1 * s2
        out[3] = p3 * s1**3 + 3 * p2 * s1 * s2 + p1 * s3
        out[4] = p4 * s1**4 + 6 * p3 * s1**2 * s2 + p2 * (3 * s2**2 + 4 * s1 * s3) + p1 * s4
        return out


def _curve(points: Array, closed: bool) -> WithDerivatives:
    """Quintic spline through the points over the share of the polygon's length, 0 to 1."""
    least = 3 if closed else 2
    if len(points) < least:
        kind = "a closed" if closed else "an open"
        raise ValueError(f"points must be {least} or more for {kind} path, got {len(points)}")
    if closed:
        points = np.vstack((points, points[:1]))
    sides = np.hypot(*np.diff(points, axis=0).T)
    if not sides.all():
        i = int(np.argmin(sides))
        raise ValueError(f"points must differ from one to the next, got {points[i].tolist()} twice")
    share = np.append(0.0, np.cumsum(sides)) / sides.sum()
    share[-1] = 1.0
    # An open curve ends straight: second and fourth derivative zero, so two points give a line.
    straight = [(2, np.zeros(2)), (4, np.zeros(2))]
    ends = "periodic" if closed else (straight, straight)
    interpolate = scipy.interpolate.make_interp_spline
    spline = interpolate(share, points, k=5, bc_type=ends)  # type: ignore[arg-type]
    # PPoly.from_spline would do for one axis alone.
    powers = [spline(share[:-1], nu=k) / factorial(k) for k in reversed(range(6))]
    return WithDerivatives(np.array(powers), share)


def _schedule(time: float, duration: float, ramp: float, closed: bool) -> WithDerivatives:
    """Share of the curve left behind over time, one column."""
    pace = 1 / duration if closed else 1 / (duration - ramp)
    # A ramp covers half of what full pace would.
    covered = pace * ramp / 2
    first, last, full = at_rest((0.0,)), at_rest((1.0,)), at_rest((covered,))
    full[1] = pace
    pieces = [linear(first), join(first, full, ramp), linear(full)]
    origins = [time, time, time + ramp]
    if not closed:
        full[0] = 1 - covered
        pieces += [join(full, last, ramp), linear(last)]
        origins += [time + duration - ramp, time + duration]
    return in_turn(origins, pieces)
