"""Effects of the rig that wrap a plant or a transmission: lag, dither, coupling, cam errors."""

from __future__ import annotations

import math

import numpy as np

from controllers.arrays import Array, Mask
from twin.hal.rig import Transmission
from twin.sim.plant.interface import Plant


class Slow:
    """A plant whose motors follow with a lag of first order and tremble.

    Args:
        plant: The plant.
        period: Control period in s, in which ``advance`` is called.
        lag: Time constants in s, shape (N,).
        dither: Amplitudes of the plates' trembling in rad/s^2, shape (N,).
        frequency: Its frequency in Hz.
    """

    def __init__(
        self, plant: Plant, period: float, lag: Array, dither: Array, frequency: float
    ) -> None:
        self._plant = plant
        self.rigs, self.step, self.ratio = plant.rigs, plant.step, plant.ratio
        self.channels = plant.channels
        with np.errstate(divide="ignore"):
            self._share = (1 - np.exp(-period / lag))[:, None]
        self._rate = np.zeros((plant.rigs, 2))
        omega = 2 * math.pi * frequency
        self._tremor = plant.ratio * dither[:, None] / omega
        self._turn, self._tick = omega * period, 0

    def start(self, ball: Array) -> None:
        """Put every plate level and at rest with its ball at (x, x', y, y')."""
        self._plant.start(ball)

    def advance(self, motor_rate: Array, steps: int) -> None:
        """Command motor rates in rad/s, shape (N, 2), for a number of physics steps."""
        self._rate = self._rate + self._share * (motor_rate - self._rate)
        self._tick += 1
        phase = self._turn * self._tick
        swing = np.array([math.sin(phase), math.cos(phase)])
        self._plant.advance(self._rate + self._tremor * swing, steps)

    @property
    def state(self) -> Array:
        """True state, shape (N, 8)."""
        return self._plant.state

    @property
    def motor(self) -> Array:
        """Motor angles in rad, shape (N, 2)."""
        return self._plant.motor

    @property
    def on_plate(self) -> Mask:
        """Whether the ball is on the screen, shape (N,)."""
        return self._plant.on_plate

    @property
    def diverged(self) -> Mask:
        """Whether the numbers have run away, shape (N,)."""
        return self._plant.diverged

    def telemetry(self) -> Array:
        """The plant's."""
        return self._plant.telemetry()


class Wrong:
    """A transmission that turns the other axis, too, and each a little too far.

    Args:
        inner: The right transmission.
        coupling: Share of one axis's angle that turns the other, shape (N,).
        error: Relative error of the slope, shape (N,).
    """

    def __init__(self, inner: Transmission, coupling: Array, error: Array) -> None:
        self._inner = inner
        self._coupling, self._scale = coupling[:, None], 1 + error[:, None]

    def motor(self, plate: Array) -> Array:
        """Motor angles in rad for wished plate angles, shape (N, 2)."""
        return self._inner.motor(self._scale * plate + self._coupling * plate[..., ::-1])
