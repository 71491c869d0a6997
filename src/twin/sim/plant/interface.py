"""What every simulated plant offers to the rig that drives it."""

from __future__ import annotations

from typing import Protocol

from controllers.arrays import Array, Mask


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

    def start(self, ball: Array) -> None:
        """Put every plate level and at rest with its ball at (x, x', y, y'), shape (N, 4)."""

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
