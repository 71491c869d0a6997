"""The exact model (5.9) as a plant: the clean simulation a controller is designed on."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from controllers.arrays import Array, Mask, Number
from controllers.ballplate import BallPlate
from twin.errors import ModelError
from twin.hal.interface import SCREEN
from twin.sim.plant.friction import Friction
from twin.sim.plant.level import in_plate, tilted_gravity


class ExactPlant:
    """N copies of the exact model, integrated by RK4 at the physics step.

    The servos are ideal: within one call of ``advance`` each plate rate runs linearly from its
    present value to the commanded one, so the plate acceleration is constant over a control period.

    Args:
        model: Parameters of ball and plate.
        rigs: Number of copies.
        step: Physics step in s.
        friction: Rolling resistance; None for the thesis's frictionless ball.
        level: Tilt (phi, theta) in rad of the base the plate angles are measured against, shape
            (2,) or (N, 2).
    """

    ratio = 1.0
    channels: tuple[str, ...] = ()

    def __init__(
        self,
        model: BallPlate | None = None,
        *,
        rigs: int = 1,
        step: float = 0.001,
        friction: Friction | None = None,
        level: ArrayLike = (0.0, 0.0),
    ) -> None:
        self.model = model or BallPlate()
        self.rigs = rigs
        self.step = step
        self.friction = friction
        self._ageing = friction is not None and friction.ageing
        self._sloping = friction is not None and friction.map is not None and friction.map.sloping
        tilted = np.any(level) or self._sloping
        self._gravity = tilted_gravity(level, self.model.gravity) if tilted else None
        self.start(np.zeros((rigs, 4)))

    def start(self, ball: Array, spin: Number = 0.0) -> None:
        """Put every plate level and at rest with its ball at (x, x', y, y'), shape (N, 4).

        A ball at rest is taken to have rested long.

        Raises:
            ModelError: If a ball is to spin.
        """
        if np.any(spin):
            raise ModelError("the exact equations have a ball that never spins")
        self._x: Array = np.zeros((self.rigs, 8))
        self._x[:, (0, 1, 4, 5)] = ball
        self._age: Array | None = None
        if self._ageing:
            assert self.friction is not None
            self._age = self.friction.settled(np.hypot(self._x[:, 1], self._x[:, 5]))
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

    @property
    def diverged(self) -> Mask:
        """Whether the state is no longer finite, shape (N,)."""
        return np.asarray(~np.isfinite(self._x).all(axis=1))

    def telemetry(self) -> Array:
        """Nothing beyond the state, shape (N, 0)."""
        return self._x[:, :0]

    def _free(self, x: Array, u: Array) -> tuple[Array, Array | None]:
        """Rate of the state without resistance, and the normal force per mass if not g cos cos."""
        rate = self.model.derivative(x, u)
        if self._gravity is None:
            return rate, None
        k1, phi, theta = self.model.k1, x[..., 2], x[..., 6]
        pull = in_plate(self._gravity, phi, theta)
        normal = -pull[..., 2]
        force = self.model.c1 * pull[..., :2]
        if self._sloping:
            assert self.friction is not None
            assert self.friction.map is not None
            slope = self.friction.map(x[..., 0::4])[1]
            force = force - self.model.c1 * normal[..., None] * slope
        # the model's own pull of gravity, k1 (sin phi cos theta, -sin theta), gives way to this one
        rate[..., 1] += force[..., 0] - k1 * np.sin(phi) * np.cos(theta)
        rate[..., 5] += force[..., 1] + k1 * np.sin(theta)
        return rate, normal

    def _rate(self, x: Array, u: Array) -> Array:
        rate, normal = self._free(x, u)
        if self.friction is not None:
            rate[:, 1::4] = self.friction.resist(self.model, x, rate[:, 1::4], self._age, normal)
        return rate

    def _integrate(self, x: Array, u: Array) -> Array:
        h = self.step
        k1 = self._rate(x, u)
        k2 = self._rate(x + h / 2 * k1, u)
        k3 = self._rate(x + h / 2 * k2, u)
        k4 = self._rate(x + h * k3, u)
        after = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        if self.friction is not None:
            self._bring_to_rest(self.friction, x, after, u)
        if self._age is not None:
            assert self.friction is not None
            speed = np.hypot(x[:, 1] + after[:, 1], x[:, 5] + after[:, 5]) / 2
            self._age = self.friction.aged(self._age, speed, h)
        return after

    def _bring_to_rest(self, friction: Friction, before: Array, after: Array, u: Array) -> None:
        """Stop a ball whose last speed friction takes away within this step, and that it holds."""
        limit = friction.deceleration(self.model, before, self._age)
        slow = np.hypot(before[:, 1], before[:, 5]) <= limit * self.step
        if slow.any():
            resting = before.copy()
            resting[:, 1::4] = 0.0
            rate, normal = self._free(resting, u)
            free = rate[:, 1::4]
            hold = friction.deceleration(self.model, resting, self._age, normal)
            held = slow & (np.hypot(free[:, 0], free[:, 1]) <= hold)
            after[held, 1::4] = 0.0
