"""Lab `friction`: a cascade that pushes against rolling friction, and learns how much."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ballplate.laws import Array, Law, Reference

ARM_MM = 0.18  # told: plant.friction.rolling_mm
"""Arm of the rolling friction of your rig in mm, as your sheet tells it."""


@dataclass(frozen=True, kw_only=True)
class Against(Law):
    """Outer loop on the ball, inner loop on the plate, and a push along the way of the goal."""

    name: ClassVar[str] = "against"
    # how many numbers q the law remembers from period to period; memory_rate says how they change
    memory: ClassVar[int] = 4

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations (phi'', theta'') in rad/s^2, shape (..., 2)."""
        position, velocity, angle, rate = (x[..., i::4] for i in range(4))
        r = reference(t)  # position, velocity, acceleration, ... of the goal, each (x, y)
        wanted = r[2] + 4.0 * (r[0] - position) + 4.0 * (r[1] - velocity)
        sign = np.array([1.0, -1.0])  # x'' ~ +k1 sin(phi), y'' ~ -k1 sin(theta)
        goal = np.arcsin(np.clip(sign * wanted / self.model.k1, -0.17, 0.17))
        return 60.0 * (goal - angle) - 14.0 * rate

    def memory_rate(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Time derivative of q, shape (..., 4): nothing is learnt as long as it is 0."""
        rate = np.zeros_like(q)
        return rate
