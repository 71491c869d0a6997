"""State feedback by LQR, designed on the linear model (5.35) with python-control."""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import control
import numpy as np

from ballplate.laws import Array, Law, Reference


@dataclass(frozen=True, kw_only=True)
class OwnLqr(Law):
    """u = -gains (x - desired), from the weights of state and effort."""

    name: ClassVar[str] = "own_lqr"

    position: float = 100.0
    """Weight of the ball's position; velocity, angle and rate have 1."""
    effort: float = 0.01
    """Weight of each plate acceleration."""

    @cached_property
    def gains(self) -> Array:
        """K, shape (2, 8), for x = (x, x', phi, phi', y, y', theta, theta')."""
        A, B, _ = self.model.linear()
        Q = np.diag([self.position, 1.0, 1.0, 1.0] * 2)
        return control.lqr(A, B, Q, self.effort * np.eye(2))[0]

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations (phi'', theta'') in rad/s^2, shape (..., 2)."""
        desired = np.zeros_like(x)
        desired[..., 0::4], desired[..., 1::4] = reference(t)[:2]
        return -(x - desired) @ self.gains.T
