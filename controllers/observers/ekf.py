"""Extended Kalman filter (7.14)-(7.17) on the exact model, with the Riccati difference equation."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Len

from controllers.arrays import Array, every
from controllers.ballplate import MEASURED
from controllers.interfaces import Measurement, Observer
from controllers.observers.innovation import OUTPUTS
from controllers.observers.kalman import DISTURBANCE, NOISE, Kalman
from controllers.ranges import Positive

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
