"""What observers of a rolling ball that make up for the dead time have in common."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from controllers.arrays import ARRAYS, NUMBERS, Array, Mask, some
from controllers.ballplate import SIGN
from controllers.interfaces import DelayedObserver, Measurement
from controllers.observers.rolling_ball import RollingBall, Tilt, components, together
from controllers.observers.slow_plate import SlowPlate
from controllers.ranges import Positive


@dataclass(kw_only=True)
class LateBall(DelayedObserver):
    """A filter of the flat output that runs at the time of the touch sample, t - delay.

    Its states are (eta_x, eta_y, eta_x', eta_y', d_x, d_y, kappa_x, kappa_y, F) as ``RollingBall``
    has them. It is driven by the plate angles of then, and its estimate is carried to t with those
    measured since. A frame of the screen is taken once, when it is new, and as old as it is. A law
    is given the plate's angle and rate as a slow estimate from the commanded rate and the encoders.

    Raises:
        ValueError: If a setting is not finite or has the wrong sign.
    """

    plate_pole: Positive = 10.0
    """Both poles of the plate's estimate, as a rate in 1/s."""

    def _begin_at(self, x: Array, smooth: float, friction: float) -> None:
        """Begin at the state x, shape (..., 8), on a plate that has been as it is all the time.

        Args:
            x: The state.
            smooth: Speed over which friction changes its sign, m/s.
            friction: Of the ball, m/s^2.
        """
        super().start(x)
        self._shape = self.x.shape[:-1]
        rows = self.x.reshape(-1, 8)
        self._rigs = len(rows)
        self._by = NUMBERS if self._rigs == 1 else ARRAYS
        self._ball = RollingBall(self.model, smooth, self.period, self.delay, rows)
        self._plate = SlowPlate(self.plate_pole, self.period, rows)
        c2 = self.model.c2
        s = np.zeros((self._rigs, 9))
        s[:, 0:2] = rows[:, 0::4] + c2 * SIGN * rows[:, 2::4]
        s[:, 2:4] = rows[:, 1::4] + c2 * SIGN * rows[:, 3::4]
        s[:, 8] = friction
        self._s: Any = components(s)
        self._age = np.full(self._rigs, np.inf)
        self._state = components(rows)

    def correct(self, measurement: Measurement) -> Array:
        """Take in plate angles of now and a ball position of a dead time ago."""
        y = measurement.y.reshape(-1, 4)
        angle, rate = self._plate.correct(y[:, 1::2])
        before = self._state
        commanded = components(self._plate.commanded)
        begin, then = self._ball.measured(components(y[:, 1::2]), commanded, before)
        self._advance(begin, then)
        age, touched = measurement.age.reshape(-1), measurement.touched.reshape(-1)
        new = touched & (age < self._age + self.period / 2)
        self._age = age
        if some(new):
            self._take(y, age, new, then)
        ex, ey, vx, vy = self._ball.carry(self._at(self._ball.position(self._s, then)))
        (phi, theta), (phi_rate, theta_rate) = components(angle), components(rate)
        c2 = self.model.c2
        self._state = (
            ex - c2 * phi,
            vx - c2 * phi_rate,
            phi,
            phi_rate,
            ey + c2 * theta,
            vy + c2 * theta_rate,
            theta,
            theta_rate,
        )
        self.x = together(self._state, self._rigs).reshape(*self._shape, 8)
        return self.x

    def predict(self, u: Array) -> None:
        """Carry the plate one period ahead; the ball follows when the plate is measured."""
        self._plate.predict(u.reshape(-1, 2))

    def _at(self, place: Sequence[Any]) -> Any:
        """The filter's state with the friction of a place (x, y) in m: one for all by default."""
        return self._s

    @abstractmethod
    def _advance(self, begin: Tilt, then: Tilt) -> None:
        """One period of the filter, from one touch sample's time to the next."""

    @abstractmethod
    def _take(self, y: Array, age: Array, new: Mask, then: Tilt) -> None:
        """Correct by a touch sample that is new in some rig.

        Args:
            y: Measurement, shape (N, 4).
            age: Seconds since it arrived, shape (N,).
            new: Where it is new, shape (N,).
            then: The plate a dead time ago.
        """

    @property
    def s(self) -> Array:
        """The filter's state at the touch sample's time, shape (..., 9)."""
        return together(self._s, self._rigs).reshape(*self._shape, 9)

    @property
    def equivalent(self) -> Array:
        """The estimate with friction and disturbance in the plate's angles, shape (..., 8)."""
        x, vx, *_, y, vy, _, _ = self._state
        phi, phi_rate, theta, theta_rate = self._ball.equivalent(
            self._at(self._state[0::4]), self._state
        )
        found = (x, vx, phi, phi_rate, y, vy, theta, theta_rate)
        return together(found, self._rigs).reshape(self.x.shape)
