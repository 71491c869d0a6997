"""Law, observer and reference joined into one controller: measurement in, plate rate out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from controllers.arrays import constant
from controllers.interfaces import Array, Feedback, Law, Measurement, Observer, Reference
from controllers.probe import commanded, remembered


class ControlStep(NamedTuple):
    """What a controller makes of one measurement.

    Attributes:
        estimate: State at the time of the measurement, shape (..., 8).
        acceleration: Requested plate accelerations u in rad/s^2, shape (..., 2).
        rate: Requested plate rates (phi', theta') in rad/s, shape (..., 2).
        further: What the observer estimates beyond the state, shape (..., len(observer.knows)).
    """

    estimate: Array
    acceleration: Array
    rate: Array
    further: Array


class Controller:
    """What drives a rig, simulated or real.

    Once per period ``command`` turns the measurement into a step; ``applied`` must then be given
    the rates the rig really commanded, from which the observer predicts. Periods that a rig in real
    time had to leave out are made up for at the next: observer and memory go through them with the
    plate on a straight line and no touch.

    Args:
        law: The state feedback.
        observer: The estimator (with predictor, if any).
        reference: The path of the ball.
        period: Control period in s.

    Raises:
        ValueError: If the law needs what the observer does not estimate.
    """

    MOST_MISSED = 50
    """Periods that are made up for at most; after longer ones a rig has been levelled."""

    def __init__(self, law: Law, observer: Observer, reference: Reference, period: float) -> None:
        self._needed = needed(law, observer)
        self.law = law
        self.observer = observer
        if not isinstance(reference, SampledReference):
            reference = SampledReference(reference, period)
        self.reference = reference
        self.period = period
        self._period = constant(period)
        self._time: float | None = None

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

    def command(self, measurement: Measurement) -> ControlStep:
        """The estimate for a measurement, and what is requested of the rig."""
        t, observer = measurement.time, self.observer
        if self._time is not None and t - self._time > 1.5 * self.period:
            self._make_up(self._time, measurement)
        self._time, self._angles, self._age = t, measurement.y[..., 1::2], measurement.age
        x = observer.correct(measurement)
        seen, further = observer.equivalent, observer.further
        now = Feedback(
            t,
            x,
            seen,
            further[..., self._needed] if self._needed else further[..., :0],
            self.rate,
            self.requested,
            self.reference,
            self.memory,
            self.plan,
        )
        u = commanded(self.law, self.law.command(now), self.rate)
        self._remember(t, seen)
        self.requested = self.rate + self._period * u
        return ControlStep(x, u, self.requested, further)

    def _remember(self, t: float, seen: Array) -> None:
        """Integrate the law's memory over one period, from an equivalent state."""
        if self.law.memory:
            slope = self.law.memory_rate(t, seen, self.reference, self.memory)
            slope = remembered(self.law, slope, self.memory)
            self.memory = self.memory + self._period * slope

    def _make_up(self, before: float, present: Measurement) -> None:
        """Go through the periods since a time in s in which nothing was measured."""
        passed, touched = present.time - before, np.zeros_like(present.touched)
        periods, still = round(passed / self.period), np.zeros_like(self.rate)
        for number in range(max(1, periods - self.MOST_MISSED), periods):
            share = number / periods
            t, y = before + share * passed, present.y.copy()
            y[..., 1::2] = (1 - share) * self._angles + share * present.y[..., 1::2]
            age = self._age + share * passed
            self.observer.correct(Measurement(t, y, age, touched, present.state))
            self._remember(t, self.observer.equivalent)
            self.observer.predict(still)

    def applied(self, rate: Array) -> Array:
        """Take in the plate rates that the rig commanded after its clamps, rad/s, (..., 2).

        Returns:
            The accelerations that they mean, rad/s^2, shape (..., 2).
        """
        acceleration: Array = (rate - self.rate) / self._period
        self.observer.predict(acceleration)
        self.rate = rate
        return acceleration


def needed(law: Law, observer: Observer) -> list[int]:
    """Where what a law needs stands in what an observer knows.

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
    return [known.index(name) for name in law.needs]


class SampledReference(Reference):
    """A reference evaluated ahead in blocks of control periods; elsewhere it is the original.

    The blocks are for who asks tick by tick; who wants to know the future asks with an array.

    Args:
        reference: The original.
        period: Control period in s.
    """

    BLOCK = 512

    def __init__(self, reference: Reference, period: float) -> None:
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
        block: Array = self._block[index]
        return block
