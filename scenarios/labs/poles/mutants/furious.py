"""A mistake: weights without measure: the goal is reached, whatever it costs the drives.

# fails: no more effort than it takes
"""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import control
import numpy as np

from ballplate.laws import Array, Law, Reference


@dataclass(frozen=True, kw_only=True)
class Poles(Law):
    """u = -K (x - goal) on each axis, on a model that was linearised by hand."""

    name: ClassVar[str] = "poles"

    # weights of position, velocity, angle and rate; that of the plate's acceleration is 1
    weights: tuple[float, float, float, float] = (100_000.0, 3000.0, 1.0, 1.0)

    def plant(self, sign: float) -> tuple[Array, Array]:
        """A, shape (4, 4), and B, (4, 1), of one axis: position, velocity, angle, rate.

        Args:
            sign: +1 along x, where a positive angle moves the ball ahead; -1 along y.
        """
        k1, c2 = self.model.k1, self.model.c2
        A, B = np.zeros((4, 4)), np.zeros((4, 1))
        A[0, 1], A[1, 2], A[2, 3] = 1.0, sign * k1, 1.0
        B[1, 0], B[3, 0] = -sign * c2, 1.0
        return A, B

    @cached_property
    def gains(self) -> Array:
        """K of both axes on (position, velocity, angle, rate), shape (2, 4)."""
        K = np.zeros((2, 4))
        for axis, sign in enumerate((1.0, -1.0)):
            A, B = self.plant(sign)
            K[axis] = control.lqr(A, B, np.diag(self.weights), [[1.0]])[0]
        return K

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations (phi'', theta'') in rad/s^2, shape (..., 2)."""
        off = np.array(x)
        off[..., 0::4] -= reference(t)[0]
        return np.stack([-off[..., :4] @ self.gains[0], -off[..., 4:] @ self.gains[1]], axis=-1)
