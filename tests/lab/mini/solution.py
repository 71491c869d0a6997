"""Two loops: position asks for an acceleration, the plate follows."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ballplate.laws import Array, Law, Reference

START = 0.07  # told: plant.start.x


@dataclass(frozen=True, kw_only=True)
class Mine(Law):
    """A cascade with an integrator."""

    name: ClassVar[str] = "mine"
    memory: ClassVar[int] = 2

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        # BEGIN SOLUTION
        r = reference(t)
        position, velocity, angle, rate = (x[..., i::4] for i in range(4))
        wanted = 4.0 * (r[0] - position) - 3.2 * velocity + q
        goal = np.array([1.0, -1.0]) * wanted / self.model.k1
        return 120.0 * (goal - angle) - 20.0 * rate
        # END SOLUTION
        # BEGIN STARTER
        # return np.zeros_like(x[..., :2])
        # END STARTER

    def memory_rate(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        return 2.0 * (reference(t)[0] - x[..., 0::4])
