"""The small interfaces behind a rig: two servos with plate encoders, a touch screen, a clock."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from controllers.arrays import Array, Mask

SCREEN = (0.70, 0.395)
"""Size of the touch screen along x and y in m, thesis chapter 3."""


class Touch(NamedTuple):
    """The newest ball position a touch screen has reported.

    Attributes:
        position: Ball in plate axes, m, shape (N, 2).
        age: Seconds since it arrived, shape (N,).
        touched: Whether the screen feels the ball, shape (N,).
    """

    position: Array
    age: Array
    touched: Mask


class Servos(Protocol):
    """Two velocity-controlled servo axes and the encoders on the plate, ordered (phi, theta)."""

    def plate(self) -> Array:
        """Plate angles from the plate encoders in rad, shape (N, 2)."""

    def motor(self) -> Array:
        """Motor shaft angles in rad, shape (N, 2)."""

    def command(self, motor_rate: Array) -> None:
        """Command the motor shaft rates in rad/s, shape (N, 2), until the next command."""


class TouchScreen(Protocol):
    """A touch screen that never makes its caller wait."""

    def read(self) -> Touch:
        """The newest sample."""


class Clock(Protocol):
    """Time as the loop sees it."""

    @property
    def time(self) -> float:
        """Seconds since the start."""

    def wait(self) -> None:
        """Return at the beginning of the next control period."""


class Transmission(Protocol):
    """Maps plate angles to motor angles."""

    def motor(self, plate: Array) -> Array:
        """Motor angles that hold the plate angles (phi, theta), both rad, (..., 2)."""
