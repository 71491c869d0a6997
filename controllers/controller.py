"""Law, observer and reference joined into one controller, for one rig and for N of them.

With what holds a law's command between its periods.
"""

from __future__ import annotations

import math
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from controllers.arrays import Array, constant
from controllers.catalog import check_command, check_estimate, check_memory_rate
from controllers.interfaces import ControlLaw, Feedback, Law, Measurement, Observer, Reference
from controllers.per_rig import PerRigLaw, Place, SampledReference, place_of


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
        self._needed = place_of(needed_columns(law, observer))
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
