"""Levenberg-Marquardt for many candidates at once.

scipy's least_squares takes one start at a time and knows nothing of the structure: a handful of
common parameters and four numbers of each window's own, which are eliminated here. Replaying all
candidates and all finite differences in one batch makes a fit some twenty times as fast.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from controllers.arrays import Array
from twin.identify.parameters import BALL
from twin.identify.problem import Linearisation, Problem

TOLERANCE = 1e-5
"""Relative decrease of the cost below which a step counts as none."""
SETTLED = 1e-4
"""Change of a window's misfit, in noise variances, below which its starts suit it."""
CONVERGED, STEP_LIMIT = "converged", "step limit reached"


@dataclass(frozen=True)
class Termination:
    """How a minimisation ended for its best candidate.

    Attributes:
        reason: ``converged``: in the last two steps its cost fell by no more than ``TOLERANCE``;
            or ``step limit reached``.
        steps: Steps taken, rejected ones included.
        step_limit: Most steps it might have taken.
        rejected_steps: Steps that were rejected since its cost would have risen.
        last_decrease: By how much the last accepted step lowered the cost, relative to it.
    """

    reason: str
    steps: int
    step_limit: int
    rejected_steps: int
    last_decrease: float

    def __str__(self) -> str:
        """In words."""
        if self.reason == CONVERGED:
            return f"the fit converged after {self.steps} steps"
        return (
            f"the fit stopped at its limit of {self.step_limit} steps; the last accepted one "
            f"lowered its cost by {100 * self.last_decrease:.2g} %"
        )


class Minimum(NamedTuple):
    """What a minimisation of C candidates found.

    Attributes:
        theta: Parameters, shape (C, P).
        starts: x, y, x', y' of the ball at the beginning of each window, shape (4, C, W).
        cost: Costs, shape (C,).
        linearisation: Residuals and slopes there.
        termination: How it ended.
    """

    theta: Array
    starts: Array
    cost: Array
    linearisation: Linearisation
    termination: Termination


def fit_starts(problem: Problem, theta: Array, starts: Array, step_limit: int) -> Array:
    """The best starts for fixed parameters, by damped Gauss-Newton steps, shape (4, C, W).

    Windows share nothing, so one whose starts suit it is not replayed again.

    Args:
        problem: What is fitted.
        theta: Parameters, shape (C, P), or (C, W, P) if they differ from window to window.
        starts: First guess, shape (4, C, W).
        step_limit: Most steps.
    """
    theta = np.broadcast_to(
        theta if theta.ndim > 2 else theta[:, None], (*starts.shape[1:], theta.shape[-1])
    )
    found = starts.copy()
    left = np.arange(len(problem.windows))
    current = problem.linearise(theta, starts, slopes=False)
    misfit = problem.misfit(current.r)
    damping = np.ones_like(misfit)
    for _ in range(step_limit):
        moved = starts - current.start_step(damping)
        trial = problem.linearise(theta, moved, slopes=False)
        reached = problem.misfit(trial.r)
        better = reached < misfit
        starts = np.where(better, moved, starts)
        found[..., left] = starts
        going = np.asarray((np.abs(misfit - reached) >= SETTLED).any(axis=0))
        if not going.any():
            break
        current = trial.where(better, current).take(going)
        misfit = np.where(better, reached, misfit)[:, going]
        damping = np.where(better, damping / 3, damping * 30)[:, going]
        starts, theta, left = starts[..., going], theta[:, going], left[going]
        problem = replace(problem, windows=problem.windows.take(going))
    return found


def minimise(problem: Problem, theta: Array, starts: Array, step_limit: int) -> Minimum:
    """Fit the parameters together with the starts, from each of C first guesses.

    Args:
        problem: What is fitted.
        theta: First guesses, shape (C, P).
        starts: Starts that suit them, shape (4, C, W).
        step_limit: Most steps.
    """
    least = np.array([BALL[name].least for name in problem.names])
    most = np.array([BALL[name].most for name in problem.names])
    current = problem.linearise(theta, starts)
    cost = problem.cost(current.r)
    damping = np.full(len(theta), 1e-2)
    eye = np.eye(len(problem.names))
    rejected, decrease = np.zeros(len(theta), dtype=int), np.zeros(len(theta))
    idle = np.zeros(len(theta), dtype=int)
    steps = 0
    while steps < step_limit and (idle < 2).any():
        steps += 1
        free, follow = current.eliminate_starts()
        r, J = free[..., 0], free[..., 1:]  # noqa: N806
        weighted = np.swapaxes(J * problem.weights(current.r)[..., None, None], -1, -2)
        normal, slope = (weighted @ J).sum(axis=1), (weighted @ r[..., None]).sum(axis=1)
        # Marquardt's scaling by the diagonal, so that no unit matters
        scale = np.diagonal(normal, axis1=-2, axis2=-1)[..., None] * eye
        damped = normal + damping[:, None, None] * scale + 1e-9 * eye
        moved = np.clip(theta - np.linalg.solve(damped, slope)[..., 0], least, most)
        step = np.concatenate((np.ones((len(theta), 1)), moved - theta), axis=-1)
        shifted = starts - np.moveaxis(follow @ step[:, None, :, None], -2, 0)[..., 0]
        trial = problem.linearise(moved, shifted)
        trial_cost = problem.cost(trial.r)
        better = trial_cost < cost
        gained = better & (cost - trial_cost >= TOLERANCE * cost)
        theta = np.where(better[:, None], moved, theta)
        starts = np.where(better[:, None], shifted, starts)
        current = trial.where(better, current)
        decrease = np.where(better, (cost - trial_cost) / np.maximum(cost, 1e-300), decrease)
        cost = np.where(better, trial_cost, cost)
        damping = np.where(better, np.maximum(damping / 5, 1e-6), damping * 8)
        rejected += ~better
        idle = np.where(gained, 0, idle + 1)
    best = int(np.argmin(cost))
    reason = CONVERGED if idle[best] >= 2 else STEP_LIMIT
    termination = Termination(reason, steps, step_limit, int(rejected[best]), float(decrease[best]))
    return Minimum(theta, starts, cost, current, termination)
