"""The closed loop in continuous time: exact model, law, observer, dead time and held noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controllers.arrays import Array
from controllers.interfaces import Law, Reference
from controllers.per_rig import Now
from twin.thesis.reproduce.estimators import OUTPUTS, Estimator
from twin.thesis.reproduce.noise import Noise

BALL = (0, 4)
"""Where the ball's position stands in the state."""


@dataclass(frozen=True, kw_only=True)
class Loop:
    """N closed loops, integrated by RK4 with a step that divides the noise's intervals.

    The delayed ball position lies between two steps; there the cubic through both values and
    slopes is taken, which is as exact as the integration itself.

    Attributes:
        law: The law of all rigs.
        reference: The paths it follows.
        estimator: The observer; None for full state feedback.
        dead_time: Delay of the measured ball position in s.
        predicted: Whether the observer knows: its own ball position is delayed alike (7.19).
        noise: Measurement noise and disturbance; None for none.
        step: Step of the integration in s.
    """

    law: Law
    reference: Reference
    rigs: int
    estimator: Estimator
    dead_time: float = 0.0
    predicted: bool = False
    noise: Noise | None = None
    step: float = 0.005

    def run(self, duration: float) -> tuple[Array, Array, Array]:
        """State (K, N, 8), estimate (K, N, 8) and wished input (K, N, 2) at every step."""
        h, steps = self.step, round(duration / self.step)
        memory = self.estimator.start(self.rigs)
        z = np.concatenate((np.zeros((self.rigs, 16 + self.law.memory)), memory), axis=1)
        past = np.zeros((2, steps + 1, self.rigs, 2, 2))  # value and slope of whose ball, x and y
        x, xhat = (np.zeros((steps + 1, self.rigs, 8)) for _ in range(2))
        u = np.zeros((steps + 1, self.rigs, 2))
        for k in range(steps + 1):
            t = k * h
            v, w = self._noise(k)
            x[k], xhat[k] = z[:, :8], z[:, 8:16]
            past[0, k] = z[:, :16].reshape(-1, 2, 8)[..., BALL]
            k1, u[k] = self._rate(t, z, self._late(past, t), v, w)
            past[1, k] = k1[:, :16].reshape(-1, 2, 8)[..., BALL]
            middle = self._late(past, t + h / 2)
            k2, _ = self._rate(t + h / 2, z + h / 2 * k1, middle, v, w)
            k3, _ = self._rate(t + h / 2, z + h / 2 * k2, middle, v, w)
            k4, _ = self._rate(t + h, z + h * k3, self._late(past, t + h), v, w)
            z = z + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return x, xhat, u

    def _noise(self, step: int) -> tuple[Array, Array]:
        """Measurement noise (N, 4) and disturbance (N, 2) during a step."""
        if self.noise is None:
            return np.zeros(4), np.zeros(2)
        interval = step // round(self.noise.hold / self.step)
        return self.noise.measured[interval], self.noise.disturbance[interval]

    def _late(self, past: Array, t: float) -> Array | None:
        """Ball of plant and of estimate a dead time ago, shape (N, 2, 2); None without one."""
        if not self.dead_time:
            return None
        place = (t - self.dead_time) / self.step
        if place <= 0:
            return np.zeros((self.rigs, 2, 2))
        k = int(place + 1e-9)
        s = place - k
        value, slope = past[:, k : k + 2]
        a, b = self.step * s * (1 - s) ** 2, self.step * s**2 * (s - 1)
        rise = s * s * (3 - 2 * s)
        late: Array = value[0] + rise * (value[1] - value[0]) + a * slope[0] + b * slope[1]
        return late

    def _rate(
        self, t: float, z: Array, late: Array | None, v: Array, w: Array
    ) -> tuple[Array, Array]:
        """Slope of everything, and the input."""
        q_end = 16 + self.law.memory
        x, xhat, q, memory = z[:, :8], z[:, 8:16], z[:, 16:q_end], z[:, q_end:]
        reference = Now(self.reference(t))
        u = self.law.control(t, xhat, reference, q)
        y, yhat = x[:, OUTPUTS] + v, xhat[:, OUTPUTS]
        if late is not None:
            y[:, 0::2] = late[:, 0] + v[..., 0::2]
            if self.predicted:
                yhat = yhat.copy()
                yhat[:, 0::2] = late[:, 1]
        slope = np.empty_like(z)
        slope[:, :8] = self.estimator.model.derivative(x, u + w)
        slope[:, 8:16], slope[:, q_end:] = self.estimator.rate(xhat, memory, u, y - yhat)
        slope[:, 16:q_end] = self.law.memory_rate(t, xhat, reference, q)
        return slope, u
