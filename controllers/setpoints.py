"""A reference that follows goals through a filter, and may be given further goals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from itertools import pairwise
from math import comb, factorial
from typing import Any, ClassVar

import numpy as np

from controllers.arrays import Array, Positive
from controllers.catalog import catalog
from controllers.interfaces import Reference
from controllers.piecewise import ClosedForm

FILTER_ORDER = 5
"""Order of the filter: position and four derivatives are continuous."""
MAX_TIMES_AT_ONCE = 10_000
"""Times that are worked out at once, so that many of them need no more memory."""


@dataclass(frozen=True, kw_only=True)
class Setpoints(Reference):
    """The desired position follows goals, each from its time on, through a filter.

    The filter has a pole of multiplicity five at -1/time_constant: the path is smooth to the fourth
    derivative and never leaves the convex hull of the goals. It starts at rest on the first goal.
    With ``before``, that is the path until the first goal is given; it then fades out with the step
    response of the same filter, so that the whole path stays as smooth.

    Raises:
        ValueError: If there is no goal, the times do not rise, or a number is not finite.
    """

    name: ClassVar[str] = "setpoints"
    lengths: ClassVar[tuple[str, ...]] = ("points",)

    points: tuple[tuple[float, float, float], ...] = ((0.0, 0.0, 0.0),)
    """The goals (time, x, y): seconds of the run, metres in plate axes."""
    time_constant: Positive = 0.2
    """Time constant of the filter in s: half of the way after 4.7, nine tenths after 8 of them."""
    before: dict[str, Any] | None = None
    """Reference until the time of the first goal, its kind and settings; none: the first goal."""

    _filter: _Filter = field(init=False, repr=False, compare=False)
    _faded: Reference | None = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check the settings and lead the filter along the goals."""
        super().__post_init__()
        if not self.points:
            raise ValueError("points must have at least one goal (time, x, y)")
        for (before, *_), (time, *_) in pairwise(self.points):
            if not time > before:
                raise ValueError(f"points must rise in time, got {before:g} and {time:g} s")
        points = tuple((float(time), float(x), float(y)) for time, x, y in self.points)
        laid = _Filter(1 / self.time_constant, points[0][0], points[0][1:])
        for time, *goal in points[1:]:
            laid = laid.then(time, goal)
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "_filter", laid)
        object.__setattr__(self, "_faded", _make_optional_reference(self.before))

    def then(self, time: float, x: float, y: float) -> Setpoints:
        """The same with one more goal, from a time in s after the last one on; x and y in m."""
        longer = copy(self)
        object.__setattr__(longer, "points", (*self.points, (time, x, y)))
        object.__setattr__(longer, "_filter", self._filter.then(time, (x, y)))
        return longer

    def closed_form(self) -> ClosedForm | None:
        """The closed form of the path; None if there is a path before it."""
        return self._filter.form() if self.before is None else None

    def __call__(self, t: float | Array) -> Array:
        """Position and four derivatives at t, shape (5, *shape(t), 2)."""
        t = np.asarray(t, dtype=float)
        goals = self._filter(t)
        if self._faded is None:
            return goals
        out = self._faded(t)
        first = self.points[0][0]
        late = t >= first
        if not late.any():
            return out
        share = self._filter.fading(np.maximum(t - first, 0.0))[..., None]
        difference = out - goals
        mixed = goals + np.stack(
            [
                sum(comb(n, k) * share[k] * difference[n - k] for k in range(n + 1))
                for n in range(FILTER_ORDER)
            ]
        )
        return np.where(late[..., None], mixed, out)


def _make_optional_reference(settings: Mapping[str, Any] | None) -> Reference | None:
    """The reference of a table with its kind and settings; None of None."""
    if settings is None:
        return None
    known = dict(catalog(Reference))  # type: ignore[type-abstract]
    kind = settings.get("kind")
    if kind not in known or kind == Setpoints.name:
        raise ValueError(f"before: no reference '{kind}' (known: {', '.join(known)})")
    try:
        made: Reference = known[kind](**{k: v for k, v in settings.items() if k != "kind"})
    except TypeError as error:
        raise ValueError(f"before: {error}") from error
    return made


class _Filter:
    """The filter's output between goals, in closed form: goal + exp(-a s) (b0 + ... + b4 s^4).

    Args:
        a: Amount of its poles, 1/s.
        time: Of the first goal, s.
        goal: The first goal, on which it is at rest, m.
    """

    def __init__(self, a: float, time: float, goal: Sequence[float]) -> None:
        self._a = a
        # coefficients of the derivative: (d/ds - a) of the polynomial
        self._derived = np.diag(np.arange(1.0, FILTER_ORDER), 1) - a * np.eye(FILTER_ORDER)
        self._count = 1
        self._times = [time]
        self._goals = [np.array(goal, float)]
        self._parts = [np.zeros((FILTER_ORDER, FILTER_ORDER, 2))]
        """Coefficients b of each goal and each derivative, both axes."""

    def then(self, time: float, goal: Sequence[float]) -> _Filter:
        """The filter with one more goal; what is behind is shared."""
        longer = copy(self)
        if len(self._times) > self._count:  # a different goal was already added here
            for name in ("_times", "_goals", "_parts"):
                setattr(longer, name, getattr(self, name)[: self._count])
        state = self(np.array(time))
        state[0] -= goal
        # b_n n! is the n-th derivative of the output times exp(a s), at s = 0
        first = np.array(
            [
                sum(comb(n, k) * self._a ** (n - k) * state[k] for k in range(n + 1)) / factorial(n)
                for n in range(FILTER_ORDER)
            ]
        )
        parts = [first]
        for _ in range(FILTER_ORDER - 1):
            parts.append(self._derived @ parts[-1])
        longer._times.append(time)
        longer._goals.append(np.array(goal, float))
        longer._parts.append(np.array(parts))
        longer._count = self._count + 1
        return longer

    def __call__(self, t: Array) -> Array:
        """Position and four derivatives at t, shape (5, *shape(t), 2)."""
        if t.ndim == 1 and len(t) > MAX_TIMES_AT_ONCE:
            blocks = np.array_split(t, len(t) // MAX_TIMES_AT_ONCE + 1)
            return np.concatenate([self(block) for block in blocks], axis=1)
        known, last = self._times[: self._count], self._count - 1
        if t.size and t.min() >= known[last]:  # as nearly always while it is driven
            index = np.zeros(t.shape, int)
            part = slice(last, self._count)
        else:
            index = np.maximum(np.searchsorted(known, t, side="right") - 1, 0)
            part = slice(0, self._count)
        times, goals, parts = (
            np.array(each[part])[index] for each in (known, self._goals, self._parts)
        )
        s = np.maximum(t - times, 0.0)
        out = np.moveaxis((parts * self._powers(s)[..., None, :, None]).sum(axis=-2), -2, 0)
        out = np.ascontiguousarray(out)
        out[0] += goals
        return out

    def form(self) -> ClosedForm:
        """The same as a closed form."""
        times, goals, parts = (
            np.array(each[: self._count]) for each in (self._times, self._goals, self._parts)
        )
        return ClosedForm(times, goals, parts.swapaxes(1, 2), self._a)

    def _powers(self, s: Array) -> Array:
        """exp(-a s) (1, s, ..., s^4), shape (*shape(s), 5)."""
        return np.exp(-self._a * s)[..., None] * s[..., None] ** np.arange(FILTER_ORDER)

    def fading(self, s: Array) -> Array:
        """Remainder of a step after a time s, and its four derivatives, shape (5, *shape(s))."""
        b = np.array([self._a**k / factorial(k) for k in range(FILTER_ORDER)])
        powers = self._powers(s)
        out = []
        for _ in range(FILTER_ORDER):
            out.append((powers * b).sum(axis=-1))
            b = self._derived @ b
        return np.array(out)
