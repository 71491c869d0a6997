"""The observers of chapter 7 as the thesis writes them: differential equations in continuous time.

The observers in ``controllers`` are discrete; these serve only to reproduce the thesis's tables,
and to check that the discrete ones tend to them.
"""

# ruff: noqa: N803, N806 - equations of the thesis in its letters

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from controllers.arrays import Array
from controllers.ballplate import BallPlate
from controllers.design import place_poles
from controllers.interfaces import Observer
from controllers.observers import ExtendedKalman, Kalman, Luenberger, NonlinearLuenberger
from controllers.observers.linear import axis_poles, bucy_covariance

OUTPUTS = slice(0, 8, 2)
"""The measured states x, phi, y, theta."""


@dataclass(frozen=True)
class Estimator(ABC):
    """x_hat' = model(x_hat, u) + L (y - h(x_hat)), with memory of its own beside x_hat."""

    model: BallPlate

    width = 0
    """Numbers of memory a rig."""

    def start(self, rigs: int) -> Array:
        """Memory at the origin, shape (N, width)."""
        return np.zeros((rigs, self.width))

    @abstractmethod
    def rate(self, x: Array, memory: Array, u: Array, e: Array) -> tuple[Array, Array]:
        """Rates of estimate (N, 8) and memory for input (N, 2) and innovation (N, 4)."""


@dataclass(frozen=True)
class ConstantGain(Estimator):
    """A gain that stays as it is, on the linear model (7.1) or on the exact one (7.9)."""

    L: Array
    exact: bool = False

    def rate(self, x: Array, memory: Array, u: Array, e: Array) -> tuple[Array, Array]:
        """Rates by (7.1) or (7.9)."""
        if self.exact:
            return self.model.derivative(x, u) + e @ self.L.T, memory
        A, B, _ = self.model.linear()
        return x @ A.T + u @ B.T + e @ self.L.T, memory


@dataclass(frozen=True)
class ExtendedKalmanBucy(Estimator):
    """(7.9) with the gain S C' R^-1 (7.17), S following the Riccati equation of (7.16) in time."""

    Q: Array
    R: Array
    input_terms: bool

    width = 64

    def start(self, rigs: int) -> Array:
        """The covariance in which the filter about the level plate settles."""
        A, B, C = self.model.linear()
        S = bucy_covariance(A, B, C, np.diag(self.Q), np.diag(self.R))
        return np.tile(S.ravel(), (rigs, 1))

    def rate(self, x: Array, memory: Array, u: Array, e: Array) -> tuple[Array, Array]:
        """Rates by (7.9) and S' = A S + S A' - S C' R^-1 C S + g Q g'."""
        S = memory.reshape(-1, 8, 8)
        A = self.model.jacobian(x, u if self.input_terms else None)
        g = self.model.g(x)
        L = S[:, :, OUTPUTS] / self.R
        AS = A @ S
        slope = AS + AS.swapaxes(1, 2) - L @ S[:, OUTPUTS] + (g * self.Q) @ g.swapaxes(1, 2)
        gained = self.model.derivative(x, u) + (L @ e[..., None])[..., 0]
        return gained, slope.reshape(memory.shape)


@dataclass(frozen=True)
class FlatLuenberger(Estimator):
    """(7.11) with the gain O(x)^-1 G of (7.13), from the ball's position alone."""

    G: Array

    def rate(self, x: Array, memory: Array, u: Array, e: Array) -> tuple[Array, Array]:
        """Rates by (7.11)."""
        out = self.model.flat(x, u)
        k = self.model.k1 * np.array((1.0, -1.0))
        axes = x.reshape(-1, 2, 4)
        sine, cosine, turn = np.sin(axes[..., 2]), np.cos(axes[..., 2]), axes[..., 3]
        L = self.G * e[:, 0::2, None]
        L[..., 2] /= k * cosine
        L[..., 3] = (L[..., 3] / k + sine * turn * L[..., 2]) / cosine
        return out + L.reshape(x.shape), memory


def continuous(observer: Observer) -> Estimator:
    """The continuous-time form of an observer with its settings.

    Raises:
        TypeError: If there is none.
    """
    model = observer.model
    A = model.linear().A
    match observer:
        case Luenberger():
            return ConstantGain(model, _placed(A, axis_poles(observer.poles)))
        case Kalman():
            return ConstantGain(model, kalman_gain(model, observer.Q, observer.R))
        case ExtendedKalman():
            Q, R = np.array(observer.Q), np.array(observer.R)
            return ExtendedKalmanBucy(model, Q, R, observer.input_terms)
        case NonlinearLuenberger(plate_observer=False):
            poles = axis_poles(observer.poles)
            return FlatLuenberger(model, np.array([np.poly(mine)[1:].real for mine in poles]))
        case _:
            raise TypeError(f"no continuous form of {observer!r}")


def kalman_gain(model: BallPlate, Q: tuple[float, ...], R: tuple[float, ...]) -> Array:
    """Gain S C' R^-1 (7.8) about the level plate, shape (8, 4)."""
    A, B, C = model.linear()
    S = bucy_covariance(A, B, C, np.diag(Q), np.diag(R))
    L: Array = S @ C.T / np.array(R)
    return L


def _placed(A: Array, poles: tuple[tuple[complex, ...], ...]) -> Array:
    """Gain that gives A - L C the poles, axis by axis, shape (8, 4)."""
    L = np.zeros((8, 4))
    for axis, mine in enumerate(poles):
        own, outputs = slice(4 * axis, 4 * axis + 4), slice(2 * axis, 2 * axis + 2)
        C = np.eye(4)[0::2]
        L[own, outputs] = place_poles(A[own, own].T, C.T, mine).T
    return L
