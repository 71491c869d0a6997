"""What every simulated plant offers to the rig that drives it.

Some rigs of a plant as a plant, for those that begin while the others go on.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array, Mask, Number, put
from twin.settings import setting


@dataclass(frozen=True, kw_only=True)
class BallStart:
    """Where the ball begins on the level plate; fields may be arrays with one entry per rig.

    Attributes:
        x: Position along x in plate axes, m.
        y: Along y, m.
        x_rate: Speed along x, m/s; the ball rolls.
        y_rate: Along y, m/s.
        spin: Rate about the vertical, rad/s.
    """

    x: Number = setting("plant.start.x", 0.0, ge=-0.35, le=0.35)
    y: Number = setting("plant.start.y", 0.0, ge=-0.1975, le=0.1975)
    x_rate: Number = setting("plant.start.x_rate", 0.0)
    y_rate: Number = setting("plant.start.y_rate", 0.0)
    spin: Number = setting(
        "plant.start.spin", 0.0, ge=-500, le=500, exact="have a ball that never spins"
    )

    @property
    def ball(self) -> Array:
        """(x, x', y, y') in m and m/s, shape (4,) or (N, 4)."""
        return np.stack(np.broadcast_arrays(self.x, self.x_rate, self.y, self.y_rate), axis=-1)


class Plant(Protocol):
    """N ball-and-plate mechanisms advanced together; two-vectors are ordered (phi, theta).

    Attributes:
        rigs: Number N of mechanisms.
        step: Physics step in s.
        ratio: Motor angle per plate angle about level, dimensionless.
        channels: Names of the columns of ``telemetry``, each ending in its unit.
    """

    rigs: int
    step: float
    ratio: float
    channels: tuple[str, ...]

    def start(self, ball: Array, spin: Number = 0.0) -> None:
        """Put every plate level and at rest with its ball at (x, x', y, y'), shape (N, 4).

        Args:
            ball: Positions in m and speeds in m/s of the rolling balls.
            spin: Their rates about the vertical, rad/s; 0 on plants whose ball cannot spin.
        """

    def begin(self, rigs: NDArray[np.integer], ball: Array, spin: Number = 0.0) -> None:
        """Put some rigs to the start as ``start`` does, the others as they are.

        Args:
            rigs: Their numbers, shape (k,).
            ball: (x, x', y, y') of their balls in m and m/s, shape (k, 4).
            spin: Their rates about the vertical, rad/s.
        """

    def place(self, ball: Array) -> None:
        """Put the balls, rolling, at (x, x', y, y') on plates that stay as they are, (N, 4).

        Positions in m, speeds in m/s, in plate axes.
        """

    def advance(self, motor_rate: Array, steps: int) -> None:
        """Hold the motor rates (rad/s, shape (N, 2)) for a number of physics steps."""

    @property
    def state(self) -> Array:
        """True state in the order of (5.5), shape (N, 8), at the present instant."""

    @property
    def motor(self) -> Array:
        """Motor shaft angles in rad, shape (N, 2), as the motor encoders give them."""

    @property
    def on_plate(self) -> Mask:
        """Whether the ball touches the screen's surface area (not fallen off), shape (N,)."""

    @property
    def diverged(self) -> Mask:
        """Whether the numbers have run away at some time since the start, shape (N,)."""

    def telemetry(self) -> Array:
        """Further true quantities for the record, shape (N, channels)."""


class SomeRigs:
    """Some rigs of a plant, that may be looked at and put somewhere; time passes for all alike.

    Args:
        plant: All of them.
        which: Numbers of those, shape (k,).
    """

    def __init__(self, plant: Plant, which: NDArray[np.integer]) -> None:
        self._plant, self._which = plant, which
        self.rigs, self.step, self.ratio = len(which), plant.step, plant.ratio
        self.channels = plant.channels

    def start(self, ball: Array, spin: Number = 0.0) -> None:
        """Put these rigs to the start with their balls at (x, x', y, y'), shape (k, 4)."""
        self._plant.begin(self._which, ball, spin)

    def begin(self, rigs: NDArray[np.integer], ball: Array, spin: Number = 0.0) -> None:
        """Put some of these to the start."""
        self._plant.begin(self._which[rigs], ball, spin)

    def place(self, ball: Array) -> None:
        """Put these balls at (x, x', y, y') on plates that stay as they are, shape (k, 4)."""
        self._plant.place(put(self._plant.state[:, (0, 1, 4, 5)], self._which, ball))

    def advance(self, motor_rate: Array, steps: int) -> None:
        """Not possible of some rigs alone.

        Raises:
            TypeError: Always.
        """
        raise TypeError("the rigs of a plant are advanced together")

    @property
    def state(self) -> Array:
        """Their true states, shape (k, 8)."""
        return self._plant.state.take(self._which, axis=0)

    @property
    def motor(self) -> Array:
        """Their motor shaft angles in rad, shape (k, 2)."""
        return self._plant.motor.take(self._which, axis=0)

    @property
    def on_plate(self) -> Mask:
        """Whether their balls are on the screen, shape (k,)."""
        return self._plant.on_plate.take(self._which, axis=0)

    @property
    def diverged(self) -> Mask:
        """Whether their numbers have run away, shape (k,)."""
        return self._plant.diverged.take(self._which, axis=0)

    def telemetry(self) -> Array:
        """Their further true quantities, shape (k, channels)."""
        return self._plant.telemetry().take(self._which, axis=0)
