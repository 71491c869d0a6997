"""Law, observer and reference joined into one controller: measurement in, plate rate out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from controllers.arrays import constant
from controllers.interfaces import Array, Law, Measurement, Observer, Reference


class ControlStep(NamedTuple):
    """What a controller makes of one measurement.

    Attributes:
        estimate: State at the time of the measurement, shape (..., 8).
        acceleration: Requested plate accelerations u in rad/s^2, shape (..., 2).
        rate: Requested plate rates (phi', theta') in rad/s, shape (..., 2).
    """

    estimate: Array
    acceleration: Array
    rate: Array


class Controller:
    """What drives a rig, simulated or real.

    Once per period ``command`` turns the measurement into a step; ``applied`` must then be given
    the rates the rig really commanded, from which the observer predicts.

    Args:
        law: The state feedback.
        observer: The estimator (with predictor, if any).
        reference: The path of the ball.
        period: Control period in s.
    """

    def __init__(self, law: Law, observer: Observer, reference: Reference, period: float) -> None:
        self.law = law
        self.observer = observer
        if not isinstance(reference, SampledReference):
            reference = SampledReference(reference, period)
        self.reference = reference
        self.period = period
        self._period = constant(period)

    def start(self, measurement: Measurement) -> None:
        """Begin with the ball and the plate where the measurement sees them, at rest."""
        x = np.zeros((*measurement.y.shape[:-1], 8))
        x[..., 0::2] = measurement.y
        if measurement.state is not None:
            x = np.array(measurement.state)
        self.observer.start(x)
        self.rate = np.zeros((*x.shape[:-1], 2))
        self.memory = np.zeros((*x.shape[:-1], self.law.memory))

    def command(self, measurement: Measurement) -> ControlStep:
        """The estimate for a measurement, and what is requested of the rig."""
        t = measurement.time
        x = self.observer.correct(measurement)
        u = self.law.control(t, x, self.reference, self.memory)
        if self.law.memory:
            slope = self.law.memory_rate(t, x, self.reference, self.memory)
            self.memory = self.memory + self._period * slope
        return ControlStep(x, u, self.rate + self._period * u)

    def applied(self, rate: Array) -> Array:
        """Take in the plate rates that the rig commanded after its clamps, rad/s, (..., 2).

        Returns:
            The accelerations that they mean, rad/s^2, shape (..., 2).
        """
        acceleration: Array = (rate - self.rate) / self._period
        self.observer.predict(acceleration)
        self.rate = rate
        return acceleration


class SampledReference(Reference):
    """A reference evaluated ahead in blocks of control periods; elsewhere it is the original.

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
