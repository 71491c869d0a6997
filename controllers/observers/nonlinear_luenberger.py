"""Nonlinear Luenberger-like observer (7.10)-(7.13) on the flat model, from the ball alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from controllers.arrays import Array
from controllers.interfaces import Measurement, Observer
from controllers.observers.innovation import innovation
from controllers.observers.luenberger import axis_poles
from controllers.observers.sampling import sample
from controllers.poles import Pole, stable_poles

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
    gain: Array = np.linalg.solve(A, G).real / T ** np.arange(n)
    return gain
