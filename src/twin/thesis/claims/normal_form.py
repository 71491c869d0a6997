"""Equilibria (5.33), relative degree (6.16), decoupling (6.19) and zero dynamics (6.36)."""

# ruff: noqa: N806 - equations of the thesis in its letters

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from controllers.arrays import Array
from controllers.ballplate import ACCELERATION, BALL, BallPlate
from twin.thesis.claims.taylor import flow

PLATE = [2, 3, 6, 7]
"""The internal states eta of (6.32)."""


def equilibrium(x: float, y: float, k: tuple[int, int] = (0, 0)) -> Array:
    """The resting state (5.33): ball anywhere, plate angles k pi; each its own k. Shape (8,)."""
    return np.array([x, 0, k[0] * math.pi, 0, y, 0, k[1] * math.pi, 0])


def input_jacobians(model: BallPlate, x: Array) -> tuple[Array, Array]:
    """Dg1 and Dg2, exact, each of shape (..., 8, 8)."""
    drift = flow(model, x, 1).Phi[1]
    return flow(model, x, 1, (1, 0)).Phi[1] - drift, flow(model, x, 1, (0, 1)).Phi[1] - drift


def input_bracket(model: BallPlate, x: Array) -> Array:
    """The bracket [g1, g2] (6.25), shape (..., 8); zero, so internal coordinates exist."""
    g = model.g(x)
    g1, g2 = g[..., :1], g[..., 1:]
    Dg1, Dg2 = input_jacobians(model, x)
    out: Array = (Dg2 @ g1 - Dg1 @ g2)[..., 0]
    return out


def relative_degree(model: BallPlate, x: Array) -> tuple[int, int]:
    """Relative degree of the outputs x and y at one state (6.16), shape (8,), if it is 4 or less.

    The smallest r with L_g L_f^(r-1) h != 0; as d(L_f^k h) = k! C Phi_k, no formula is needed.
    """
    Phi = flow(model, x, 3).Phi
    first = np.abs(Phi[:, BALL] @ model.g(x)).max(axis=-1) > 1e-12
    return int(first[:, 0].argmax()) + 1, int(first[:, 1].argmax()) + 1


def decoupling(model: BallPlate, x: Array) -> Array:
    """Decoupling matrix A(x) of (6.19), shape (..., 2, 2)."""
    return model.g(x)[..., ACCELERATION, :]


def decoupling_determinant(model: BallPlate, x: Array) -> Array:
    """Det A(x) = -c2 (c2 cos(phi) - c1 x sin(phi)), shape (...,), in m^2.

    Unlike the thesis says below (6.20), A is not invertible everywhere: tan(phi) = c4 / x.
    """
    A = decoupling(model, x)
    out: Array = A[..., 0, 0] * A[..., 1, 1] - A[..., 0, 1] * A[..., 1, 0]
    return out


def internal(model: BallPlate, x: Array) -> Array:
    """Four coordinates that no input moves directly, L_g tau = 0 (6.27), shape (..., 4).

    (6.30) of the thesis solves (6.27) only with k1 = 1 and k2 = -c2; these are simpler, and
    unlike (6.32) solve it.
    """
    x1, x2, x3, x4, x5, x6, x7, x8 = (x[..., i] for i in range(8))
    s3, c3 = np.sin(x3), np.cos(x3)
    tau = (
        x3,
        x7,
        x2 + model.c2 * x4 - model.c1 * x5 * s3 * x8,
        x6 - model.c1 * (-x1 * s3 + model.c4 * c3) * x8,
    )
    return np.stack(tau, axis=-1)


def zero_dynamics(model: BallPlate, eta: Array) -> Array:
    """Motion of the plate that keeps the ball on the centre (6.36).

    Args:
        model: The exact model.
        eta: phi, phi', theta, theta', shape (..., 4).

    Returns:
        Rate of eta, shape (..., 4).
    """
    x = np.zeros((*eta.shape[:-1], 8))
    x[..., PLATE] = eta
    f = model.f(x)[..., ACCELERATION]
    u = np.linalg.solve(decoupling(model, x), -f[..., np.newaxis])[..., 0]
    return model.derivative(x, u)[..., PLATE]


class Zeros(NamedTuple):
    """Eigenvalues of the linear zero dynamics in 1/s.

    Attributes:
        found: Of (6.36), linearised, largest first, shape (4,).
        formula: +-sqrt(g / c4), +-sqrt(c1 g / c2), which coincide (6.39), shape (4,).
        printed: Of the matrix as printed in (6.38), which lacks a factor g, shape (4,).
    """

    found: Array
    formula: Array
    printed: Array


def zeros(model: BallPlate) -> Zeros:
    """Eigenvalues (6.39) of the zero dynamics about the level plate."""
    step = 1e-4
    ahead = step * np.eye(4)
    A = (zero_dynamics(model, ahead) - zero_dynamics(model, -ahead)).T / (2 * step)
    both = math.sqrt(model.gravity / model.c4), math.sqrt(model.c1 / model.c2 * model.gravity)
    slip = math.sqrt(model.c1 / model.c2)
    return Zeros(
        found=_descending(np.linalg.eigvals(A).real),
        formula=_descending(np.array([*both, *np.negative(both)])),
        printed=_descending(np.array([both[0], -both[0], slip, -slip])),
    )


def _descending(values: Array) -> Array:
    return np.sort(values)[::-1]
