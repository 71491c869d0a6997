"""Levenberg-Marquardt for many candidates at once.

scipy's least_squares takes one start at a time and knows nothing of the structure: a handful of
common parameters and four numbers of each window's own, which are eliminated here. Replaying all
candidates and all finite differences in one batch makes a fit some twenty times as fast.
"""

from __future__ import annotations

import numpy as np

from controllers.arrays import Array
from twin.identify.parameters import BALL
from twin.identify.problem import LOOSE, Linear, Problem


def settle(problem: Problem, theta: Array, starts: Array, rounds: int) -> tuple[Array, Linear]:
    """Best starts of the ball for fixed parameters, every window for itself.

    Args:
        problem: What is fitted.
        theta: Parameters, shape (C, P).
        starts: First guess, shape (4, C, W).
        rounds: Damped Gauss-Newton steps.

    Returns:
        The starts, and the residuals there.
    """
    here = problem.look(theta, starts, slopes=False)
    square = problem.misfit(here.r)
    damping = np.ones_like(square)
    for _ in range(rounds):
        Zt = np.swapaxes(here.by_start, -1, -2)  # noqa: N806
        normal = Zt @ here.by_start + damping[..., None, None] * LOOSE
        step = np.linalg.solve(normal, Zt @ here.r[..., None])[..., 0]
        moved = starts - np.moveaxis(step, -1, 0)
        there = problem.look(theta, moved, slopes=False)
        better = problem.misfit(there.r) < square
        starts = np.where(better, moved, starts)
        here = there.best(here, better)
        square = problem.misfit(here.r)
        damping = np.where(better, damping / 3, damping * 30)
    return starts, here


def descend(
    problem: Problem, theta: Array, starts: Array, rounds: int
) -> tuple[Array, Array, Array, Linear]:
    """Better parameters, together with the starts.

    Args:
        problem: What is fitted.
        theta: First guesses, shape (C, P).
        starts: Starts that suit them, shape (4, C, W).
        rounds: Steps.

    Returns:
        Parameters, starts, costs (C,), and residuals with slopes there.
    """
    least = np.array([BALL[name].least for name in problem.names])
    most = np.array([BALL[name].most for name in problem.names])
    here = problem.look(theta, starts)
    cost = problem.cost(here.r)
    damping = np.full(len(theta), 1e-2)
    eye = np.eye(len(problem.names))
    tired = 0
    for _ in range(rounds):
        free, follow = here.eliminate()
        r, J = free[..., 0], free[..., 1:]  # noqa: N806
        weighted = np.swapaxes(J * problem.weights(here.r)[..., None, None], -1, -2)
        normal, slope = (weighted @ J).sum(axis=1), (weighted @ r[..., None]).sum(axis=1)
        size = np.diagonal(normal, axis1=-2, axis2=-1)[..., None] * eye
        damped = normal + damping[:, None, None] * size + 1e-9 * eye
        moved = np.clip(theta - np.linalg.solve(damped, slope)[..., 0], least, most)
        step = np.concatenate((np.ones((len(theta), 1)), moved - theta), axis=-1)
        shifted = starts - np.moveaxis(follow @ step[:, None, :, None], -2, 0)[..., 0]
        there = problem.look(moved, shifted)
        lower = problem.cost(there.r)
        better = lower < cost
        done = ~better | (cost - lower < 1e-5 * cost)
        theta = np.where(better[:, None], moved, theta)
        starts = np.where(better[:, None], shifted, starts)
        here = there.best(here, better)
        cost = np.where(better, lower, cost)
        damping = np.where(better, np.maximum(damping / 5, 1e-6), damping * 8)
        tired = tired + 1 if done.all() else 0
        if tired == 2:
            break
    return theta, starts, cost, here
