"""Lab `NAME`: two loops, position asks for an angle of the plate, the plate follows."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ballplate.laws import Array, Law, Reference

LEVEL_DEG = 0.1  # told: plant.level_deg.0


@dataclass(frozen=True, kw_only=True)
class Own(Law):
    """A cascade; its memory q integrates the error of the position."""

    name: ClassVar[str] = "NAME"
    memory: ClassVar[int] = 2

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations (phi'', theta'') in rad/s^2, shape (..., 2)."""
        position, velocity, angle, rate = (x[..., i::4] for i in range(4))
        r = reference(t)  # position, velocity, acceleration, ... of the goal, each (x, y)
        # BEGIN SOLUTION
        wanted = 4.0 * (r[0] - position) - 3.2 * velocity + 2.0 * q
        # END SOLUTION
        # BEGIN STARTER
        # wanted = 0 * position  # acceleration of the ball in m/s^2 along x and y: yours
        # END STARTER
        goal = np.array([1.0, -1.0]) * wanted / self.model.k1  # x'' = k1 phi, y'' = -k1 theta
        goal = goal - np.radians([LEVEL_DEG, 0.0])  # as the sheet tells
        return 120.0 * (goal - angle) - 20.0 * rate

    def memory_rate(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """What q grows by in a second: the error of the position in m, shape (..., 2)."""
        return reference(t)[0] - x[..., 0::4]
