"""Lab `signs`: a PD of the ball, written by hand."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ballplate.laws import Array, Law, Reference


@dataclass(frozen=True, kw_only=True)
class Signs(Law):
    """The ball asks for an angle of the plate; the plate is brought there."""

    name: ClassVar[str] = "signs"

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations (phi'', theta'') in rad/s^2, shape (..., 2)."""
        # ball: position in m and velocity in m/s, along x and along y
        ball_x, ball_y = x[..., 0], x[..., 4]
        speed_x, speed_y = x[..., 1], x[..., 5]
        # goal: position in m
        goal = reference(t)[0]
        goal_x, goal_y = goal[..., 0], goal[..., 1]

        # the angles to which the plate shall be tilted, in rad
        phi = np.zeros_like(ball_x)
        theta = np.zeros_like(ball_y)
        # BEGIN SOLUTION
        kp, kd = 4.0, 3.4  # 1/s^2 and 1/s: natural frequency 2 rad/s, damping 0.85
        phi = (kp * (goal_x - ball_x) - kd * speed_x) / self.model.k1
        theta = -(kp * (goal_y - ball_y) - kd * speed_y) / self.model.k1
        # END SOLUTION

        # given: a PD of the plate itself, far faster than the ball
        wanted = np.clip(np.stack([phi, theta], axis=-1), -0.14, 0.14)
        return 144.0 * (wanted - x[..., 2::4]) - 24.0 * x[..., 3::4]
