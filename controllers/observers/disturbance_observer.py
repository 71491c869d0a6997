"""Disturbance observer: all that the model does not say is one slow force in each axis."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from controllers.arrays import Array, Mask
from controllers.interfaces import Quantity
from controllers.observers.late_ball import LateBall
from controllers.observers.rolling_ball import Tilt, components, together
from controllers.ranges import Positive

LONGEST = 50
"""Control periods between two samples from which on the gain is that of so many."""


@dataclass(kw_only=True)
class DisturbanceObserver(LateBall):
    """Extended state observer of the flat output, driven by the measured plate angle.

    Ohnishi (1987, "A new servo method in mechatronics"), as an extended state observer Han (1995);
    for nonlinear plants Chen, Ballance, Gawthrop and O'Reilly (2000, "A nonlinear disturbance
    observer for robotic manipulators"). With eta = (x + c2 phi, y - c2 theta) and n of the exact
    model (5.9), either axis has

        eta'' = k1 (sin phi cos theta, -sin theta) + n + d,    d' = 0,

    and the error e of a touch sample corrects (eta, eta', d) by L e, so that what is wrong with
    them dies out with three poles at ``pole``. L is that of the time since the last sample:
    frames of the screen are few. Dead time is made up for as by ``friction_kalman``.

    It is an observer and not a law, so that every law can stand on it: the ``equivalent`` angles,
    phi_eq = phi + d / k1, have the disturbance in them, and the law that counters them counters it.

    Good at level errors and whatever else changes slowly, without a model of it; friction it
    follows a pole late, so a ball that turns is pushed the wrong way for a while, and one that is
    held creeps and leaps (limit cycles).

    Raises:
        ValueError: If a setting is not finite or has the wrong sign.
    """

    name: ClassVar[str] = "disturbance_observer"
    knows: ClassVar[tuple[Quantity, ...]] = (
        Quantity("disturbance_x", "m/s^2"),
        Quantity("disturbance_y", "m/s^2"),
    )

    pole: Positive = 6.0
    """The three poles of the error, as a rate in 1/s."""

    def __post_init__(self) -> None:
        """Check the settings and compute the gains once."""
        super().__post_init__()
        ticks = np.arange(1, LONGEST + 1)
        self._gains = np.array([gains(self.pole, count * self.period) for count in ticks])

    def start(self, x: Array) -> None:
        """Begin at the state x, shape (..., 8), with no disturbance."""
        self._begin_at(x, smooth=1.0, friction=0.0)
        self._waited = np.zeros(self._rigs, int)

    @property
    def further(self) -> Array:
        """The disturbance, shape (..., 2)."""
        return together(self._s[4:6], self._rigs).reshape(*self._shape, 2)

    def _advance(self, begin: Tilt, then: Tilt) -> None:
        """One period of the model."""
        self._s, _ = self._ball.step(self._s, begin, then)
        self._waited = self._waited + 1

    def _take(self, y: Array, age: Array, new: Mask, then: Tilt) -> None:
        """Correct by a touch sample."""
        L = self._gains[np.minimum(self._waited, LONGEST) - 1] * new[:, None]
        here, velocity = self._ball.position(self._s, then), self._ball.velocity(self._s, then)
        s: list[Any] = list(self._s)
        position, speed, force = components(L)
        for axis, seen in enumerate(components(y[:, 0::2])):
            # the ball was there an age ago: less the way since
            e = seen - (here[axis] - components(age[:, None])[0] * velocity[axis])
            s[axis] = s[axis] + position * e
            s[2 + axis] = s[2 + axis] + speed * e
            s[4 + axis] = s[4 + axis] + force * e
        self._s = s
        self._waited = np.where(new, 0, self._waited)


def gains(pole: float, T: float) -> Array:
    """L of (eta, eta', d) so that an error sampled with T dies out as exp(-pole t) thrice.

    With A of a step of T and c = (1, 0, 0), A (1 - L c) has the eigenvalue exp(-pole T) thrice: by
    comparing the coefficients of its characteristic polynomial.
    """
    z = math.exp(-pole * T)
    return np.array([1 - z**3, 1.5 * (1 - z) ** 2 * (1 + z) / T, (1 - z) ** 3 / T**2])
