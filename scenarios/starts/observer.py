"""An alpha-beta observer: every coordinate by itself, its velocity from its own innovation."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ballplate.observers import Array, Measurement, Observer


@dataclass(kw_only=True)
class AlphaBeta(Observer):
    """Two gains for the ball's coordinates, two for the plate's."""

    name: ClassVar[str] = "alpha_beta"

    ball: tuple[float, float] = (0.04, 0.0004)
    """Shares of the innovation that correct position and, per period, velocity."""
    plate: tuple[float, float] = (0.24, 0.0144)
    """The same of angle and rate."""

    def __post_init__(self) -> None:
        """Check the ranges of the settings and take the linear model of one period."""
        super().__post_init__()
        A, B, _ = self.model.linear()
        self._step = np.eye(8) + self.period * A
        self._input = self.period * B
        self._alpha, self._beta = np.array([self.ball, self.plate] * 2).T

    def correct(self, measurement: Measurement) -> Array:
        """The estimate at a measurement; what the screen does not detect corrects nothing."""
        e = measurement.y - self.x[..., 0::2]
        e[~measurement.touched, 0::2] = 0
        self.x = self.x.copy()
        self.x[..., 0::2] += self._alpha * e
        self.x[..., 1::2] += self._beta / self.period * e
        return self.x

    def predict(self, u: Array) -> None:
        """One period ahead under the applied accelerations u, shape (..., 2)."""
        self.x = self.x @ self._step.T + u @ self._input.T
