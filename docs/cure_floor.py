# ruff: noqa: N803, N806  matrices have the letters of the field
"""How well any controller could do at first on an uneven screen: the floor of cure.md.

Along the ball's way the friction of an uneven screen is a random disturbance w. About the motion
that the reference asks for, the flat output eta and the slope a of the plate along the way are

    eta'' = k1 a + w,    a'' = u,    x = eta - c2 a,

and a screen tells x with its noise, a dead time late. Of all controllers that know w only by what
it did so far, the linear-quadratic Gaussian one has the least mean square of x. It is given all
else: the statistics of w, mean friction, level, the slope without error, drives without lag or
play, and any effort. On one screen a controller may do better than that mean over screens, on the
worst of many it does worse; on a way that comes again, one that remembers w may do better.

w: the friction's relative deviations are drawn at the points of a grid and are straight between
them. Averaged over the places in a cell their variance is 4/9 of that at the points, and half of
their correlation is left after 0.65 of a cell. They are taken as white noise through two equal low
passes, whose rate follows from that and the ball's speed.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy

from controllers.arrays import Array
from controllers.ballplate import BallPlate

NOISE = (7.2538e-7 + 1.7721e-7) / 2
"""Variance of a touch sample in m^2, Table B.1, mean of both axes."""
PERIOD, EFFORT = 0.002, 1e-8
"""s; and the weight of u^2 in s^4 m^2 beside x^2: so small that less changes nothing."""
THESIS_BALL = BallPlate()
HALF, SHARE = 0.65, 4 / 9
LEFT = 1.6783
"""Where (1 + t) exp(-t) is one half."""


class Screen(NamedTuple):
    """What is uneven, and how it is seen."""

    rolling_mm: float
    spread: float
    """Standard deviation of the relative friction at the points of the grid."""
    frame_rate: float
    """Frames a second; 0 for one every control period."""
    dead_time: float
    patch: float = 0.05


def floor(
    screen: Screen, speed: float, model: BallPlate = THESIS_BALL, noise: float = NOISE
) -> float:
    """Least root mean square of x in m for a ball that rolls at a speed in m/s.

    Args:
        screen: What is uneven, and how it is seen.
        speed: Of the ball.
        model: The ball, by default that of the thesis.
        noise: Variance of a sample in m^2.
    """
    friction = model.k1 * screen.rolling_mm / 1000 / model.radius
    rate = LEFT * speed / (HALF * screen.patch)
    variance = SHARE * (friction * screen.spread) ** 2
    # eta, eta', a, a', w, w'
    A: Array = np.zeros((6, 6))
    A[0, 1] = A[1, 4] = A[2, 3] = A[4, 5] = 1
    A[1, 2], A[5, 4], A[5, 5] = model.k1, -(rate**2), -2 * rate
    B: Array = np.zeros((6, 1))
    W: Array = np.zeros((6, 6))
    B[3], W[5, 5] = 1, 4 * rate**3 * variance
    seen = np.array([[1, 0, -model.c2, 0, 0, 0]])
    A, B, W = _sampled(A, B, W)
    A, B, W, C = _late(A, B, W, seen, round(screen.dead_time / PERIOD))
    slower = 1 / (PERIOD * screen.frame_rate) if screen.frame_rate else 1.0
    R = np.diag([noise * slower, 1e-10])
    P = scipy.linalg.solve_discrete_are(A.T, C.T, W, R)
    x = np.zeros((1, len(A)))
    x[:, :6] = seen
    X = scipy.linalg.solve_discrete_are(A, B, x.T @ x + 1e-14 * np.eye(len(A)), [[EFFORT]])
    L = np.linalg.solve(EFFORT + B.T @ X @ B, B.T @ X @ A)
    K = A @ P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
    # the state and the error of its estimate
    both = np.block([[A - B @ L, B @ L], [np.zeros_like(A), A - K @ C]])
    driven = np.block([[W, W], [W, W + K @ R @ K.T]])
    S = scipy.linalg.solve_discrete_lyapunov(both, driven)[: len(A), : len(A)]
    return float(np.sqrt((x @ S @ x.T).item()))


def _sampled(A: Array, B: Array, W: Array) -> tuple[Array, Array, Array]:
    """The same from period to period: A and B under a held input, and the noise (Van Loan 1978)."""
    n = len(A)
    held = scipy.linalg.expm(PERIOD * np.block([[A, B], [np.zeros((1, n + 1))]]))
    noise = scipy.linalg.expm(PERIOD * np.block([[-A, W], [np.zeros((n, n)), A.T]]))
    return held[:n, :n], held[:n, n:], noise[n:, n:].T @ noise[:n, n:]


def _late(
    A: Array, B: Array, W: Array, seen: Array, late: int
) -> tuple[Array, Array, Array, Array]:
    """With what is seen kept for so many periods, and C: the oldest is measured, and the slope."""
    n = len(A)
    longer = np.zeros((n + late, n + late))
    longer[:n, :n], longer[n, :n] = A, seen
    longer[n + 1 :, n:-1] = np.eye(late - 1)
    C = np.zeros((2, n + late))
    C[0, -1] = C[1, 2] = 1
    W = scipy.linalg.block_diag(W + 1e-18 * np.eye(n), np.zeros((late, late)))
    return longer, np.vstack((B, np.zeros((late, 1)))), W, C


def least(scenario: Any, radius: float, omega: float) -> float:
    """The floor of a circle of a radius in m at a rate in rad/s on a rig, in % of the radius."""
    touch, plant = scenario.sensors.touch, scenario.plant
    spread = plant.surface.spread_percent / 100
    screen = Screen(plant.friction.rolling_mm, spread, touch.frame_rate, touch.dead_time)
    return 100 * floor(screen, radius * omega) / radius
