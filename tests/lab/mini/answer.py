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
        return np.zeros_like(x[..., :2])

    def memory_rate(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        return 2.0 * (reference(t)[0] - x[..., 0::4])
