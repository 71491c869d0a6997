"""Observers of chapter 7 of the thesis, and the state itself from a rig with ideal sensors.

On the linear model (5.35) with a constant gain, discrete in its current form: the Luenberger
observer (7.1), designed by pole placement (7.4), and the Kalman-Bucy filter (7.7)-(7.8). On the
flat model, from the ball alone, the nonlinear Luenberger-like observer (7.10)-(7.13). On the exact
model the extended Kalman filter (7.14)-(7.17), with the Riccati difference equation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Annotated, ClassVar

import numpy as np
import scipy
from annotated_types import Len

from controllers.arrays import Array, Positive, every, multiply_rows
from controllers.ballplate import MEASURED_STATES, BallPlate
from controllers.design import Pole, format_numbers, place_poles, sample, stable_poles
from controllers.interfaces import Measurement, Observer, with_entries

OUTPUT_SLICE = slice(0, None, 2)
"""h(x) = (x, phi, y, theta) of (5.7) as a slice of the state: unlike a list of indices, a view."""


def innovation(measurement: Measurement, x: Array) -> Array:
    """Difference y - h(x) of (7.1), (7.9); zero for a ball that the screen does not feel.

    Args:
        measurement: What the rig handed over.
        x: Predicted state at the same time, shape (..., 8).

    Returns:
        Shape (..., 4), in m and rad.
    """
    # a copy lies in one piece, which numpy reads faster than every second number
    e = measurement.y - x[..., OUTPUT_SLICE].copy()
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
        self.x = self.x + multiply_rows(innovation(measurement, self.x), self.L.T)
        return self.x

    def predict(self, u: Array) -> None:
        """Carry the estimate one period ahead."""
        self.x = multiply_rows(self.x, self.A.T) + multiply_rows(u, self.B.T)


PLATE_RATE_SLICE = slice(3, None, 4)
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
        x[..., PLATE_RATE_SLICE] = self.x[..., PLATE_RATE_SLICE]
        self.x = x
        return x

    def predict(self, u: Array) -> None:
        """Integrate the plate rates one period under the applied input u, shape (..., 2)."""
        x = self.x.copy()
        x[..., PLATE_RATE_SLICE] += self.period * u
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

    poles: tuple[Pole, ...] = with_entries((-8, -10, -14, -16), along_x=4)
    """Poles of the error in 1/s: four for each subsystem alike, or eight, for (x, phi) and then
    for (y, theta). By default (8.1)."""

    def __post_init__(self) -> None:
        """Design the gain."""
        super().__post_init__()
        design = luenberger_design(self.model, tuple(self.poles), self.period)
        self.A, self.B, self.L = (each.copy() for each in design)


@lru_cache
def luenberger_design(model: BallPlate, poles: tuple[Pole, ...], T: float) -> tuple[Array, ...]:
    """A, B and L of a Luenberger observer, kept, for the search takes long."""
    A, B = sample(*model.linear()[:2], T)
    L = np.zeros((8, 4))
    for axis, mine in enumerate(axis_poles(poles)):
        states, outputs = slice(4 * axis, 4 * axis + 4), slice(2 * axis, 2 * axis + 2)
        L[states, outputs] = current_gain(A[states, states], mine, T)
    return A, B, L


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
        raise ValueError(f"poles may coincide in pairs, no more, got {format_numbers(poles)}")
    C = np.eye(4)[OUTPUT_SLICE]
    return np.linalg.solve(A, place_poles(A.T, C.T, np.exp(np.array(poles) * T)).T)


DISTURBANCE_VARIANCES = (1.0816e-4, 2.8090e-5)
"""Q of Table B.1: disturbance of u1, u2."""
NOISE_VARIANCES = (7.2538e-7, 1.5433e-10, 1.7721e-7, 1.1580e-10)
"""R of Table B.1 in the order of (7.6b): x, phi, y, theta."""


@dataclass(kw_only=True)
class Kalman(LinearObserver):
    """Linear observer with the gain that is best for white disturbance and noise.

    Q and R are intensities, as in (2.61) and (7.7). Sampled with the period T, the disturbance
    becomes one that is held like the input and has the variance Q / T, the noise one of variance
    R / T in every sample: the discrete gain over T tends to (7.8) as T gets short. Who knows the
    variances of held disturbance and of samples instead gives Q = variance T and R = variance T.
    Table B.1 holds variances of samples, which the thesis uses as intensities; so do the defaults.

    Whichever they are, only their ratio sets the gain, and the ratio of Table B.1 trusts the model:
    the slowest error of the ball takes 5 s to die out, so a force outside the model, such as
    rolling resistance, stays in the estimate for long. Larger Q forgets faster.

    (8.2) has R in the order x, y, phi, theta of Table B.1, unlike (7.6b). Tables 8.12 to
    8.21 were made so; R=(0.7254e-6, 0.1772e-6, 0.0002e-6, 0.0001e-6) repeats it.

    Raises:
        ValueError: If there are not two and four variances, all positive and finite.
    """

    name: ClassVar[str] = "kalman"

    Q: tuple[Positive, Positive] = with_entries(DISTURBANCE_VARIANCES, along_x=1)
    """Intensities of the disturbance of u1, u2 in (rad/s^2)^2 s; Table B.1."""
    R: tuple[Positive, Positive, Positive, Positive] = with_entries(NOISE_VARIANCES, along_x=2)
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


MAX_TILT_SINE = math.sin(math.radians(60))
MAX_BALL_SPEED_M_S = 10.0


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
    a tilt. With ``plate_observer`` the angles are measured and a second observer, of
    phi'' = u1 and theta'' = u2, estimates the plate's state, as the end of 7.2.1 proposes; the
    first one estimates the ball's.

    After a start far from the ball, an acceleration may be asked for that no slope gives: slopes
    are cut to 60 degrees and rates to 10 rad/s, far beyond any plate's.

    Raises:
        ValueError: If the poles are not four or eight, or not two for the plate, not stable or not
            in conjugate pairs.
    """

    name: ClassVar[str] = "nonlinear_luenberger"

    poles: tuple[Pole, ...] = with_entries((-4, -5, -7, -8), along_x=4)
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
        sine = cut(z[..., 2] / self._k, MAX_TILT_SINE)
        z[..., 2] = np.arcsin(sine)
        z[..., 3] = cut(z[..., 3] / (self._k * np.sqrt(1 - sine * sine)), MAX_BALL_SPEED_M_S)
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
    """Gain G for a chain of n integrators with a measured first state, by Ackermann's formula.

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
"""Measurements of the plate, True: they are valid without a touch as well."""


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

    Q: tuple[Positive, Positive] = with_entries(DISTURBANCE_VARIANCES, along_x=1)
    """Intensities of the disturbance of u1, u2 in (rad/s^2)^2 s; Table B.1."""
    R: tuple[Positive, Positive, Positive, Positive] = with_entries(NOISE_VARIANCES, along_x=2)
    """Intensities of the noise of x, phi, y, theta in m^2 s and rad^2 s; Table B.1."""
    spread: Annotated[tuple[Positive, ...], Len(8, 8)] | None = with_entries(None, along_x=4)
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
            y, R = np.where(felt, y, x[..., OUTPUT_SLICE]), np.where(felt, R, math.inf)
        # rows of C P, and the innovation as a further column that is treated as they are
        W = np.empty((*x.shape[:-1], len(MEASURED_STATES), 9), x.dtype)
        W[..., :8] = P[..., OUTPUT_SLICE, :]
        W[..., 8] = y - x[..., OUTPUT_SLICE]
        for j, i in enumerate(MEASURED_STATES):
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
        step = np.empty((*x.shape, 11), x.dtype)
        step[:] = self._once
        step[..., 1::4, :] = ball
        step[..., 0::2, 10] = T * x[..., 1::2]
        second = ball[..., :8] @ step
        step += self._rest
        step[..., 0::4, :] += T * (ball / 2 + second / 6)
        step[..., 1::4, :] += second / 2
        F, G, d = step[..., :8], step[..., 8:10], step[..., 10]
        self.x = x + d + (G @ (u / self._deviation)[..., np.newaxis])[..., 0]
        FP_G = np.empty((*x.shape, 10), x.dtype)
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
