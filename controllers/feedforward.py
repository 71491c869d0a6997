"""Feed-forward from the flat model with linear feedback about its trajectory, Figure 6.2."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from controllers.interfaces import Array, Law, Reference
from controllers.poles import Pole, stable_poles
from controllers.ranges import NotNegative, Positive
from controllers.state_feedback import optimal, placed, weights

STEEPEST = 0.5
"""Sine of the steepest plate angle fed forward, 30 deg: more than the plate reaches, and far from
90 deg, where the rate would be divided by zero."""


@dataclass(frozen=True, kw_only=True)
class Feedforward(Law):
    """u = u_ff + K (x* - x): the inputs and states that make the flat model follow the reference.

    A reference that accelerates faster than a plate inclined by 30 deg can make the ball do is fed
    forward as if at that angle.

    Raises:
        ValueError: If the poles or weights are not allowed, or both are given.
    """

    name: ClassVar[str] = "feedforward"

    poles: tuple[Pole, ...] | None = None
    """Four closed-loop poles for each axis in 1/s; given, they replace ``rho`` and ``kappa``."""
    rho: Positive = 300.0
    """Weight of the state against the input (6.11)."""
    kappa: NotNegative = 0.3
    """Weight of the rates against the positions (6.11)."""

    K: Array = field(init=False, repr=False, compare=False)
    """Feedback gain, shape (2, 8)."""

    def __post_init__(self) -> None:
        """Check the settings and compute the feedback gain once."""
        super().__post_init__()
        A, B, _ = self.model.linear()
        if self.poles is None:
            K = optimal(A, B, weights(self.rho, self.kappa), (1.0, 1.0))
        elif (self.rho, self.kappa) == (Feedforward.rho, Feedforward.kappa):
            object.__setattr__(self, "poles", stable_poles(self.poles, 4))
            K = placed(A, B, (*self.poles, *self.poles))
        else:
            raise ValueError("poles replace rho and kappa: give either poles or rho and kappa")
        object.__setattr__(self, "K", K)

    def trajectory(self, r: Array) -> tuple[Array, Array]:
        """State and input of the flat model that follows the reference, (6.46) and (6.47).

        Args:
            r: Position and four derivatives of the reference, shape (5, ..., 2).

        Returns:
            x*, shape (..., 8), and u_ff in rad/s^2, shape (..., 2).
        """
        k = self.model.k
        sine = np.minimum(np.maximum(r[2] / k, -STEEPEST), STEEPEST)
        a = k * np.sqrt(1 - sine * sine)
        rate = r[3] / a
        x = np.empty((*r.shape[1:-1], 8))
        x[..., 0::4] = r[0]
        x[..., 1::4] = r[1]
        x[..., 2::4] = np.arcsin(sine)
        x[..., 3::4] = rate
        return x, (r[4] + r[2] * rate * rate) / a

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations u_ff + K (x* - x) in rad/s^2, shape (..., 2)."""
        desired, u = self.trajectory(reference(t))
        out: Array = u + (desired - x) @ self.K.T
        return out
