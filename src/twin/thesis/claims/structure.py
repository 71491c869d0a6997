"""Ranks of the nonlinear system: observability (5.12)-(5.21), controllability (5.24)-(5.29)."""

# ruff: noqa: N803, N806 - equations of the thesis in its letters

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array
from controllers.ballplate import MEASURED, BallPlate
from twin.thesis.claims.taylor import flow

TILT, TURN = math.radians(10), math.radians(35)
OPERATING = np.array((0.25, 0.25, TILT, TURN, 0.15, 0.25, TILT, TURN))
"""Bounds of the state in operation: area, plate angle and rate of chapter 3; ball to 0.25 m/s."""

ZERO = 1e-10
"""Share of the largest singular value below which one counts as zero; real zeros are at 1e-16."""


class Rank(NamedTuple):
    """Rank of a matrix and how clear it is.

    Attributes:
        rank: Shape (...,).
        weakest: Smallest singular value that counts, as a share of the largest, shape (...,).
    """

    rank: NDArray[np.integer]
    weakest: Array


def observability(
    model: BallPlate,
    x: Array,
    *,
    order: int = 7,
    u: Sequence[float] = (0.0, 0.0),
    outputs: Sequence[int] = MEASURED,
) -> Array:
    """Jacobian O(x) of the observability map (5.19), shape (..., (order + 1) outputs, 8).

    Row block k holds d(L_F^k h)/dx / k!; the factorial, no part of (5.18), changes no rank.

    Args:
        model: The exact model.
        x: States, shape (..., 8).
        order: Highest Lie derivative; the thesis takes 7.
        u: Constant input in rad/s^2.
        outputs: Indices of the measured states.
    """
    Phi = flow(model, x, order, u).Phi[..., list(outputs), :]
    out: Array = np.moveaxis(Phi, 0, -3).reshape(*x.shape[:-1], -1, 8)
    return out


def controllability(model: BallPlate, x: Array, *, order: int = 7) -> Array:
    """Controllability matrix Q(x) of (5.27), shape (..., 8, 2 (order + 1)).

    Columns 2k and 2k + 1 hold ad_f^k g1 / k! and ad_f^k g2 / k!, with the sign of (5.28).

    Args:
        model: The exact model.
        x: States, shape (..., 8).
        order: Highest bracket; the thesis takes 7.
    """
    _, Phi, g = flow(model, x, order)
    v = np.zeros_like(g)
    for k in range(order + 1):
        v[k] = g[k]
        for j in range(1, k + 1):
            v[k] -= Phi[j] @ v[k - j]
    out: Array = np.moveaxis(v, 0, -2).reshape(*x.shape[:-1], 8, -1)
    return out


def rank(O_or_Q: Array, *, columns_are_states: bool = False) -> Rank:
    """Rank by singular values, the states in units of the operating range.

    Args:
        O_or_Q: Q, shape (..., 8, n), or O, shape (..., n, 8).
        columns_are_states: True for O.
    """
    scaled = O_or_Q * OPERATING if columns_are_states else O_or_Q / OPERATING[:, np.newaxis]
    values = np.linalg.svd(scaled, compute_uv=False)
    counts = values > ZERO * values[..., :1]
    found = counts.sum(axis=-1)
    last = np.take_along_axis(values, found[..., np.newaxis] - 1, axis=-1)[..., 0]
    return Rank(found, last / values[..., 0])


def operating_grid() -> Array:
    """Combinations of lower bound, zero and upper bound of the state, shape (2916, 8).

    Without those of negative x or y, which are mirror images: the model does not change with the
    signs of x, x', phi, phi' together, nor with those of y, y', theta, theta'.
    """
    levels = [(0, 1) if state in MEASURED[0::2] else (-1, 0, 1) for state in range(8)]
    out: Array = np.array(list(itertools.product(*levels))) * OPERATING
    return out


def determinant_at_rest(model: BallPlate, x: Array) -> Array:
    """Determinant of (g1 g2 ad_f g1 ad_f g2 ... ad_f^3 g2) for a plate that does not move.

    c1^4 g^4 (1 - c1 sin(phi)^2)^2 cos(phi)^2 cos(theta)^4, derived symbolically. As c1 < 1, a
    plate at rest loses rank only at phi = +-pi/2 or theta = +-pi/2, wherever the ball is.

    Args:
        model: The exact model.
        x: States, shape (..., 8); only the plate angles matter.
    """
    phi, theta = x[..., 2], x[..., 6]
    scale = (model.c1 * model.gravity) ** 4
    gyroscopic = 1 - model.c1 * np.sin(phi) ** 2
    out: Array = scale * gyroscopic**2 * np.cos(phi) ** 2 * np.cos(theta) ** 4
    return out


@dataclass(frozen=True)
class SingularCase:
    """A condition after (5.29) under which the thesis states the rank of Q, or should.

    Attributes:
        condition: In words.
        fixed: Index of a state to its value; the other states are free.
        thesis: Rank according to the thesis.
        note: What else there is to say.
    """

    condition: str
    fixed: Mapping[int, float]
    thesis: int
    note: str

    def ranks(self, model: BallPlate, *, samples: int = 20, seed: int = 0) -> list[int]:
        """Ranks that occur with the free states random in the operating range."""
        x = np.random.default_rng(seed).uniform(-1, 1, (samples, 8)) * OPERATING
        for index, value in self.fixed.items():
            x[:, index] = value
        return sorted({int(r) for r in rank(controllability(model, x)).rank})


UPRIGHT = math.pi / 2
SINGULAR_CASES = (
    SingularCase(
        "theta = pi/2, phi = phi' = theta' = 0",
        {2: 0, 3: 0, 6: UPRIGHT, 7: 0},
        4,
        "for every position and velocity of the ball",
    ),
    SingularCase(
        "phi = pi/2, phi' = theta' = 0",
        {2: UPRIGHT, 3: 0, 7: 0},
        6,
        "for every theta and ball; but * = 0 and diamond = 0 only with the ball at 0",
    ),
    SingularCase(
        "theta = pi/2, phi' = theta' = 0, phi = 0.1",
        {2: 0.1, 3: 0, 6: UPRIGHT, 7: 0},
        8,
        "an 'other case' of the thesis, yet singular for every phi",
    ),
    SingularCase(
        "theta = -pi/2, phi = phi' = theta' = 0",
        {2: 0, 3: 0, 6: -UPRIGHT, 7: 0},
        8,
        "the mirror image of the first case",
    ),
    SingularCase(
        "phi = -pi/2, phi' = theta' = 0",
        {2: -UPRIGHT, 3: 0, 7: 0},
        8,
        "the mirror image of the second case",
    ),
    *(
        SingularCase(
            f"{angle} = pi/2, the plate moving", {i: UPRIGHT}, 8, "for nearly every motion"
        )
        for angle, i in (("theta", 6), ("phi", 2))
    ),
)
