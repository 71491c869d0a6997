"""Law, observer and reference joined into one controller, for one rig and for N of them.

With the parts between them: a law's hold, and the Smith predictor (7.19) around any observer.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array, NotNegative, constant, some
from controllers.catalog import check_command, check_estimate, check_memory_rate
from controllers.interfaces import (
    ControlLaw,
    DelayedObserver,
    Feedback,
    Law,
    Measurement,
    Observer,
    Reference,
)


class HeldCommand:
    """The command that is held in one run, and the one that is being computed.

    Args:
        plan: The law's own plan.
        period: Control period of the rig, s.
        ticks: Control periods of the rig in one of the law's.
        u: Plate accelerations in rad/s^2 until there is a command, shape (..., 2).
    """

    def __init__(self, plan: Any, period: float, ticks: int, u: Array) -> None:
        self.plan = plan
        self.u = u
        """Plate accelerations in rad/s^2, shape (..., 2)."""
        self.before = 0.0
        """Computing time of the observer for the command that is due, s, if that is measured."""
        self.timing: tuple[float, float] = (math.nan, 0.0)
        """Computing time in s of the command that this period began, NaN if it began none, and the
        time in s by which the present command is older than its period explains."""
        self._period, self._ticks = period, ticks
        self._number = -1
        self._free = 0
        self._coming: tuple[int, int, Array] | None = None
        self._since: int | None = None

    def due(self, t: float) -> bool:
        """Whether a time in s is the first one of a period of the law."""
        number = math.floor(t / (self._ticks * self._period) + 1e-6)
        before, self._number = self._number, number
        return number != before

    def free(self, t: float) -> bool:
        """Whether nothing is being computed at a time in s."""
        return round(t / self._period) >= self._free

    def take(self, t: float, u: Array, took: float) -> None:
        """Take in a command that was computed within a time in s from the measurement at t."""
        tick, periods = round(t / self._period), math.ceil(took / self._period - 1e-9)
        self._free = tick + max(1, periods)
        self._coming = self._free - 1, tick, u
        self.timing = took, 0.0

    def hold(self, t: float) -> Array:
        """Plate accelerations in rad/s^2 at a time in s, shape (..., 2)."""
        tick = round(t / self._period)
        if self._coming is not None and tick >= self._coming[0]:
            _, self._since, self.u = self._coming
            self._coming = None
        self._since = tick - self._ticks if self._since is None else self._since
        late = max(0, tick - self._since - self._ticks + 1)
        self.timing = self.timing[0], late * self._period
        return self.u


MEASURED_TIME = "measured"
"""A computing time that is measured by the clock."""


class HeldLaw:
    """A law behind a zero-order hold of its command, which may be delayed.

    It is evaluated at the first tick of each of its periods k T, which are counted from time 0, and
    plans for them. Observer and memory advance at every tick T. A command that takes longer than T
    is applied as many ticks later as it takes further periods T, begun ones counted; until then the
    previous one is held and no other is begun.

    Args:
        law: The law.
        ticks: k, control periods of the rig in one of the law's.
        computing_time: Computing time of a command in s, or ``measured``: the time of observer and
            law on this computer.
    """

    def __init__(self, law: Law, ticks: int, computing_time: float | str = 0.0) -> None:
        self.law = law
        self.ticks = ticks
        self.computing_time = computing_time
        self.name, self.model = law.name, law.model
        self.memory, self.needs, self.counts = law.memory, law.needs, law.counts

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations of the law itself, not held, rad/s^2, shape (..., 2)."""
        return self.law.control(t, x, reference, q)

    def memory_rate(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Time derivative of the memory q, shape (..., memory)."""
        return self.law.memory_rate(t, x, reference, q)

    def start(self, x: Array, reference: Reference, period: float) -> HeldCommand:
        """The law's plan for its own period, and nothing held yet."""
        plan = self.law.start(x, reference, self.ticks * period)
        return HeldCommand(plan, period, self.ticks, np.zeros((*x.shape[:-1], 2)))

    def replanned(
        self, plan: HeldCommand, t: float, x: Array, reference: Reference, period: float
    ) -> HeldCommand:
        """The law's plan from a time in s on, with what is held."""
        plan.plan = self.law.replanned(plan.plan, t, x, reference, self.ticks * period)
        return plan

    def command(self, now: Feedback) -> Array:
        """Plate accelerations in rad/s^2, shape (..., 2): new ones when it is time."""
        held: HeldCommand = now.plan
        held.timing = math.nan, 0.0
        if held.due(now.time) and held.free(now.time):
            begin = perf_counter()
            u = self.law.command(now._replace(plan=held.plan))
            took = self.computing_time
            if isinstance(took, str):
                took = held.before + perf_counter() - begin
            held.take(now.time, check_command(self.law, u, now.rate), took)
        return held.hold(now.time)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks of the law for a report, and that no analysis knows of its hold."""
        held = f"evaluated every {self.ticks} control periods and held between"
        if self.computing_time:
            each = "the time it takes here" if self.computing_time == MEASURED_TIME else "its time"
            held += f", each command applied when {each} is over"
        unheld = (
            f"The law is {held}; poles, "
            "margins and warnings of the linear loop leave this hold out and take it at every one."
        )
        return (*self.law.remarks, unheld)


class ControlStep(NamedTuple):
    """The answer of a controller to one measurement.

    Attributes:
        estimate: State at the time of the measurement, shape (..., 8).
        acceleration: Requested plate accelerations u in rad/s^2, shape (..., 2).
        rate: Requested plate rates (phi', theta') in rad/s, shape (..., 2).
        further: Quantities that the observer estimates beyond the state, shape
            (..., len(observer.knows)).
        computing: ``HeldCommand.timing`` of laws with a computing time, shape (..., 2); else None.
        board: Of a controller that is a program: the instructions that it took, NaN for none or if
            it does not count them, and the accelerations that the one in Python requests for the
            same measurement, rad/s^2, shape (..., 3); else None.
    """

    estimate: Array
    acceleration: Array
    rate: Array
    further: Array
    computing: Array | None = None
    board: Array | None = None


class Controller:
    """Law, observer and reference that drive a rig, simulated or real.

    Once per period ``command`` turns the measurement into a step; ``applied`` must then receive the
    rates that the rig really commanded, from which the observer predicts. Periods that a rig in
    real time left out are made up for at the next: observer and memory pass through them with the
    plate on a straight line and no touch.

    Args:
        law: The state feedback.
        observer: The estimator (with predictor, if any).
        reference: The path of the ball.
        period: Control period in s.

    Raises:
        ValueError: If the law needs what the observer does not estimate.
    """

    MAX_MISSED_PERIODS = 50
    """Largest number of periods that are made up for; after longer gaps a rig is levelled."""

    def __init__(
        self, law: ControlLaw, observer: Observer, reference: Reference, period: float
    ) -> None:
        self._needed = _place(needed_columns(law, observer))
        self.law = law
        self.observer = observer
        if not isinstance(reference, SampledReference):
            reference = SampledReference(reference, period)
        self.reference = reference
        self.period = period
        self._period = constant(period)
        self._time: float | None = None
        one: list[tuple[Place, ControlLaw]] = [(slice(None), law)]
        laws = law.groups.each if isinstance(law, PerRigLaw) else one
        late = [each for _, each in laws if isinstance(each, HeldLaw) and each.computing_time]
        self._places = [place for place, _ in laws] if late else []
        self.timed = any(each.computing_time == MEASURED_TIME for each in late)
        """Whether the law's computing time is measured."""

    def start(self, measurement: Measurement) -> None:
        """Begin with the ball and the plate where the measurement sees them, at rest."""
        x = np.zeros((*measurement.y.shape[:-1], 8))
        x[..., 0::2] = measurement.y
        if measurement.state is not None:
            x = np.array(measurement.state)
        self.observer.start(x)
        self.rate = self.requested = np.zeros((*x.shape[:-1], 2))
        self.memory = np.zeros((*x.shape[:-1], self.law.memory))
        self.plan = self.law.start(x, self.reference, self.period)
        self._time = None

    def take_over_at(self, t: float) -> None:
        """Let the law plan again from a time in s, from the observer's estimate."""
        x, path = self.observer.x, self.reference
        self.plan = self.law.replanned(self.plan, t, x, path, self.period)

    def command(self, measurement: Measurement) -> ControlStep:
        """The estimate for a measurement, and the request to the rig."""
        t, observer = measurement.time, self.observer
        begin = perf_counter()
        if self._time is not None and t - self._time > 1.5 * self.period:
            self._make_up(self._time, measurement)
        self._time, self._angles, self._age = t, measurement.y[..., 1::2], measurement.age
        x = check_estimate(observer, observer.correct(measurement), self.rate)
        seen, further = observer.equivalent, observer.further
        if self.timed:
            self.plan.before += perf_counter() - begin
        now = Feedback(
            t,
            x,
            seen,
            further[..., self._needed],
            self.rate,
            self.requested,
            self.reference,
            self.memory,
            self.plan,
            measurement,
        )
        u = check_command(self.law, self.law.command(now), self.rate)
        self._remember(t, seen)
        self.requested = self.rate + self._period * u
        return ControlStep(x, u, self.requested, further, self._computing())

    def _computing(self) -> Array | None:
        """Computing time and delay of each rig's command; None if no law has a computing time."""
        if not self._places:
            return None
        timing = np.zeros((*self.rate.shape[:-1], 2))
        plans = self.plan if isinstance(self.law, PerRigLaw) else [self.plan]
        for place, plan in zip(self._places, plans, strict=True):
            if isinstance(plan, HeldCommand):
                timing[place] = plan.timing
        return timing

    def _remember(self, t: float, seen: Array) -> None:
        """Integrate the law's memory over one period, from an equivalent state."""
        if self.law.memory:
            slope = self.law.memory_rate(t, seen, self.reference, self.memory)
            slope = check_memory_rate(self.law, slope, self.memory)
            self.memory = self.memory + self._period * slope

    def _make_up(self, before: float, present: Measurement) -> None:
        """Pass through the periods since a time in s in which nothing was measured."""
        gap, touched = present.time - before, np.zeros_like(present.touched)
        periods, still = round(gap / self.period), np.zeros_like(self.rate)
        for number in range(max(1, periods - self.MAX_MISSED_PERIODS), periods):
            share = number / periods
            t, y = before + share * gap, present.y.copy()
            y[..., 1::2] = (1 - share) * self._angles + share * present.y[..., 1::2]
            age = self._age + share * gap
            self.observer.correct(Measurement(t, y, age, touched, present.state))
            self._remember(t, self.observer.equivalent)
            self.observer.predict(still)

    def applied(self, rate: Array) -> Array:
        """Take in the plate rates that the rig commanded after its clamps, rad/s, (..., 2).

        Returns:
            The corresponding accelerations, rad/s^2, shape (..., 2).
        """
        acceleration: Array = (rate - self.rate) / self._period
        begin = perf_counter()
        self.observer.predict(acceleration)
        if self.timed:
            self.plan.before = perf_counter() - begin
        self.rate = rate
        return acceleration


def needed_columns(law: ControlLaw, observer: Observer) -> list[int]:
    """Columns, in what an observer knows, of what a law needs, and counts if it is known.

    Raises:
        ValueError: If the observer does not estimate it: which law, what, which observer.
    """
    known = [quantity.name for quantity in observer.knows]
    for name in law.needs:
        if name not in known:
            raise ValueError(
                f"law '{law.name}' needs an observer that estimates {name}: "
                f"'{observer.name}' does not"
            )
    counted = law.counts if set(law.counts) <= set(known) else ()
    return [known.index(name) for name in (*law.needs, *counted)]


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
        """Place of each group's rigs along the axis of the rigs, and their common member."""


def _place(rigs: Sequence[int]) -> Place:
    """A slice for neighbours, which numpy takes without a copy; else their numbers."""
    first = rigs[0] if rigs else 0
    if list(rigs) == list(range(first, first + len(rigs))):
        return slice(first, first + len(rigs))
    return np.array(rigs)


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


BALL_SLICE = slice(0, None, 4)
"""The ball's position X_1 = (x, y) in the state (5.5)."""


@dataclass(kw_only=True)
class Smith(Observer):
    """Gives an observer the present ball position, computed from the one a dead time ago.

    The observer's own estimate is the predictor's model, x_m = xhat, so (7.19b) becomes

        X_1sp(t) = xhat_1(t) + X_1(t - tau) - xhat_1(t - tau):

    the observer is corrected by the delayed innovation, and nothing else is predicted. A good model
    without noise has no innovation, and the dead time disappears; else the observer's error passes
    through a loop with a dead time, which fast poles make oscillate: a Luenberger observer with the
    poles of (8.1) has damping 0.2 at 42 ms and is unstable above 56 ms.

    Past estimates are kept once a period and interpolated linearly, as for a dead time that is no
    multiple of the period. A position that has waited since it arrived, as between two frames of
    the screen, is compared with the estimate that much earlier.

    It wraps an observer, and has the ``name``, ``model`` and ``period`` of that observer.
    Start with the leading axes of the measurements.

    Raises:
        ValueError: If the delay is negative or not finite, or the observer makes up for it itself.
    """

    longest_wait: ClassVar[float] = 0.1
    """Time in s since its arrival after which a position counts as not touched."""

    observer: Observer
    """The observer that receives the prediction."""
    delay: NotNegative = 0.042
    """Dead time tau of the ball's position in s, Table A.2."""

    _past: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Take over the observer's model and period."""
        super().__post_init__()
        if isinstance(self.observer, DelayedObserver):
            name = self.observer.name
            raise ValueError(f"observer '{name}' makes up for the dead time itself: no predictor")
        self.model, self.period = self.observer.model, self.observer.period
        self.knows = self.observer.knows  # type: ignore[misc]
        self.name = self.observer.name  # type: ignore[misc]
        self._back = self.delay / self.period
        self.length = 3 + math.ceil(self._back + self.longest_wait / self.period)
        self._whole = math.floor(self._back + 1e-9)
        self._share = max(self._back - self._whole, 0.0)
        self._tick = 0

    def start(self, x: Array) -> None:
        """Begin at the state x with a ball that has been there all the time."""
        self.observer.start(x)
        self.x = self.observer.x
        self._tick = 0
        self._past = np.array(
            np.broadcast_to(self.x[..., BALL_SLICE], (self.length, *x.shape[:-1], 2))
        )

    def correct(self, measurement: Measurement) -> Array:
        """Take in plate angles of now and a ball position of a dead time ago."""
        ball = self.x[..., BALL_SLICE]
        slot = self._tick % self.length
        if not self._whole:  # else it is not read before it is corrected
            self._past[slot] = ball
        y = measurement.y.copy()
        position = y[..., 0::2]
        touched = measurement.touched
        if some(measurement.age):
            touched = touched & (measurement.age <= self.longest_wait)
            age = np.where(touched, measurement.age, 0)
            position += ball - self._look_back_each(self._back + age / self.period)
        else:
            position += ball - self._look_back()
        part = Measurement(measurement.time, y, measurement.age, touched, measurement.state)
        self.x = check_estimate(self.observer, self.observer.correct(part), y)
        self._past[slot] = self.x[..., BALL_SLICE]
        return self.x

    def predict(self, u: Array) -> None:
        """Carry the estimate one period ahead."""
        self.observer.predict(u)
        self.x = self.observer.x
        self._tick += 1

    @property
    def further(self) -> Array:
        """Quantities that the observer knows beyond the state, shape (..., len(knows))."""
        return self.observer.further

    @property
    def equivalent(self) -> Array:
        """The estimate as ``Feedback.equivalent`` has it, shape (..., 8)."""
        return self.observer.equivalent

    def _look_back(self) -> Array:
        """Estimated ball position a dead time ago, shape (..., 2)."""
        newer: Array = self._past[(self._tick - self._whole) % self.length]
        if self._share < 1e-9:
            return newer
        older: Array = self._past[(self._tick - self._whole - 1) % self.length]
        return newer + self._share * (older - newer)

    def _look_back_each(self, periods: Array) -> Array:
        """Estimated ball position a number of periods ago, each rig its own, shape (..., 2)."""
        if periods.size == 1:  # plain numbers for one rig, several times faster
            back = periods.item()
            first = math.floor(back + 1e-9)
            newer, older = (self._past[(self._tick - k) % self.length] for k in (first, first + 1))
            return np.asarray(newer + (back - first) * (older - newer))
        whole = np.floor(periods + 1e-9).astype(int)
        share = (periods - whole)[..., np.newaxis]
        slots = (self._tick - np.stack([whole, whole + 1])) % self.length
        newer, older = np.take_along_axis(self._past, slots[..., np.newaxis], axis=0)
        return newer + share * (older - newer)
