"""A disturbance observer: the effects that the model leaves out, as one slow force in each axis."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from controllers.arrays import Array, Positive, State, components, numbers, together
from controllers.interfaces import Quantity
from controllers.observers.late_ball import LateBall, Tilt

MAX_SAMPLE_PERIODS = 50
"""Largest number of control periods between two samples for which there is a gain of its own."""


@dataclass(kw_only=True)
class DisturbanceObserver(LateBall):
    """Extended state observer of the flat output, driven by the measured plate angle.

    Ohnishi (1987, "A new servo method in mechatronics"), as an extended state observer Han (1995);
    for nonlinear plants Chen, Ballance, Gawthrop and O'Reilly (2000, "A nonlinear disturbance
    observer for robotic manipulators"). With eta = (x + c2 phi, y - c2 theta) and n of the exact
    model (5.9), either axis has

        eta'' = k1 (sin phi cos theta, -sin theta) + n + d,    d' = 0,

    and the error e of a touch sample corrects (eta, eta', d) by L e, so that their errors decay
    with three poles at ``pole``. L is the gain for the time since the last sample: frames of the
    screen are few. Dead time is compensated as by ``friction_kalman``.

    It is an observer and not a law, so that any law can use it: the ``equivalent`` angles,
    phi_eq = phi + d / k1, contain the disturbance, and a law that counters them counters it.

    Good for level errors and other slow effects, without a model of them. It follows friction with
    the delay of its poles, so a ball that turns is pushed the wrong way for a short time, and one
    that is held creeps and leaps (limit cycles).

    Raises:
        ValueError: If a setting is not finite or has the wrong sign.
    """

    name: ClassVar[str] = "disturbance_observer"
    knows: ClassVar[tuple[Quantity, ...]] = tuple(
        Quantity(f"disturbance_{axis}", "m/s^2") for axis in "xy"
    )

    pole: Positive = 6.0
    """The three poles of the error, as a rate in 1/s."""

    def __post_init__(self) -> None:
        """Check the settings and compute the gains once."""
        super().__post_init__()
        ticks = np.arange(1, MAX_SAMPLE_PERIODS + 1)
        self._gains = np.array([gains(self.pole, count * self.period) for count in ticks])

    def start(self, x: State) -> None:
        """Begin at the state x, shape (..., 8), with no disturbance."""
        self._begin_at(x, smooth=1.0, friction=0.0)
        self._waited: Any = numbers(np.zeros(self._rigs, int))

    @property
    def further(self) -> Array:
        """The disturbance, shape (..., 2)."""
        return together(self._s[4:6], self._rigs).reshape(*self._shape, 2)

    def _advance(self, begin: Tilt, then: Tilt) -> None:
        """One period of the model."""
        self._s, _ = self._ball.step(self._s, begin, then)
        self._waited = self._waited + 1

    def _take(self, seen: tuple[Any, Any], age: Any, new: Any, then: Tilt) -> None:
        """Correct by a touch sample."""
        L = self._gains[self._by.least(self._waited, MAX_SAMPLE_PERIODS) - 1].reshape(-1, 3)
        here, velocity = self._ball.position(self._s, then), self._ball.velocity(self._s, then)
        s: list[Any] = list(self._s)
        position, speed, force = (gain * new for gain in components(L))
        for axis, place in enumerate(seen):
            # the sample shows the ball an age ago
            e = place - (here[axis] - age * velocity[axis])
            s[axis] = s[axis] + position * e
            s[2 + axis] = s[2 + axis] + speed * e
            s[4 + axis] = s[4 + axis] + force * e
        self._s = s
        self._waited = self._by.where(new, 0, self._waited)


def gains(pole: float, T: float) -> Array:
    """L of (eta, eta', d) so that an error sampled with T decays as exp(-pole t), three times.

    With A of a step of T and c = (1, 0, 0), A (1 - L c) has the eigenvalue exp(-pole T) thrice: by
    comparing the coefficients of its characteristic polynomial.
    """
    z = math.exp(-pole * T)
    return np.array([1 - z**3, 1.5 * (1 - z) ** 2 * (1 + z) / T, (1 - z) ** 3 / T**2])
