"""The exact model (5.9) as a plant: the clean simulation a controller is designed on."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controllers.arrays import Array, Mask, Number, put
from controllers.ballplate import BallPlate
from twin.errors import ModelError
from twin.hal.interface import SCREEN
from twin.sim.plant.ball_motion import BallMotion
from twin.sim.plant.friction import Friction
from twin.sim.plant.level import tilted_gravity
from twin.sim.plant.rolling import Rolling, rolling

EDGES = SCREEN[0] / 2, SCREEN[1] / 2
"""Where the screen ends along x and y, m."""


class ExactPlant:
    """N copies of the exact model, the balls integrated by RK4 at the physics step.

    The servos are ideal: within one call of ``advance`` each plate rate runs linearly from its
    present value to the commanded one, so the plate acceleration is constant over a control period
    and the plate's motion is known in closed form.

    One formula is calculated with arrays for several rigs and, where nothing depends on the ball's
    place or past, with plain numbers for one: several times faster and the same to the last bit.

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
        self.rigs = rigs
        self.step = step
        self._equip(model or BallPlate(), friction, level)
        self.start(np.zeros((rigs, 4)))

    def change(self, model: BallPlate, friction: Friction | None, level: ArrayLike) -> None:
        """Go on with another ball, friction and level; arguments as when it was made."""
        before = self._balls
        self._equip(model, friction, level)
        self._balls.go_on(before, self._x)

    def _equip(self, model: BallPlate, friction: Friction | None, level: ArrayLike) -> None:
        self.model, self.friction = model, friction
        self._balls = BallMotion(model, friction, rigs=self.rigs, step=self.step)
        self._single = self._balls.single
        gravity = tilted_gravity(level, model.gravity).T
        self._gravity: Any = gravity.ravel().tolist() if self._single else gravity

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
        self._balls.start(self._x)
        self._fallen = np.zeros(self.rigs, bool)

    def begin(self, rigs: NDArray[np.integer], ball: Array, spin: Number = 0.0) -> None:
        """Put some rigs to the start as ``start`` does, the others as they are.

        Raises:
            ModelError: If a ball is to spin.
        """
        if np.any(spin):
            raise ModelError("the exact equations have a ball that never spins")
        fresh = np.zeros((len(rigs), 8))
        fresh[:, (0, 1, 4, 5)] = ball
        self._x = put(self._x, rigs, fresh)
        self._balls.begin(rigs, self._x)
        self._fallen[rigs] = False

    def place(self, ball: Array) -> None:
        """Put the balls at (x, x', y, y') on plates that stay as they are, shape (N, 4)."""
        self._x = self._x.copy()
        self._x[:, (0, 1, 4, 5)] = ball
        self._balls.straighten()
        self._fallen = np.zeros(self.rigs, bool)

    def resume(self, x: Array, age: Array | None = None) -> None:
        """Go on from any states x of (5.5), shape (N, 8), the balls on the screen.

        Args:
            x: The states.
            age: Ages of the contacts, shape (N,), where friction has them; None for long settled.
        """
        self._x = np.array(x, float)
        self._fallen = np.zeros(self.rigs, bool)
        self._balls.settle(self._x, None if age is None else np.array(age, float))

    @property
    def age(self) -> Array | None:
        """Ages of the contacts, shape (N,), where friction has them."""
        return self._balls.age

    def advance(self, motor_rate: Array, steps: int) -> None:
        """Ramp to the plate rates (rad/s, shape (N, 2)) over a number of physics steps."""
        x, vx, phi, phi_rate, y, vy, theta, theta_rate = self._components(self._x)
        to_phi, to_theta = self._components(motor_rate)
        period, half = steps * self.step, self.step / 2
        u = (to_phi - phi_rate) / period, (to_theta - theta_rate) / period
        plate = (phi, theta), (phi_rate, theta_rate), u
        equations = self._along(plate, [half * i for i in range(2 * steps + 1)])
        for i in range(0, 2 * steps, 2):
            x, vx, y, vy = self._balls.step((x, vx, y, vy), *equations[i : i + 3])
        (phi, theta), (phi_rate, theta_rate) = _turned(plate, period)
        self._x = self._state(x, vx, phi, phi_rate, y, vy, theta, theta_rate)
        off = (abs(x) > EDGES[0]) | (abs(y) > EDGES[1])
        if self._balls.by.any(off):
            self._fallen |= off

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

    def _components(self, array: Array) -> Any:
        """The columns of an array (N, k): k numbers for one rig, else k arrays (N,)."""
        return array[0].tolist() if self._single else array.T.copy()

    def _state(self, *components: Any) -> Array:
        """The reverse for a state, shape (N, 8)."""
        if self._single:
            return np.array([components])
        return np.array(components).T.copy()

    def _along(self, plate: Any, times: list[float]) -> list[Rolling]:
        """The ball's equations at each time of the plate's (angles, rates, accelerations)."""
        if not self._single:
            angle, rate = _turned(plate, np.array(times)[:, None])
            table = rolling(self.model, np.sin(angle), np.cos(angle), rate, plate[2], self._gravity)
            return [Rolling(*each) for each in zip(*table, strict=True)]
        angles, rates = zip(*(_turned(plate, time) for time in times), strict=True)
        # numpy's sine here too: the math module's need not have the same last bits
        all_angles = np.array(angles)
        trig = zip(np.sin(all_angles).tolist(), np.cos(all_angles).tolist(), rates, strict=True)
        return [rolling(self.model, *each, plate[2], self._gravity) for each in trig]


def _turned(plate: Any, time: Any) -> tuple[Any, Any]:
    """Plate angles and rates, each of (phi, theta), after a time of constant acceleration.

    Args:
        plate: Angles, rates and accelerations of (phi, theta) to begin with.
        time: In s.
    """
    (phi, theta), (wy, w7), (u1, u2) = plate
    return (
        (phi + time * (wy + time / 2 * u1), theta + time * (w7 + time / 2 * u2)),
        (wy + time * u1, w7 + time * u2),
    )
