"""A law of one's own: from the state to the plate's accelerations."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ballplate.laws import Array, Law, Reference


@dataclass(frozen=True, kw_only=True)
class Blank(Law):
    """Say here what it does."""

    name: ClassVar[str] = "blank"

    gain: float = 1.0
    """A setting: controller.gain in a scenario, a slider in `ballplate play`."""

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations (phi'', theta'') in rad/s^2, shape (..., 2)."""
        # x has the last axis (x, x', phi, phi', y, y', theta, theta'), in m and rad
        position, velocity, angle, rate = (x[..., i::4] for i in range(4))  # both axes of each
        desired = reference(t)[0]  # and its derivatives: reference(t)[1], ...
        del position, velocity, desired  # this one only brings the plate level
        return -self.gain * (60.0 * angle + 14.0 * rate) + np.zeros(2)
