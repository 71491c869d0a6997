"""Extended Kalman filter (7.14)-(7.17) on the exact model, with the Riccati difference equation."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from controllers.ballplate import MEASURED
from controllers.interfaces import Measurement, Observer
from controllers.observers.innovation import OUTPUTS
from controllers.observers.kalman import DISTURBANCE, NOISE, Kalman, check_positive
from controllers.observers.sampling import check_period

Array = NDArray[np.floating]

PLATE = np.array([False, True, False, True])
"""Which measurements are the plate's: they hold without a touch, too."""
EYE = np.eye(8)
HALF, SIXTH = EYE / 2, EYE / 6


@dataclass(kw_only=True)
class ExtendedKalman(Observer):
    """Kalman filter that is linearised about its estimate every period.

    Where the thesis solves an algebraic Riccati equation a tick (7.16), the covariance P of the
    error follows the estimate. The noises being independent, the measurements are taken in one
    after the other, for which nothing need be inverted; with p the i-th column of P,

        w = p / sqrt(P[i, i] + R[i]),
        x <- x + w (y[i] - x[i]) / sqrt(P[i, i] + R[i]),    P <- P - w w'.

    The prediction, with A = d(f + g u)/dx at the estimate, is

        x <- x + T E f + G u,    P <- F P F' + G Q G' / T,
        F = e^(A T),    T E = integral of e^(A s) over a period,    G = T E g,

    the exponential Euler step: of second order, and exact about the level plate, where the series
    of e^(A T) ends with (A T)^3. One Jacobian serves state and covariance.
    Q and R are intensities as for the Kalman filter: the disturbance is held over a period with
    variance Q / T, a sample's noise has the variance R / T.

    Raises:
        ValueError: If there are not two, four and eight values, all positive and finite.
    """

    name: ClassVar[str] = "ekf"

    Q: tuple[float, float] = DISTURBANCE
    """Intensities of the disturbance of u1, u2 in (rad/s^2)^2 s; Table B.1."""
    R: tuple[float, float, float, float] = NOISE
    """Intensities of the noise of x, phi, y, theta in m^2 s and rad^2 s; Table B.1."""
    spread: tuple[float, ...] | None = None
    """Standard deviations of the eight states at the start; by default the covariance in which
    the Kalman filter about the level plate settles."""
    input_terms: bool = True
    """Whether A has the derivative of g(x) u, which (7.15a) leaves out."""

    P: Array = field(init=False, repr=False)
    """Covariance of the estimate's error, shape (..., 8, 8)."""

    def __post_init__(self) -> None:
        """Find the covariance to start with."""
        check_period(self.period)
        check_positive("Q", self.Q, 2)
        check_positive("R", self.R, 4)
        if self.spread is None:
            self._P = Kalman(model=self.model, period=self.period, Q=self.Q, R=self.R).S
        else:
            check_positive("spread", self.spread, 8)
            self._P = np.diag(np.square(self.spread))
        self._Q = np.array(self.Q) / self.period
        self._R = np.array(self.R) / self.period

    def start(self, x: Array) -> None:
        """Begin at the state x, shape (..., 8), with the covariance of the settings."""
        super().start(x)
        self.P = np.array(np.broadcast_to(self._P, (*self.x.shape, 8)))

    def correct(self, measurement: Measurement) -> Array:
        """Take in a measurement; without a touch only the plate angles correct."""
        x, P, y, R = self.x, self.P, measurement.y, self._R
        if not measurement.touched.all():
            felt = measurement.touched[..., np.newaxis] | PLATE
            y, R = np.where(felt, y, x[..., OUTPUTS]), np.where(felt, R, math.inf)
        W = np.empty((*x.shape[:-1], len(MEASURED), 8))
        for j, i in enumerate(MEASURED):
            taken = W[..., :j, :]
            p = P[..., i, :] - (taken[..., np.newaxis, :, i] @ taken)[..., 0, :]
            root = np.sqrt(p[..., i] + R[..., j])[..., np.newaxis]
            W[..., j, :] = w = p / root
            x = x + w * ((y[..., j] - x[..., i])[..., np.newaxis] / root)
        self.x, self.P = x, P - transpose(W) @ W
        return x

    def predict(self, u: Array) -> None:
        """Carry estimate and covariance one period ahead."""
        x, T = self.x, self.period
        A = T * self.model.jacobian(x, u if self.input_terms else None)
        E = series(A)
        F = EYE + A @ E
        columns = np.concatenate((self.model.f(x)[..., np.newaxis], self.model.g(x)), axis=-1)
        columns = T * E @ columns
        drift, G = columns[..., 0], columns[..., 1:]
        self.x = x + drift + (G @ u[..., np.newaxis])[..., 0]
        P = F @ self.P @ transpose(F)
        P += G * self._Q @ transpose(G)
        P += transpose(P)
        P *= 0.5
        self.P = P


def series(A: Array) -> Array:
    """I + A (I / 2 + A (I / 6 + A / 24)), the mean of e^(A s) over s from 0 to 1."""
    E = A / 24
    for part in (SIXTH, HALF):
        E += part
        E = A @ E
    E += EYE
    return E


def transpose(A: Array) -> Array:
    """A' as a copy: stacks of small matrices multiply three times faster when contiguous."""
    return A.swapaxes(-1, -2).copy()
