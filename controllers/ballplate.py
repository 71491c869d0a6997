"""The ball-and-plate model of laws: (5.9), its Jacobians (7.15), linear (5.35) and flat (6.44).

The thesis designs its laws on (5.9). It lacks a term of a rolling ball, and the ball's spin:
``twin.sim.plant.exact`` has both, and docs/claims.md shows where they matter.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from controllers.arrays import Array, NotNegative, Positive, check

STATE_NAMES = ("x", "x_rate", "phi", "phi_rate", "y", "y_rate", "theta", "theta_rate")
"""Names of the state (5.5) in columns and signals."""
MEASURED_STATES = (0, 2, 4, 6)
"""Where the measurement y = (x, phi, y, theta) of (5.3) stands in the state (5.5)."""
BALL_POSITIONS = [0, 4]
"""Where the ball's position x, y stands in the state."""
BALL_ACCELERATIONS = [1, 5]
"""Where the rate of the state has the ball's acceleration."""
TILT_SIGN = np.array((1.0, -1.0))
"""Sense in which a positive plate angle accelerates the ball along x and along y, (6.45)."""
LONGEST_LAG = 0.03
"""Largest lag of the drives in s that an observer estimates; a larger one must be given."""


class LinearModel(NamedTuple):
    """x' = A x + B u, y = C x about the level plate, (5.35) with the sign of B[6, 2] corrected."""

    A: Array
    B: Array
    C: Array


class Chain(NamedTuple):
    """Both axes of the flat model in Brunovsky form: y^(4) = a (u - tan(angle) rate^2) (6.48)."""

    z: Array
    """Position and three derivatives of each axis, shape (..., 2, 4)."""
    angle: Array
    """Plate angles (phi, theta) in rad, shape (..., 2)."""
    rate: Array
    """Plate rates in rad/s, shape (..., 2)."""
    a: Array
    """Input gain +-k1 cos(angle) in m/s^2, shape (..., 2)."""


@dataclass(frozen=True, kw_only=True)
class BallPlate:
    """A ball rolling on a plate; the inputs are the plate's angular accelerations.

    The state is x = (x, x', phi, phi', y, y', theta, theta') (5.5) in m, m/s, rad, rad/s, in plate
    axes; the input u = (phi'', theta'') (5.8) in rad/s^2. The rotation from plate to world is
    R = Rx(theta) Ry(phi) (4.5). Assumes rolling without slip, spin or rolling resistance, and takes
    Lagrange's equations with the rolling condition put in, which loses (1 - c1) w_z y' in x'' and
    -(1 - c1) w_z x' in y'', w_z = theta' sin(phi).

    Raises:
        ValueError: If a parameter is not finite, or not positive where it must be.
    """

    mass: Positive = 0.024
    """Mass of the ball in kg, thesis A.2."""
    radius: Positive = 0.02
    """Radius of the ball in m, thesis A.2."""
    inertia: Positive = 6.4e-6
    """Moment of inertia of the ball in kg m^2, thesis A.2 (a thin hollow sphere)."""
    gravity: Positive = 9.81
    """Gravitational acceleration in m/s^2, thesis A.2."""
    height: NotNegative = 0.122
    """Distance d_cs from the cardan joint up to the surface in m, thesis A.2."""
    lag: NotNegative = 0.0
    """Time constant in s with which the drives follow a commanded plate rate; 0 for at once. No
    part of the equations of motion: laws and observers that know of it say so."""

    d: float = field(init=False, repr=False)
    """Height of the ball's centre above the cardan joint in m, (4.6)."""
    c1: float = field(init=False, repr=False)
    """Share of gravity that accelerates the ball, dimensionless, (5.1)."""
    c2: float = field(init=False, repr=False)
    """Lever of the plate acceleration in m, (5.1); also b of (6.41)."""
    c3: float = field(init=False, repr=False)
    """Lever of the gyroscopic coupling in m, (5.1)."""
    c4: float = field(init=False, repr=False)
    """Ratio c2 / c1 in m, (5.1)."""
    k1: float = field(init=False, repr=False)
    """Ball acceleration for a unit sine of the slope in m/s^2, (6.41)."""
    k: Array = field(init=False, repr=False, compare=False)
    """The same along x and along y for a positive plate angle, +-k1 in m/s^2, (6.45)."""

    def __post_init__(self) -> None:
        """Check the parameters and derive the constants of (5.1)."""
        check(self)
        for name, value in constants(self.mass, self.radius, self.inertia, self.height).items():
            object.__setattr__(self, name, value)
        object.__setattr__(self, "k1", self.c1 * self.gravity)
        object.__setattr__(self, "k", self.k1 * TILT_SIGN)

    def f(self, x: Array) -> Array:
        """Drift of the model (5.9b), shape (..., 8)."""
        out = np.zeros_like(x)
        out[..., 0::2] = x[..., 1::2]
        out[..., 1], out[..., 5] = self._drift(_motion_terms(x))
        return out

    def g(self, x: Array) -> Array:
        """Input map of the model (5.9c), shape (..., 8, 2)."""
        out = np.zeros((*x.shape, 2))
        out[..., 1, 0] = -self.c2
        out[..., 1, 1], out[..., 5, 1] = self._input(_motion_terms(x))
        out[..., 3, 0] = out[..., 7, 1] = 1
        return out

    def derivative(self, x: Array, u: Array) -> Array:
        """Rate of the state, f(x) + g(x) u of (5.9a), shape (..., 8)."""
        seen = _motion_terms(x)
        u1, u2 = u[..., 0], u[..., 1]
        (f2, f6), (g2, g6) = self._drift(seen), self._input(seen)
        out = np.empty_like(x)
        out[..., 0::2] = x[..., 1::2]
        out[..., 1] = f2 - self.c2 * u1 + g2 * u2
        out[..., 5] = f6 + g6 * u2
        out[..., 3::4] = u
        return out

    def output(self, x: Array) -> Array:
        """Measured outputs h(x) = (x, phi, y, theta) of (5.7), shape (..., 4)."""
        return x[..., MEASURED_STATES]

    def jacobian(self, x: Array, u: Array | None = None) -> Array:
        """State Jacobian, shape (..., 8, 8): of f alone (7.15) or, given u, of f + g u.

        The thesis's (7.15a) leaves out the input terms; pass u to have them.
        """
        A = np.zeros((*x.shape, 8))
        A[..., range(0, 8, 2), range(1, 8, 2)] = 1
        A[..., 1::4, :] = self.ball(x, u)[..., :8]
        return A

    def ball(self, x: Array, u: Array | None = None) -> Array:
        """The two rows that are the ball's own, x'' and y'', of (A, g, f), shape (..., 2, 11).

        All other rows of Jacobian, input map and drift only integrate. A is as in ``jacobian``.
        """
        seen = _motion_terms(x)
        x1, x2, x5, x6, x8 = seen.x1, seen.x2, seen.x5, seen.x6, seen.x8
        s3, c3, wx, wy, wz = seen.s3, seen.c3, seen.wx, seen.wy, seen.wz
        u2 = 0.0 if u is None else u[..., 1]
        d, g7 = self.d, self.gravity * seen.c7
        along = x1 * wz + x6
        rows = np.zeros((2, 11, *x.shape[:-1]), np.result_type(x, float))
        a, b = rows
        a[0] = wz * wz + wy * wy
        a[2] = 2 * wx * along - d * (wx * wx - wz * wz) + (g7 + x5 * u2) * c3
        a[3] = 2 * x1 * wy
        a[4] = s3 * u2
        a[5] = 2 * wz
        a[6] = -self.gravity * seen.s7 * s3
        a[7] = 2 * s3 * (along - d * wx)
        b[0] = -2 * wy * wx - a[4]
        b[1] = -a[5]
        b[2] = a[3] * wz - (self.c3 * wy + 2 * x2) * wx - (x1 * c3 + self.c4 * s3) * u2
        b[3] = -self.c3 * wz - 2 * x1 * wx
        b[4] = x8 * x8
        b[6] = -g7
        b[7] = 2 * (x5 * x8 - x2 * s3) - wy * (self.c3 * s3 + 2 * x1 * c3)
        rows[:, :8] *= self.c1
        a[8] = -self.c2
        a[9], b[9] = self._input(seen)
        a[10], b[10] = self._drift(seen)
        return np.moveaxis(rows, (0, 1), (-2, -1))

    def _drift(self, seen: _Seen) -> tuple[Any, Any]:
        """Rows x'' and y'' of (5.9b)."""
        x1, x2, x5, x6, x8, s3, _, s7, c7, wx, wy, wz = seen
        along_x = x1 * (wz * wz + wy * wy) - self.d * wx * wz + 2 * x6 * wz + self.gravity * s3 * c7
        along_y = x5 * x8 * x8 - wy * (self.c3 * wz + 2 * x1 * wx) - 2 * x2 * wz - self.gravity * s7
        return self.c1 * along_x, self.c1 * along_y

    def _input(self, seen: _Seen) -> tuple[Any, Any]:
        """Column theta'' of (5.9c) in the rows x'' and y''."""
        along_x = self.c1 * seen.x5 * seen.s3
        return along_x, self.c2 * seen.c3 - self.c1 * seen.x1 * seen.s3

    def linear(self) -> LinearModel:
        """Linear model about the level plate and the ball on the centre, (5.35)."""
        level = np.zeros(8)
        return LinearModel(self.jacobian(level), self.g(level), np.eye(8)[list(MEASURED_STATES)])

    def flat(self, x: Array, u: Array) -> Array:
        """Rate of the state of the flat model (6.44), shape (..., 8)."""
        out = np.zeros(np.broadcast_shapes(x.shape, (*u.shape[:-1], 8)))
        out[..., 0::2] = x[..., 1::2]
        out[..., 1] = self.k1 * np.sin(x[..., 2])
        out[..., 3] = u[..., 0]
        out[..., 5] = -self.k1 * np.sin(x[..., 6])
        out[..., 7] = u[..., 1]
        return out

    def chain(self, x: Array) -> Chain:
        """Brunovsky form of the flat model at the state x, shape (..., 8)."""
        z = x.copy().reshape(*x.shape[:-1], 2, 4)
        # a copy lies in one piece, which numpy reads faster than every fourth number
        angle, rate = x[..., 2::4].copy(), x[..., 3::4].copy()
        # arrays of one shape, too: where one has to be repeated takes three times as long
        k = self.k.reshape(angle.shape) if angle.size == len(self.k) else self.k
        a = k * np.cos(angle)
        z[..., 2] = k * np.sin(angle)
        z[..., 3] = a * rate
        return Chain(z, angle, rate, a)


def constants(m: Any, r: Any, J: Any, height: Any) -> dict[str, Any]:
    """The constants d, c1, c2, c3, c4 of (5.1), also of symbols.

    Args:
        m: Mass in kg.
        r: Radius in m.
        J: Moment of inertia in kg m^2.
        height: From the cardan joint up to the surface, m.
    """
    d = height + r
    return {
        "d": d,
        "c1": m * r**2 / (m * r**2 + J),
        "c2": (d * m * r**2 + J * r) / (m * r**2 + J),
        "c3": (J + 2 * d * m * r) / (m * r),
        "c4": (J + d * m * r) / (m * r),
    }


def stack_reference(r: Array) -> Array:
    """The position and k - 1 derivatives of a reference, (k, ..., 2), as a chain, (..., 2, k)."""
    return r.transpose(*range(1, r.ndim), 0)


def corner_frequency(lag: float) -> float:
    """Corner frequency in Hz of a first-order lag of a time constant in s; 0 without a lag."""
    return float(1 / (2 * np.pi * lag)) if lag else 0.0


def time_constant(corner: float) -> float:
    """Time constant in s of a first-order lag of a corner frequency in Hz; 0 without a lag."""
    return float(1 / (2 * np.pi * corner)) if corner else 0.0


class _Seen(NamedTuple):
    """Coefficients of the equations of motion: numbers for one rig, arrays for several.

    ``s3`` to ``c7`` are sines and cosines of phi and theta, ``wx`` to ``wz`` the plate's angular
    velocity (theta' cos phi, phi', theta' sin phi) in its own axes.
    """

    x1: Any
    x2: Any
    x5: Any
    x6: Any
    x8: Any
    s3: Any
    c3: Any
    s7: Any
    c7: Any
    wx: Any
    wy: Any
    wz: Any


def _motion_terms(x: Array) -> _Seen:
    """Coefficients of the equations of motion at a state.

    Python calculates with numbers several times faster than numpy with arrays of one, but raises
    where a state has grown beyond bounds and numpy goes on with infinities; that is left to numpy.
    """
    if x.size == 8 and x.dtype == np.float64:
        numbers = x.ravel().tolist()
        if all(-1e9 < number < 1e9 for number in numbers):
            return _gather_terms(math.sin, math.cos, numbers)
    # of many rigs each state by itself in one piece, which numpy reads three times faster
    return _gather_terms(np.sin, np.cos, np.moveaxis(x, -1, 0).copy())


def _gather_terms(sin: Any, cos: Any, states: Iterable[Any]) -> _Seen:
    x1, x2, x3, x4, x5, x6, x7, x8 = states
    s3, c3 = sin(x3), cos(x3)
    return _Seen(x1, x2, x5, x6, x8, s3, c3, sin(x7), cos(x7), x8 * c3, x4, x8 * s3)
