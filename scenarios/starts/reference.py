"""A reference that moves away at a constant velocity."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ballplate.references import Array, Reference


@dataclass(frozen=True, kw_only=True)
class Drift(Reference):
    """From the centre at a constant velocity."""

    name: ClassVar[str] = "drift"

    rate: tuple[float, float] = (0.01, 0.0)
    """Velocity (x', y') in m/s."""

    def __call__(self, t: float | Array) -> Array:
        """Position and four derivatives at t, shape (5, *shape(t), 2)."""
        out = np.zeros((5, *np.shape(t), 2))
        out[0] = np.multiply.outer(t, self.rate)
        out[1] = self.rate
        return out
