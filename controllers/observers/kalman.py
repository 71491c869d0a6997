"""Kalman-Bucy filter (7.7)-(7.8) on the linear model, with a constant gain."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import scipy

from controllers.arrays import Array
from controllers.observers.linear import LinearObserver
from controllers.observers.sampling import sample
from controllers.ranges import Positive

DISTURBANCE = (1.0816e-4, 2.8090e-5)
"""Q of Table B.1: disturbance of u1, u2."""
NOISE = (7.2538e-7, 1.5433e-10, 1.7721e-7, 1.1580e-10)
"""R of Table B.1 in the order of (7.6b): x, phi, y, theta."""


@dataclass(kw_only=True)
class Kalman(LinearObserver):
    """Linear observer with the gain that is best for white disturbance and noise.

    Q and R are intensities, as in (2.61) and (7.7). Sampled with the period T, the disturbance
    becomes one that is held like the input and has the variance Q / T, the noise one of variance
    R / T in every sample: the discrete gain over T tends to (7.8) as T gets short. Who knows the
    variances of held disturbance and of samples instead gives Q = variance T and R = variance T.
    Table B.1 holds variances of samples, which the thesis uses as intensities; so do the defaults.

    Whichever they are, only their ratio sets the gain, and that of Table B.1 trusts the model: the
    slowest error of the ball takes 5 s to die out, so a force outside the model, such as rolling
    resistance, stays in the estimate for long. Larger Q forgets faster.

    (8.2) has R in the order x, y, phi, theta of Table B.1, not in that of (7.6b). Tables 8.12 to
    8.21 were made so; R=(0.7254e-6, 0.1772e-6, 0.0002e-6, 0.0001e-6) repeats it.

    Raises:
        ValueError: If there are not two and four variances, all positive and finite.
    """

    name: ClassVar[str] = "kalman"

    Q: tuple[Positive, Positive] = DISTURBANCE
    """Intensities of the disturbance of u1, u2 in (rad/s^2)^2 s; Table B.1."""
    R: tuple[Positive, Positive, Positive, Positive] = NOISE
    """Intensities of the noise of x, phi, y, theta in m^2 s and rad^2 s; Table B.1."""

    S: Array = field(init=False, repr=False)
    """Covariance of the predicted state's error in the steady state, shape (8, 8)."""

    def __post_init__(self) -> None:
        """Solve the Riccati equation."""
        super().__post_init__()
        A, B, C = self.model.linear()
        self.A, self.B = sample(A, B, self.period)
        Q, R = np.diag(self.Q) / self.period, np.diag(self.R) / self.period
        self.S = predicted_covariance(self.A, self.B, C, Q, R)
        self.L = np.linalg.solve(C @ self.S @ C.T + R, C @ self.S).T


def predicted_covariance(A: Array, B: Array, C: Array, Q: Array, R: Array) -> Array:
    """Steady covariance S = A (S - S C' (C S C' + R)^-1 C S) A' + B Q B' of the predicted error.

    Args:
        A: State matrix of a step, shape (n, n).
        B: Input matrix of a step, shape (n, m).
        C: Output matrix, shape (p, n).
        Q: Variance of the held disturbance of the input, shape (m, m).
        R: Variance of a sample's noise, diagonal, shape (p, p).

    Returns:
        Shape (n, n), symmetric.
    """
    # Outputs in units of their noise: scipy finds no solution with variances of 1e-10 as they are.
    C = C / np.sqrt(np.diag(R))[:, np.newaxis]
    S = scipy.linalg.solve_discrete_are(A.T, C.T, B @ Q @ B.T, np.eye(len(C)))
    return (S + S.T) / 2


def bucy_covariance(A: Array, B: Array, C: Array, Q: Array, R: Array) -> Array:
    """Steady covariance S of (7.7) in continuous time; S C' R^-1 is the gain (7.8).

    Args:
        A: State matrix, shape (n, n).
        B: Input matrix, through which the disturbance comes, shape (n, m).
        C: Output matrix, shape (p, n).
        Q: Intensity of the disturbance, shape (m, m).
        R: Intensity of the noise, diagonal, shape (p, p).

    Returns:
        Shape (n, n), symmetric.
    """
    C = C / np.sqrt(np.diag(R))[:, np.newaxis]
    S = scipy.linalg.solve_continuous_are(A.T, C.T, B @ Q @ B.T, np.eye(len(C)))
    return (S + S.T) / 2
