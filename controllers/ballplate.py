"""The ball-and-plate model: exact (5.9), its Jacobians (7.15), linear (5.35) and flat (6.44)."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]

MEASURED = (0, 2, 4, 6)
"""Where the measurement y = (x, phi, y, theta) of (5.3) stands in the state (5.5)."""


class Linear(NamedTuple):
    """x' = A x + B u, y = C x about the level plate, (5.35) with the sign of B[6, 2] corrected."""

    A: Array
    B: Array
    C: Array


@dataclass(frozen=True, kw_only=True)
class BallPlate:
    """A ball rolling on a plate whose angular accelerations are the inputs.

    The state is x = (x, x', phi, phi', y, y', theta, theta') (5.5) in m, m/s, rad, rad/s, in plate
    axes; the input u = (phi'', theta'') (5.8) in rad/s^2. The rotation from plate to world is
    R = Rx(theta) Ry(phi) (4.5). Assumes rolling without slip, spin or rolling resistance.

    Raises:
        ValueError: If a parameter is not finite, or not positive where it must be.
    """

    mass: float = 0.024
    """Mass of the ball in kg, thesis A.2."""
    radius: float = 0.02
    """Radius of the ball in m, thesis A.2."""
    inertia: float = 6.4e-6
    """Moment of inertia of the ball in kg m^2, thesis A.2 (a thin hollow sphere)."""
    gravity: float = 9.81
    """Gravitational acceleration in m/s^2, thesis A.2."""
    height: float = 0.122
    """Distance d_cs from the cardan joint up to the surface in m, thesis A.2."""

    d: float = field(init=False, repr=False)
    """Height of the ball's centre above the cardan joint in m, (4.6)."""
    c1: float = field(init=False, repr=False)
    """Share of gravity that accelerates the ball, dimensionless, (5.1)."""
    c2: float = field(init=False, repr=False)
    """Lever of the plate acceleration in m, (5.1); also b of (6.41)."""
    c3: float = field(init=False, repr=False)
    """Lever of the gyroscopic coupling in m, (5.1)."""
    c4: float = field(init=False, repr=False)
    """c2 / c1 in m, (5.1)."""
    k1: float = field(init=False, repr=False)
    """Ball acceleration for a unit sine of the slope in m/s^2, (6.41)."""

    def __post_init__(self) -> None:
        """Check the parameters and derive the constants of (5.1)."""
        for name in ("mass", "radius", "inertia", "gravity", "height"):
            value = getattr(self, name)
            low = value >= 0 if name == "height" else value > 0
            if not (math.isfinite(value) and low):
                sign = "not negative" if name == "height" else "positive"
                raise ValueError(f"ball {name} must be finite and {sign}, got {value}")
        m, r, J = self.mass, self.radius, self.inertia
        d = self.height + r
        c1 = m * r**2 / (m * r**2 + J)
        derived = {
            "d": d,
            "c1": c1,
            "c2": (d * m * r**2 + J * r) / (m * r**2 + J),
            "c3": (J + 2 * d * m * r) / (m * r),
            "c4": (J + d * m * r) / (m * r),
            "k1": c1 * self.gravity,
        }
        for name, value in derived.items():
            object.__setattr__(self, name, value)

    def f(self, x: Array) -> Array:
        """Drift of the exact model (5.9b), shape (..., 8)."""
        sin, cos, (x1, x2, x3, x4, x5, x6, x7, x8) = _parts(x)
        s3, c3 = sin(x3), cos(x3)
        out = np.zeros_like(x)
        out[..., 0] = x2
        out[..., 1] = self.c1 * (
            -self.d * x8**2 * s3 * c3
            + x1 * x8**2 * s3**2
            + 2 * x6 * x8 * s3
            + x1 * x4**2
            + self.gravity * s3 * cos(x7)
        )
        out[..., 2] = x4
        out[..., 4] = x6
        out[..., 5] = self.c1 * (
            -self.c3 * x4 * x8 * s3
            - 2 * x1 * x4 * x8 * c3
            - 2 * x2 * x8 * s3
            + x5 * x8**2
            - self.gravity * sin(x7)
        )
        out[..., 6] = x8
        return out

    def g(self, x: Array) -> Array:
        """Input map of the exact model (5.9c), shape (..., 8, 2)."""
        sin, cos, (x1, _, x3, _, x5, *_) = _parts(x)
        out = np.zeros((*x.shape, 2))
        out[..., 1, 0] = -self.c2
        out[..., 1, 1] = self.c1 * x5 * sin(x3)
        out[..., 3, 0] = 1
        out[..., 5, 1] = -self.c1 * x1 * sin(x3) + self.c2 * cos(x3)
        out[..., 7, 1] = 1
        return out

    def derivative(self, x: Array, u: Array) -> Array:
        """Rate of the state, f(x) + g(x) u of (5.9a), shape (..., 8)."""
        sin, cos, (x1, _, x3, _, x5, *_) = _parts(x)
        u1, u2 = u[..., 0], u[..., 1]
        out = self.f(x)
        out[..., 1] += -self.c2 * u1 + self.c1 * x5 * sin(x3) * u2
        out[..., 3] = u1
        out[..., 5] += (-self.c1 * x1 * sin(x3) + self.c2 * cos(x3)) * u2
        out[..., 7] = u2
        return out

    def output(self, x: Array) -> Array:
        """Measured outputs h(x) = (x, phi, y, theta) of (5.7), shape (..., 4)."""
        return x[..., MEASURED]

    def jacobian(self, x: Array, u: Array | None = None) -> Array:
        """State Jacobian, shape (..., 8, 8): of f alone (7.15) or, given u, of f + g u.

        The thesis's (7.15a) leaves out the input terms; pass u to have them.
        """
        sin, cos, (x1, x2, x3, x4, x5, x6, x7, x8) = _parts(x)
        k, d, c3, g = self.c1, self.d, self.c3, self.gravity
        sin3, cos3, sin7, cos7 = sin(x3), cos(x3), sin(x7), cos(x7)
        sin_2x3, cos_2x3 = 2 * sin3 * cos3, 1 - 2 * sin3**2
        A = np.zeros((*x.shape, 8))
        A[..., 0, 1] = A[..., 2, 3] = A[..., 4, 5] = A[..., 6, 7] = 1
        A[..., 1, 0] = k * (x8**2 * sin3**2 + x4**2)
        A[..., 1, 2] = k * (
            x8**2 * (x1 * sin_2x3 - d * cos_2x3) + 2 * x6 * x8 * cos3 + g * cos7 * cos3
        )
        A[..., 1, 3] = 2 * k * x1 * x4
        A[..., 1, 5] = 2 * k * sin3 * x8
        A[..., 1, 6] = -k * g * sin7 * sin3
        A[..., 1, 7] = k * (-d * x8 * sin_2x3 + 2 * sin3 * (x1 * x8 * sin3 + x6))
        A[..., 5, 0] = -2 * k * x4 * x8 * cos3
        A[..., 5, 1] = -2 * k * sin3 * x8
        A[..., 5, 2] = k * x8 * (2 * x1 * x4 * sin3 - (c3 * x4 + 2 * x2) * cos3)
        A[..., 5, 3] = -k * x8 * (c3 * sin3 + 2 * x1 * cos3)
        A[..., 5, 4] = k * x8**2
        A[..., 5, 6] = -k * g * cos7
        A[..., 5, 7] = k * (2 * (x5 * x8 - x2 * sin3) - x4 * (c3 * sin3 + 2 * x1 * cos3))
        if u is not None:
            u2 = u[..., 1]
            A[..., 1, 2] += k * x5 * cos3 * u2
            A[..., 1, 4] += k * sin3 * u2
            A[..., 5, 0] += -k * sin3 * u2
            A[..., 5, 2] += (-k * x1 * cos3 - self.c2 * sin3) * u2
        return A

    def linear(self) -> Linear:
        """Linear model about the level plate and the ball on the centre, (5.35)."""
        level = np.zeros(8)
        return Linear(self.jacobian(level), self.g(level), np.eye(8)[list(MEASURED)])

    def flat(self, x: Array, u: Array) -> Array:
        """Rate of the state of the flat model (6.44), shape (..., 8)."""
        out = np.zeros(np.broadcast_shapes(x.shape, (*u.shape[:-1], 8)))
        out[..., 0::2] = x[..., 1::2]
        out[..., 1] = self.k1 * np.sin(x[..., 2])
        out[..., 3] = u[..., 0]
        out[..., 5] = -self.k1 * np.sin(x[..., 6])
        out[..., 7] = u[..., 1]
        return out


def _parts(x: Array) -> tuple[Any, Any, Iterable[Any]]:
    """Sine, cosine and the eight states: numbers for one rig, arrays for several.

    Python calculates with numbers several times faster than numpy with arrays of one, but raises
    where a state has grown beyond bounds and numpy goes on with infinities; that is left to numpy.
    """
    if x.size == 8 and x.dtype == np.float64:
        numbers = x.ravel().tolist()
        if all(-1e9 < number < 1e9 for number in numbers):
            return math.sin, math.cos, numbers
    # of many rigs each state by itself in one piece, which numpy reads three times faster
    return np.sin, np.cos, np.moveaxis(x, -1, 0).copy()
