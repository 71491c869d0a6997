"""N rigs of one batch, each with a law, an observer and a reference of its own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array
from controllers.interfaces import Feedback, Law, Measurement, Observer, Reference
from controllers.probe import commanded, remembered
from controllers.stack import SampledReference

Member = TypeVar("Member")
Place = slice | NDArray[np.integer]


class Groups(Generic[Member]):
    """The rigs that share a member, group by group.

    Args:
        members: One per rig; one and the same object is shared.
    """

    def __init__(self, members: Sequence[Member]) -> None:
        rigs: dict[int, list[int]] = {}
        for rig, member in enumerate(members):
            rigs.setdefault(id(member), []).append(rig)
        self.each = [(_place(found), members[found[0]]) for found in rigs.values()]
        """Where the rigs of a group stand along the axis of the rigs, and what they share."""


def _place(rigs: Sequence[int]) -> Place:
    """A slice for neighbours, which numpy takes without a copy; else their numbers."""
    if rigs[-1] - rigs[0] == len(rigs) - 1:
        return slice(rigs[0], rigs[-1] + 1)
    return np.array(rigs)


class SideBySide(Reference):
    """M references as one, with the rigs' axis before the last: (5, *shape(t), M, 2).

    Args:
        members: The references.
    """

    def __init__(self, members: Sequence[Reference]) -> None:
        self._members = tuple(members)

    def __call__(self, t: float | Array) -> Array:
        """Positions and four derivatives of every reference."""
        return np.stack([member(t) for member in self._members], axis=-2)


class PerRigReference(SampledReference):
    """The references of N rigs, each evaluated once however many rigs follow it.

    Args:
        members: One per rig; equal ones are evaluated once.
        period: Control period in s.
    """

    def __init__(self, members: Sequence[Reference], period: float) -> None:
        distinct = list(dict.fromkeys(members))
        self.members = tuple(members)
        super().__init__(SideBySide(distinct), period)
        self._which = np.array([distinct.index(member) for member in members])
        self._now: tuple[float, Array] | None = None

    def __call__(self, t: float | Array) -> Array:
        """Positions and four derivatives, shape (5, *shape(t), N, 2)."""
        if isinstance(t, np.ndarray):
            return super().__call__(t).take(self._which, axis=-2)
        if self._now is None or self._now[0] != t:
            self._now = t, super().__call__(t).take(self._which, axis=-2)
        return self._now[1]


class _PartOf(Reference):
    """Some rigs' part of a reference, at any time."""

    def __init__(self, whole: Reference, place: Place) -> None:
        self._whole, self._place = whole, place

    def __call__(self, t: float | Array) -> Array:
        """Positions and four derivatives, shape (5, *shape(t), n, 2)."""
        part: Array = self._whole(t)[..., self._place, :]
        return part


class PerRigLaw(Law):
    """Laws side by side as one; rigs that share a law are calculated together.

    Args:
        laws: One per rig.
    """

    groups: Groups[Law]

    def __init__(self, laws: Sequence[Law]) -> None:
        object.__setattr__(self, "groups", Groups(laws))
        object.__setattr__(self, "memory", max(law.memory for law in laws))
        object.__setattr__(
            self, "needs", tuple(dict.fromkeys(n for law in laws for n in law.needs))
        )
        object.__setattr__(self, "model", laws[0].model)

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations in rad/s^2, shape (N, 2), for a reference of N rigs."""
        u = np.empty((len(x), 2))
        for own, law in self.groups.each:
            u[own] = law.control(t, x[own], _PartOf(reference, own), q[own, : law.memory])
        return u

    def start(self, x: Array, reference: Reference, period: float) -> list[Any]:
        """The plan of each group of rigs."""
        return [law.start(x[own], _PartOf(reference, own), period) for own, law in self.groups.each]

    def command(self, now: Feedback) -> Array:
        """Plate accelerations in rad/s^2, shape (N, 2)."""
        u = np.empty((len(now.x), 2))
        for (own, law), plan in zip(self.groups.each, now.plan, strict=True):
            mine = Feedback(
                now.time,
                now.x[own],
                now.equivalent[own],
                now.needed[own][:, [self.needs.index(name) for name in law.needs]],
                now.rate[own],
                now.requested[own],
                _PartOf(now.reference, own),
                now.memory[own, : law.memory],
                plan,
            )
            u[own] = commanded(law, law.command(mine), mine.rate)
        return u

    def memory_rate(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Time derivative of the memory, shape (N, memory); 0 where a law has less of it."""
        slope = np.zeros_like(q)
        for own, law in self.groups.each:
            if law.memory:
                mine = q[own, : law.memory]
                part = _PartOf(reference, own)
                given = law.memory_rate(t, x[own], part, mine)
                slope[own, : law.memory] = remembered(law, given, mine)
        return slope


class PerRigObserver(Observer):
    """Observers side by side as one; rigs that share an observer are estimated together.

    Args:
        observers: One per rig; their estimates start with ``start``.
    """

    def __init__(self, observers: Sequence[Observer]) -> None:
        self.groups = Groups(observers)
        self.model, self.period = observers[0].model, observers[0].period
        known = dict.fromkeys(quantity for each in observers for quantity in each.knows)
        self.knows = tuple(known)  # type: ignore[misc]

    def start(self, x: Array) -> None:
        """Begin at the states x, shape (N, 8)."""
        super().start(x)
        for own, observer in self.groups.each:
            observer.start(x[own])

    def correct(self, measurement: Measurement) -> Array:
        """Take in the measurements of N rigs and return their estimates, shape (N, 8)."""
        state = measurement.state
        x = np.empty((len(measurement.y), 8))
        for own, observer in self.groups.each:
            x[own] = observer.correct(
                Measurement(
                    measurement.time,
                    measurement.y[own],
                    measurement.age[own],
                    measurement.touched[own],
                    None if state is None else state[own],
                )
            )
        self.x = x
        return x

    def predict(self, u: Array) -> None:
        """Carry the estimates one period ahead under the applied inputs u, shape (N, 2)."""
        x = np.empty_like(self.x)
        for own, observer in self.groups.each:
            observer.predict(u[own])
            x[own] = observer.x
        self.x = x

    @property
    def further(self) -> Array:
        """What the observers know beyond the state; NaN where one does not, shape (N, knows)."""
        found = np.full((len(self.x), len(self.knows)), np.nan)
        for own, observer in self.groups.each if self.knows else ():
            for quantity, values in zip(
                observer.knows, np.moveaxis(observer.further, -1, 0), strict=True
            ):
                found[own, self.knows.index(quantity)] = values
        return found

    @property
    def equivalent(self) -> Array:
        """The estimates as ``Feedback.equivalent`` has them, shape (N, 8)."""
        if not self.knows:
            return self.x
        x = np.empty_like(self.x)
        for own, observer in self.groups.each:
            x[own] = observer.equivalent
        return x
