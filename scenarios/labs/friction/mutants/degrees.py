"""A mistake: the slope at which friction holds the ball is taken in degrees.

# fails: the ball stays on the plate
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ballplate.laws import Array, Law, Reference

ARM_MM = 0.18  # told: plant.friction.rolling_mm


@dataclass(frozen=True, kw_only=True)
class Against(Law):
    """Outer loop on the ball, inner loop on the plate, and a push along the way of the goal."""

    name: ClassVar[str] = "against"

    arm_mm: float = ARM_MM
    """Arm of the rolling friction of your rig, as your sheet tells it, mm."""
    factor: float = 1.35  # found by a sweep: the observer does not know of friction and errs by it
    """Your push over the friction that the ball itself has."""

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations (phi'', theta'') in rad/s^2, shape (..., 2)."""
        position, velocity, angle, rate = (x[..., i::4] for i in range(4))
        r = reference(t)  # position, velocity, acceleration, ... of the goal, each (x, y)
        wanted = r[2] + 4.0 * (r[0] - position) + 4.0 * (r[1] - velocity)

        # what the ball must be pushed by so that friction is made up for, m/s^2
        push = np.zeros_like(wanted)
        friction = self.model.k1 * np.degrees(self.arm_mm / 1000 / self.model.radius)
        speed = np.linalg.norm(r[1], axis=-1, keepdims=True)
        push = self.factor * friction * r[1] / np.maximum(speed, 0.001)

        wanted = wanted + push
        sign = np.array([1.0, -1.0])  # x'' ~ +k1 sin(phi), y'' ~ -k1 sin(theta)
        goal = np.arcsin(np.clip(sign * wanted / self.model.k1, -0.17, 0.17))
        return 60.0 * (goal - angle) - 14.0 * rate
