"""PID of the ball: its integral and its filtered error are the law's memory."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ballplate.laws import Array, Law, Reference


@dataclass(frozen=True, kw_only=True)
class OwnPid(Law):
    """What the ball is to be accelerated by becomes a plate angle; a PD brings the plate there."""

    name: ClassVar[str] = "own_pid"
    memory: ClassVar[int] = 4  # a law keeps nothing in itself: what it must remember is q

    kp: float = 6.0
    ki: float = 1.0
    kd: float = 4.0
    filter: float = 0.04
    """Time constant of the derivative, s."""

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations (phi'', theta'') in rad/s^2, shape (..., 2)."""
        # x has the last axis (x, x', phi, phi', y, y', theta, theta'); 0::4 are both positions
        error = reference(t)[0] - x[..., 0::4]
        integral, filtered = q[..., :2], q[..., 2:]
        wanted = self.kp * error + self.ki * integral + self.kd * (error - filtered) / self.filter
        sign = np.array([1.0, -1.0])  # x'' ~ +k1 sin(phi), y'' ~ -k1 sin(theta)
        goal = np.arcsin(np.clip(sign * wanted / self.model.k1, -0.14, 0.14))
        return 144.0 * (goal - x[..., 2::4]) - 24.0 * x[..., 3::4]

    def memory_rate(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Time derivative of q, shape (..., 4); the controller adds it up every period."""
        error = reference(t)[0] - x[..., 0::4]
        return np.concatenate([error, (error - q[..., 2:]) / self.filter], axis=-1)
