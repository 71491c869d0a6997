"""Rolling resistance between ball and screen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from controllers.ballplate import BallPlate

Array = NDArray[np.floating]


@dataclass(frozen=True, kw_only=True)
class RollingFriction:
    """Coulomb rolling resistance: a torque of arm times normal force against the rolling.

    Attributes:
        arm: Rolling resistance arm in m, a number or one a rig, shape (N,). A plate at rest tilted
            by less than arctan(arm / radius) holds the ball.
    """

    arm: float | Array = 0.0

    def deceleration(self, model: BallPlate, x: Array) -> Array:
        """Largest acceleration in m/s^2 that the resistance can take away, shape (...,).

        From J/r^2 and m in the balance of the rolling ball: c1 (arm / r) times the normal force
        per mass, here g cos(theta) cos(phi) (plate accelerations change it by under 1 %).
        """
        normal = model.gravity * np.cos(x[..., 6]) * np.cos(x[..., 2])
        result: Array = model.c1 * (np.asarray(self.arm) / model.radius) * normal
        return result

    def resist(self, model: BallPlate, x: Array, free: Array) -> Array:
        """Acceleration of the ball with resistance, shape (..., 2), given the one without.

        A moving ball is slowed against its velocity; a resting one starts only when the free
        acceleration exceeds the limit.
        """
        velocity = x[..., 1::4]
        limit = self.deceleration(model, x)
        speed = np.hypot(velocity[..., 0], velocity[..., 1])
        push = np.hypot(free[..., 0], free[..., 1])
        moving = free - (limit / np.where(speed > 0, speed, 1.0))[..., None] * velocity
        share = np.maximum(0.0, 1.0 - limit / np.where(push > 0, push, 1.0))
        return np.where((speed > 0)[..., None], moving, share[..., None] * free)
