"""Laws, observers and references of N rigs that differ, put side by side as one each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array
from controllers.catalog import check_command, check_estimate, check_memory_rate
from controllers.interfaces import ControlLaw, Feedback, Measurement, Observer, Reference

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
        self.each = [(place_of(found), members[found[0]]) for found in rigs.values()]
        """Place of each group's rigs along the axis of the rigs, and their common member."""


def place_of(rigs: Sequence[int]) -> Place:
    """A slice for neighbours, which numpy takes without a copy; else their numbers."""
    first = rigs[0] if rigs else 0
    if list(rigs) == list(range(first, first + len(rigs))):
        return slice(first, first + len(rigs))
    return np.array(rigs)


class SampledReference(Reference):
    """A reference evaluated in advance in blocks of control periods; else it is the original.

    The blocks serve calls tick by tick; the future is evaluated with an array of times.

    Args:
        reference: The original.
        period: Control period in s.
    """

    BLOCK = 32

    def __init__(self, reference: Callable[[float | Array], Array], period: float) -> None:
        self.original = reference
        self._period = period
        self._first = 0
        self._block = np.zeros((0, 5, 2))

    def __call__(self, t: float | Array) -> Array:
        """Position and four derivatives, shape (5, *shape(t), 2)."""
        if not isinstance(t, float):
            return self.original(t)
        tick = round(t / self._period)
        if abs(tick * self._period - t) > 1e-9:
            return self.original(t)
        index = tick - self._first
        if not 0 <= index < len(self._block):
            self._first, index = tick, 0
            times = (tick + np.arange(self.BLOCK)) * self._period
            self._block = np.ascontiguousarray(self.original(times).swapaxes(0, 1))
        return self._block[index]


class PerRigReference(SampledReference):
    """The references of N rigs, each evaluated once however many rigs follow it.

    Args:
        members: One per rig; equal ones are evaluated once.
        period: Control period in s.
    """

    def __init__(self, members: Sequence[Reference], period: float) -> None:
        distinct = list(dict.fromkeys(members))
        which = np.array([distinct.index(member) for member in members])
        self.members = tuple(members)
        # with the rigs' axis before the last: (5, *shape(t), N, 2)
        super().__init__(
            lambda t: np.stack([each(t) for each in distinct], axis=-2).take(which, axis=-2), period
        )


class _PartOf(Reference):
    """Some rigs' part of a reference, at any time."""

    def __init__(self, whole: Reference, place: Place) -> None:
        self._whole, self._place = whole, place
        self.original = getattr(whole, "original", whole)

    def __call__(self, t: float | Array) -> Array:
        """Positions and four derivatives, shape (5, *shape(t), n, 2)."""
        return self._whole(t)[..., self._place, :]


def _part_of(measurement: Measurement | None, place: Place) -> Measurement | None:
    """Some rigs' part of a measurement."""
    if measurement is None:
        return None
    t, y, age, touched, state = measurement
    return Measurement(
        t, y[place], age[place], touched[place], None if state is None else state[place]
    )


class PerRigLaw:
    """Laws side by side as one; rigs that share a law are calculated together.

    Args:
        laws: One per rig.
    """

    name = "one law per rig"

    def __init__(self, laws: Sequence[ControlLaw]) -> None:
        self.groups = Groups(laws)
        self.model = laws[0].model
        self.memory = max(law.memory for law in laws)
        self.needs = tuple(dict.fromkeys(name for law in laws for name in law.needs))
        self.counts = tuple(dict.fromkeys(name for law in laws for name in law.counts))

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks of all laws, each once."""
        return tuple(dict.fromkeys(text for _, law in self.groups.each for text in law.remarks))

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations of the laws themselves, not held, rad/s^2, shape (N, 2)."""
        u = np.empty((len(x), 2))
        for own, law in self.groups.each:
            u[own] = law.control(t, x[own], _PartOf(reference, own), q[own, : law.memory])
        return u

    def start(self, x: Array, reference: Reference, period: float) -> list[Any]:
        """The plan of each group of rigs."""
        return [law.start(x[own], _PartOf(reference, own), period) for own, law in self.groups.each]

    def replanned(
        self, plan: list[Any], t: float, x: Array, reference: Reference, period: float
    ) -> list[Any]:
        """The plans from a time in s on."""
        return [
            law.replanned(each, t, x[own], _PartOf(reference, own), period)
            for (own, law), each in zip(self.groups.each, plan, strict=True)
        ]

    def command(self, now: Feedback) -> Array:
        """Plate accelerations in rad/s^2, shape (N, 2)."""
        u = np.empty((len(now.x), 2))
        known = (*self.needs, *self.counts)[: now.needed.shape[-1]]
        for (own, law), plan in zip(self.groups.each, now.plan, strict=True):
            mine = Feedback(
                now.time,
                now.x[own],
                now.equivalent[own],
                now.needed[own][:, [known.index(n) for n in law.needs + law.counts if n in known]],
                now.rate[own],
                now.requested[own],
                _PartOf(now.reference, own),
                now.memory[own, : law.memory],
                plan,
                _part_of(now.measurement, own),
            )
            u[own] = check_command(law, law.command(mine), mine.rate)
        return u

    def memory_rate(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Time derivative of the memory, shape (N, memory); 0 where a law has less of it."""
        slope = np.zeros_like(q)
        for own, law in self.groups.each:
            if law.memory:
                mine = q[own, : law.memory]
                part = _PartOf(reference, own)
                given = law.memory_rate(t, x[own], part, mine)
                slope[own, : law.memory] = check_memory_rate(law, given, mine)
        return slope


class PerRigObserver(Observer):
    """Observers side by side as one; rigs that share an observer are estimated together.

    Args:
        observers: One per rig; their estimates begin with ``start``.
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
            part = Measurement(
                measurement.time,
                measurement.y[own],
                measurement.age[own],
                measurement.touched[own],
                None if state is None else state[own],
            )
            x[own] = check_estimate(observer, observer.correct(part), part.y)
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
        """Quantities that the observers know beyond the state, shape (N, knows), or NaN."""
        found = np.full((len(self.x), len(self.knows)), np.nan)
        if not self.knows:
            return found
        for own, observer in self.groups.each:
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
