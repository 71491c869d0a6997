"""Nonlinear Luenberger-like observer (7.10)-(7.13) on the flat model, from the ball alone.

Extended Kalman filter (7.14)-(7.17) on the exact model, with the Riccati difference equation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Len

from controllers.arrays import Array, every
from controllers.ballplate import MEASURED
from controllers.design import Pole, sample, stable_poles
from controllers.interfaces import Measurement, Observer
from controllers.observers.linear import DISTURBANCE, NOISE, OUTPUTS, Kalman, axis_poles, innovation
from controllers.ranges import Positive

STEEPEST = math.sin(math.radians(60))
FASTEST = 10.0


@dataclass(kw_only=True)
class NonlinearLuenberger(Observer):
    """Observer of the ball's position and three derivatives, of which it makes the plate's state.

    In the coordinates z of (6.51) the flat model (6.44) is a chain of four integrators per axis,
    driven by v of (6.49), so the linear observer (7.10) has the same error dynamics wherever the
    ball is. Its current form over a period, written in x like (7.11), is

        xhat[k] = z^-1(z(xbar[k]) + G (y[k] - xbar_1[k])),    xbar[k+1] = flat model after u[k],

    where z^-1 takes the place of O(x)^-1, (7.12) and (7.13), to which it tends for a small
    innovation. With A the step of the chain, G gives A (I - G C) the eigenvalues exp(p T): stable
    for any stable p and period. It is unique, a chain having one output. The thesis gives no poles
    for this observer; those of (8.1) would be unstable behind a dead time of 42 ms, the default is
    half of them.

    Thus the plate angles are guessed from the ball's acceleration, and a neglected force looks like
    a tilt. With ``plate_observer`` the angles are measured and the plate's part of the estimate is
    that of a second observer, of phi'' = u1 and theta'' = u2, as the end of 7.2.1 proposes; the
    first one goes on beside it, for the ball.

    After a start far from the ball, an acceleration may be asked for that no slope gives: slopes
    are cut to 60 degrees and rates to 10 rad/s, far beyond any plate's.

    Raises:
        ValueError: If the poles are not four or eight, or not two for the plate, not stable or not
            in conjugate pairs.
    """

    name: ClassVar[str] = "nonlinear_luenberger"

    poles: tuple[Pole, ...] = (-4, -5, -7, -8)
    """Poles of the error in 1/s: four for each axis alike, or eight, for x and then for y."""
    plate_observer: bool = False
    """Whether the plate angles are measured and have an observer of their own."""
    plate_poles: tuple[Pole, ...] = (-14, -16)
    """Two poles of the plate observer's error in 1/s."""

    G: Array = field(init=False, repr=False)
    """Gain of the current form in z, shape (2, 4): axis x, axis y."""
    H: Array = field(init=False, repr=False)
    """Gain of the plate observer, shape (2,): angle, rate."""

    def __post_init__(self) -> None:
        """Design the gains."""
        super().__post_init__()
        A, B = sample(np.eye(4, k=1), np.eye(4)[:, 3:], self.period)
        self.G = np.array([chain_gain(mine, self.period) for mine in axis_poles(self.poles)])
        self.H = chain_gain(stable_poles(self.plate_poles, 2), self.period)
        self._ball = A[:2].T, B[:2, 0]
        self._turn, self._push = A[2:, 2:].T, B[2:, 0]
        self._k = self.model.k

    def start(self, x: Array) -> None:
        """Begin at the state x, shape (..., 8)."""
        super().start(x)
        self._flat = _axes(self.x)

    def correct(self, measurement: Measurement) -> Array:
        """Take in a measurement; without a touch nothing but a plate observer corrects."""
        e = innovation(measurement, self.x)
        z, _ = self._chain()
        z += e[..., 0::2, np.newaxis] * self.G
        sine = cut(z[..., 2] / self._k, STEEPEST)
        z[..., 2] = np.arcsin(sine)
        z[..., 3] = cut(z[..., 3] / (self._k * np.sqrt(1 - sine * sine)), FASTEST)
        self._flat = z
        if self.plate_observer:
            z = z.copy()
            z[..., 2:] = _axes(self.x)[..., 2:] + e[..., 1::2, np.newaxis] * self.H
        self.x = z.reshape(self.x.shape)
        return self.x

    def predict(self, u: Array) -> None:
        """Carry the estimate one period ahead."""
        push = u[..., np.newaxis] * self._push
        plate = self._flat[..., 2:]
        z, slope = self._chain()
        v = slope * u - z[..., 2] * plate[..., 1] ** 2
        z[..., :2] = z.dot(self._ball[0]) + v[..., np.newaxis] * self._ball[1]
        z[..., 2:] = plate.dot(self._turn) + push
        self._flat = z
        if self.plate_observer:
            z = z.copy()
            z[..., 2:] = _axes(self.x)[..., 2:].dot(self._turn) + push
        self.x = z.reshape(self.x.shape)

    def _chain(self) -> tuple[Array, Array]:
        """Estimate z of (6.51), shape (..., 2, 4), and its slope dz_3 / d angle, shape (..., 2)."""
        z = self._flat.copy()
        angle = self._flat[..., 2]
        slope = self._k * np.cos(angle)
        z[..., 2] = self._k * np.sin(angle)
        z[..., 3] *= slope
        return z, slope


def cut(values: Array, limit: float) -> Array:
    """Values within plus or minus the limit; faster on small arrays than numpy's clip."""
    return np.minimum(np.maximum(values, -limit), limit)


def _axes(x: Array) -> Array:
    """State with the axes x and y apart, shape (..., 2, 4)."""
    return x.reshape(*x.shape[:-1], 2, 4)


def chain_gain(poles: Sequence[Pole], T: float) -> Array:
    """Gain G for a chain of n integrators whose first state is measured, by Ackermann's formula.

    Args:
        poles: Continuous poles p in 1/s, shape (n,).
        T: Period in s.

    Returns:
        Shape (n,), such that A (I - G C) has the eigenvalues exp(p T), with A the chain's step.
    """
    n = len(poles)
    # In time units of a period: with T in it, the observability matrix is close to singular.
    A, _ = sample(np.eye(n, k=1), np.zeros((n, 1)), 1.0)
    observability = np.array([np.linalg.matrix_power(A, i)[0] for i in range(n)])
    G = np.linalg.solve(observability, np.eye(n)[:, -1])
    for pole in poles:
        G = (A - np.eye(n)) @ G - np.expm1(pole * T) * G
    return np.linalg.solve(A, G).real / T ** np.arange(n)


OF_PLATE = np.array([False, True, False, True])
"""Which measurements are the plate's: they hold without a touch, too."""


@dataclass(kw_only=True)
class ExtendedKalman(Observer):
    """Kalman filter that is linearised about its estimate every period.

    Where the thesis solves an algebraic Riccati equation per tick (7.16), the covariance P of the
    error follows the estimate. The noises being independent, the measurements are taken in one
    after the other, for which nothing need be inverted; with p the i-th column of P,

        w = p / sqrt(P[i, i] + R[i]),
        x <- x + w (y[i] - x[i]) / sqrt(P[i, i] + R[i]),    P <- P - w w'.

    The prediction, with A = d(f + g u)/dx at the estimate, is

        x <- x + d + G u,    P <- F P F' + G Q G' / T,

    the exponential Euler step: of second order, and exact about the level plate. One matrix, of
    which all rows but the ball's own only integrate, serves state and covariance:

            (A  g  f)       (F  G  d)
        exp (0  0  0) T  =  (0  I  0).
            (0  0  0)       (0  0  1)

    Of its series two terms are those of the estimate, all further ones those of the level plate,
    where the series is finite.
    Q and R are intensities as for the Kalman filter: the disturbance is held over a period with
    variance Q / T, a sample's noise has the variance R / T.

    Raises:
        ValueError: If there are not two, four and eight values, all positive and finite.
    """

    name: ClassVar[str] = "ekf"

    Q: tuple[Positive, Positive] = DISTURBANCE
    """Intensities of the disturbance of u1, u2 in (rad/s^2)^2 s; Table B.1."""
    R: tuple[Positive, Positive, Positive, Positive] = NOISE
    """Intensities of the noise of x, phi, y, theta in m^2 s and rad^2 s; Table B.1."""
    spread: Annotated[tuple[Positive, ...], Len(8, 8)] | None = None
    """Standard deviations of the eight states at the start; by default the covariance in which
    the Kalman filter about the level plate settles."""
    input_terms: bool = True
    """Whether A has the derivative of g(x) u, which (7.15a) leaves out."""

    P: Array = field(init=False, repr=False)
    """Covariance of the estimate's error, shape (..., 8, 8)."""

    def __post_init__(self) -> None:
        """Find the covariance to start with."""
        super().__post_init__()
        if self.spread is None:
            self._P = Kalman(model=self.model, period=self.period, Q=self.Q, R=self.R).S
        else:
            self._P = np.diag(np.square(self.spread))
        self._R = np.array(self.R) / self.period
        # inputs are counted in standard deviations of the disturbance: G G' is then G Q G' / T
        self._deviation = np.sqrt(np.divide(self.Q, self.period))
        self._scale = np.concatenate((np.ones(8), self._deviation, [1])) * self.period
        self._once, self._rest = self._constant()

    def start(self, x: Array) -> None:
        """Begin at the state x, shape (..., 8), with the covariance of the settings."""
        super().start(x)
        self.P = np.tile(self._P, (*self.x.shape[:-1], 1, 1))

    def correct(self, measurement: Measurement) -> Array:
        """Take in a measurement; without a touch only the plate angles correct."""
        x, P, y, R = self.x, self.P, measurement.y, self._R
        if not every(measurement.touched):
            felt = measurement.touched[..., np.newaxis] | OF_PLATE
            y, R = np.where(felt, y, x[..., OUTPUTS]), np.where(felt, R, math.inf)
        # rows of C P, and the innovation as a further column that is treated as they are
        W = np.empty((*x.shape[:-1], len(MEASURED), 9))
        W[..., :8] = P[..., OUTPUTS, :]
        W[..., 8] = y - x[..., OUTPUTS]
        for j, i in enumerate(MEASURED):
            w = W[..., j, :]
            if j:
                taken = W[..., :j, :]
                w -= (taken[..., np.newaxis, :, i] @ taken)[..., 0, :]
            w /= np.sqrt(w[..., i] + R[..., j])[..., np.newaxis]
        gained = transpose(W[..., :8]) @ W
        self.x, self.P = x + gained[..., 8], P - gained[..., :8]
        return self.x

    def predict(self, u: Array) -> None:
        """Carry estimate and covariance one period ahead."""
        x, T = self.x, self.period
        ball = self.model.ball(x, u if self.input_terms else None) * self._scale
        # first (A, g, f) T: the powers of its rows of the ball, and then (F, G, d)
        step = np.empty((*x.shape, 11))
        step[:] = self._once
        step[..., 1::4, :] = ball
        step[..., 0::2, 10] = T * x[..., 1::2]
        second = ball[..., :8] @ step
        step += self._rest
        step[..., 0::4, :] += T * (ball / 2 + second / 6)
        step[..., 1::4, :] += second / 2
        F, G, d = step[..., :8], step[..., 8:10], step[..., 10]
        self.x = x + d + (G @ (u / self._deviation)[..., np.newaxis])[..., 0]
        FP_G = np.empty((*x.shape, 10))
        FP_G[..., :8], FP_G[..., 8:] = F @ self.P, G
        P = FP_G @ transpose(step[..., :10])
        P += transpose(P)
        P *= 0.5
        self.P = P

    def _constant(self) -> tuple[Array, Array]:
        """What is the same every period of (A, g, f) T and of (F, G, d) - (A, g, f) T, (8, 11)."""
        T = self.period
        once, rest = np.zeros((11, 11)), np.eye(11)
        once[range(0, 8, 2), range(1, 8, 2)] = T
        once[(3, 7), (8, 9)] = T * self._deviation
        level = once.copy()
        level[1:8:4] = self.model.ball(np.zeros(8)) * self._scale
        square = level @ level
        rest[2:8:4] += square[2:8:4] / 2
        rest[1:8:4] += (square @ level)[1:8:4] / 6
        rest[0:8:4] += (square @ square)[0:8:4] / 24
        return once[:8], rest[:8]


def transpose(A: Array) -> Array:
    """A' as a copy: stacks of small matrices multiply three times faster when contiguous."""
    return A.swapaxes(-1, -2).copy()
