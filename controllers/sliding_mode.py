"""Nested fourth-order sliding mode with a sigmoid in place of the sign, (6.97)-(6.103)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from controllers.ballplate import SIGN, desired
from controllers.interfaces import Array, Law, Reference
from controllers.ranges import Positive

POWERS = np.array((3.0, 4.0, 6.0))
ROOTS = np.array((1 / 4, 1 / 6, 1 / 12))
"""N_i of (2.55), r = 4, q = 12: root of the sum of the first i of |s|^3, |s'|^4, |s''|^6."""


@dataclass(frozen=True, kw_only=True)
class SlidingMode(Law):
    """u = -alpha Psi for x (6.101e) and, corrected, u = +alpha Psi for y (6.102e).

    Psi is nested: Psi_0 = sigmoid(s), Psi_i = sigmoid(s^(i) + beta_i N_i Psi_(i-1)), with s the
    tracking error of the axis and s^(i) its derivatives on the flat model.

    Raises:
        ValueError: If a setting is not a positive number, or the betas are not three.
    """

    name: ClassVar[str] = "sliding_mode"

    alpha: Positive = 1.5
    """Largest plate acceleration in rad/s^2. The thesis prints alpha = -1.5 and one sign for both
    axes, with which one of them runs away; here alpha is the amplitude and positive."""
    betas: tuple[Positive, Positive, Positive] = (0.5, 1.0, 3.0)
    """Gains beta1 to beta3; the default is case 1 of Table 8.10."""
    epsilon: Positive = 0.1
    """Width of the sigmoid s / (|s| + epsilon) (2.52)."""

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations in rad/s^2, shape (..., 2)."""
        s = self.model.chain(x).z - desired(reference(t)[:4])
        pull = self.betas * np.add.accumulate(np.abs(s[..., :3]) ** POWERS, axis=-1) ** ROOTS
        psi = self._sigmoid(s[..., 0])
        for i in (1, 2, 3):
            psi = self._sigmoid(s[..., i] + pull[..., i - 1] * psi)
        return -self.alpha * SIGN * psi

    def _sigmoid(self, s: Array) -> Array:
        """Smooth stand-in for the sign (2.52)."""
        return s / (np.abs(s) + self.epsilon)
