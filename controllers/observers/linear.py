"""What a measurement says beyond the estimate, the drive of every observer of chapter 7.

An observer with a constant gain on the linear model (5.35), discrete in its current form.

The state itself, from a simulated rig with ideal sensors: for laws without an observer.

Luenberger observer (7.1) on the linear model, designed by pole placement (7.4).

Kalman-Bucy filter (7.7)-(7.8) on the linear model, with a constant gain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import scipy

from controllers.arrays import Array, every
from controllers.design import Pole, listed, place_poles, sample, stable_poles
from controllers.interfaces import Measurement, Observer
from controllers.ranges import Positive

OUTPUTS = slice(0, None, 2)
"""h(x) = (x, phi, y, theta) of (5.7) as a slice of the state: unlike a list of indices, a view."""


def innovation(measurement: Measurement, x: Array) -> Array:
    """Difference y - h(x) of (7.1), (7.9); zero for a ball that the screen does not feel.

    Args:
        measurement: What the rig handed over.
        x: Predicted state at the same time, shape (..., 8).

    Returns:
        Shape (..., 4), in m and rad.
    """
    e = measurement.y - x[..., OUTPUTS]
    if not every(measurement.touched):
        e[~measurement.touched, 0::2] = 0
    return e


@dataclass(kw_only=True)
class LinearObserver(Observer):
    """xhat[k] = xbar[k] + L (y[k] - C xbar[k]),  xbar[k+1] = A xhat[k] + B u[k].

    The estimate at a tick has that tick's measurement in it. A subclass designs A, B and L in its
    ``__post_init__``.
    """

    A: Array = field(init=False, repr=False)
    """State matrix of a step, shape (8, 8)."""
    B: Array = field(init=False, repr=False)
    """Input matrix of a step, shape (8, 2)."""
    L: Array = field(init=False, repr=False)
    """Gain of the current form, shape (8, 4)."""

    def correct(self, measurement: Measurement) -> Array:
        """Take in a measurement; without a touch only the plate angles correct."""
        self.x = self.x + innovation(measurement, self.x).dot(self.L.T)
        return self.x

    def predict(self, u: Array) -> None:
        """Carry the estimate one period ahead."""
        self.x = self.x.dot(self.A.T) + u.dot(self.B.T)


RATES = slice(3, None, 4)
"""The plate rates phi', theta' in the state (5.5)."""


@dataclass(kw_only=True)
class Ideal(Observer):
    """Hands on the true state, but takes the plate rates from the input.

    The plate rates phi' and theta' are the integral of the applied input: the rate commanded, not
    the rate made. Feeding back the true one would close a loop through the resonance of plate and
    spring and can make it unstable; on the exact model the two are the same.
    """

    name: ClassVar[str] = "ideal"

    def correct(self, measurement: Measurement) -> Array:
        """The true state with commanded plate rates, shape (..., 8).

        Raises:
            ValueError: If the rig does not hand over its state.
        """
        if measurement.state is None:
            raise ValueError("observer 'ideal' needs a simulated rig with ideal sensors")
        x = np.array(measurement.state, dtype=float)
        x[..., RATES] = self.x[..., RATES]
        self.x = x
        return x

    def predict(self, u: Array) -> None:
        """Integrate the plate rates one period under the applied input u, shape (..., 2)."""
        x = self.x.copy()
        x[..., RATES] += self.period * u
        self.x = x


@dataclass(kw_only=True)
class Luenberger(LinearObserver):
    """Linear observer with the error dynamics of given poles.

    With A, B the exact step of (5.35) over a period, the error obeys A (I - L C) and a linear
    plant is followed without bias. The two subsystems (x, phi) and (y, theta) are designed apart,
    each with eigenvalues exp(p T) for its continuous poles p. With two measurements each, poles do
    not fix L (nor do they fix the thesis's); the free part goes where Matlab's place, too, puts
    it: eigenvectors as orthogonal as possible, by the deterministic search of Yang and Tits.

    Raises:
        ValueError: If the poles are not four or eight, not stable, not in conjugate pairs, or if
            more than two of a subsystem coincide.
    """

    name: ClassVar[str] = "luenberger"

    poles: tuple[Pole, ...] = (-8, -10, -14, -16)
    """Poles of the error in 1/s: four for each subsystem alike, or eight, for (x, phi) and then
    for (y, theta). By default (8.1)."""

    def __post_init__(self) -> None:
        """Design the gain."""
        super().__post_init__()
        A, B, _ = self.model.linear()
        self.A, self.B = sample(A, B, self.period)
        self.L = np.zeros((8, 4))
        for axis, mine in enumerate(axis_poles(self.poles)):
            states, outputs = slice(4 * axis, 4 * axis + 4), slice(2 * axis, 2 * axis + 2)
            self.L[states, outputs] = current_gain(self.A[states, states], mine, self.period)


def axis_poles(poles: Sequence[Pole]) -> tuple[tuple[Pole, ...], tuple[Pole, ...]]:
    """Four poles for x and four for y of four for both or of eight, once checked."""
    if len(poles) not in (4, 8):
        raise ValueError(f"poles must be 4 or 8 numbers, got {len(poles)}")
    return stable_poles(poles[:4], 4), stable_poles(poles[-4:], 4)


def current_gain(A: Array, poles: Sequence[Pole], T: float) -> Array:
    """Gain L that gives A (I - L C) the eigenvalues exp(p T), C picking every other state.

    Args:
        A: State matrix of a step of one subsystem, shape (4, 4).
        poles: Continuous poles p in 1/s, shape (4,).
        T: Period in s.

    Returns:
        Shape (4, 2).

    Raises:
        ValueError: If more than two poles coincide.
    """
    if max(map(poles.count, poles)) > 2:
        raise ValueError(f"poles may coincide in pairs, no more, got {listed(poles)}")
    C = np.eye(4)[OUTPUTS]
    return np.linalg.solve(A, place_poles(A.T, C.T, np.exp(np.array(poles) * T)).T)


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
