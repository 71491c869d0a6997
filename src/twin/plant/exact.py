"""The exact model (5.9) as a plant: the clean simulation a controller is designed on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from controllers.ballplate import BallPlate
from twin.plant.friction import RollingFriction

Array = NDArray[np.floating]
Mask = NDArray[np.bool_]

SCREEN = (0.70, 0.395)
"""Size of the screen along x and y in m, thesis chapter 3."""


class ExactPlant:
    """N copies of the exact model, integrated by RK4 at the physics step.

    The servos are ideal: within one call of ``advance`` each plate rate runs linearly from its
    present value to the commanded one, so the plate acceleration is constant over a control period.

    Args:
        model: Parameters of ball and plate.
        rigs: Number of copies.
        step: Physics step in s.
        friction: Rolling resistance; None for the thesis's frictionless ball.
    """

    ratio = 1.0
    channels: tuple[str, ...] = ()

    def __init__(
        self,
        model: BallPlate | None = None,
        *,
        rigs: int = 1,
        step: float = 0.001,
        friction: RollingFriction | None = None,
    ) -> None:
        self.model = model or BallPlate()
        self.rigs = rigs
        self.step = step
        self.friction = friction
        self._x: Array = np.zeros((rigs, 8))
        self._fallen = np.zeros(rigs, bool)

    def start(self, ball: Array) -> None:
        """Put every plate level and at rest with its ball at (x, x', y, y'), shape (N, 4)."""
        self._x = np.zeros((self.rigs, 8))
        self._x[:, (0, 1, 4, 5)] = ball
        self._fallen = np.zeros(self.rigs, bool)

    def advance(self, motor_rate: Array, steps: int) -> None:
        """Ramp to the plate rates (rad/s, shape (N, 2)) over a number of physics steps."""
        u = (motor_rate - self._x[:, 3::4]) / (steps * self.step)
        for _ in range(steps):
            self._x = self._integrate(self._x, u)
        half = np.abs(self._x[:, 0::4]) > np.divide(SCREEN, 2)
        self._fallen |= half[:, 0] | half[:, 1]

    @property
    def state(self) -> Array:
        """True state in the order of (5.5), shape (N, 8)."""
        return self._x

    @property
    def motor(self) -> Array:
        """Plate angles (phi, theta): the ideal servos turn the plate itself, shape (N, 2)."""
        return self._x[:, 2::4]

    @property
    def on_plate(self) -> Mask:
        """Whether the ball has never left the screen, shape (N,)."""
        return ~self._fallen

    def telemetry(self) -> Array:
        """Nothing beyond the state, shape (N, 0)."""
        return self._x[:, :0]

    def _rate(self, x: Array, u: Array) -> Array:
        rate = self.model.derivative(x, u)
        if self.friction is not None:
            rate[:, 1::4] = self.friction.resist(self.model, x, rate[:, 1::4])
        return rate

    def _integrate(self, x: Array, u: Array) -> Array:
        h = self.step
        k1 = self._rate(x, u)
        k2 = self._rate(x + h / 2 * k1, u)
        k3 = self._rate(x + h / 2 * k2, u)
        k4 = self._rate(x + h * k3, u)
        after = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        if self.friction is not None:
            self._bring_to_rest(x, after, u)
        return after

    def _bring_to_rest(self, before: Array, after: Array, u: Array) -> None:
        """Stop a ball whose last speed friction takes away within this step, and that it holds."""
        assert self.friction is not None
        limit = self.friction.deceleration(self.model, before)
        slow = np.hypot(before[:, 1], before[:, 5]) <= limit * self.step
        if slow.any():
            free = self.model.derivative(before, u)[:, 1::4]
            held = slow & (np.hypot(free[:, 0], free[:, 1]) <= limit)
            after[held, 1::4] = 0.0
