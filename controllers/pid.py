"""PID control of the ball in a cascade: the ball asks for an acceleration, the plate follows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Gt, Le

from controllers.arrays import Array
from controllers.interfaces import Law, Reference
from controllers.ranges import NotNegative, Positive

SIGN = np.array([1.0, -1.0])
"""A positive phi moves the ball along +x, a positive theta along -y, (5.35)."""


@dataclass(frozen=True, kw_only=True)
class Pid(Law):
    """PID on each axis of the ball, its derivative filtered, its integral kept from winding up.

    What the controller asks of the ball, an acceleration, becomes the plate angle that rolls it so
    on the model, ``sin(angle) = acceleration / k1``, and a PD brings the plate there. Not in the
    thesis. The memory holds the integral of the error and the filtered error, of x and y.
    """

    name: ClassVar[str] = "pid"
    memory: ClassVar[int] = 4

    kp: NotNegative = 6.0
    """Gain on the error, 1/s^2."""
    ki: NotNegative = 1.0
    """Gain on its integral, 1/s^3."""
    kd: NotNegative = 4.0
    """Gain on its filtered derivative, 1/s."""
    filter: Positive = 0.04
    """Time constant of the derivative, s."""
    angle: Annotated[float, Gt(0), Le(10)] = 8.0
    """Largest plate angle that is asked for, deg; there the integral stops growing."""
    plate: tuple[NotNegative, NotNegative] = (144.0, 24.0)
    """Gains on the plate's angle and rate, 1/s^2 and 1/s."""

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations (phi'', theta'') in rad/s^2, shape (..., 2)."""
        angle, rate = x[..., 2::4], x[..., 3::4]
        wanted = np.clip(self._asked(t, x, reference, q), -self._most, self._most)
        goal = SIGN * np.arcsin(wanted / self.model.k1)
        u: Array = self.plate[0] * (goal - angle) - self.plate[1] * rate
        return u

    def memory_rate(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Rates of the error's integral, shape (..., 2), and of the filtered error, (..., 2)."""
        error = reference(t)[0] - x[..., 0::4]
        asked = self._asked(t, x, reference, q)
        winding = (np.abs(asked) > self._most) & (asked * error > 0)
        return np.concatenate(
            [np.where(winding, 0.0, error), (error - q[..., 2:]) / self.filter], axis=-1
        )

    def _asked(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Acceleration of the ball in m/s^2, before the angle's limit, shape (..., 2)."""
        error = reference(t)[0] - x[..., 0::4]
        derivative = (error - q[..., 2:]) / self.filter
        asked: Array = self.kp * error + self.ki * q[..., :2] + self.kd * derivative
        return asked

    @property
    def _most(self) -> float:
        """Largest acceleration that is asked for, m/s^2."""
        return float(self.model.k1 * np.sin(np.radians(self.angle)))
