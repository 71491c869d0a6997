"""A cascade: ball position asks for an acceleration, plate angle follows."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ballplate.laws import Array, Law, Reference


@dataclass(frozen=True, kw_only=True)
class Cascade(Law):
    """Inner loop on the plate angle, outer loop on the ball."""

    name: ClassVar[str] = "cascade"

    ball: tuple[float, float] = (2.0, 2.4)
    """Outer gains on position and velocity, 1/s^2 and 1/s."""
    plate: tuple[float, float] = (60.0, 14.0)
    """Inner gains on angle and rate, 1/s^2 and 1/s."""

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations (phi'', theta'') in rad/s^2, shape (..., 2)."""
        position, velocity, angle, rate = (x[..., i::4] for i in range(4))
        r = reference(t)
        desired = r[2] + self.ball[0] * (r[0] - position) + self.ball[1] * (r[1] - velocity)
        sign = np.array([1.0, -1.0])  # x'' ~ +k1 sin(phi), y'' ~ -k1 sin(theta)
        goal = np.arcsin(np.clip(sign * desired / self.model.k1, -0.17, 0.17))
        return self.plate[0] * (goal - angle) - self.plate[1] * rate
