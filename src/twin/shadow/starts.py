"""Where the ball began in every window, each for itself until it suits the samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from controllers.arrays import Array
from twin.identify.problem import Problem

CONVERGED = 1e-4
"""Decrease of the misfit, in noise variances, below which a start is good enough."""


def settled(problem: Problem, theta: Array, starts: Array, step_limit: int) -> Array:
    """The best starts for fixed parameters, by damped Gauss-Newton steps, shape (4, C, W).

    Windows share nothing, so one that has converged is not replayed again.

    Args:
        problem: What is fitted.
        theta: Parameters, shape (C, P).
        starts: First guess, shape (4, C, W).
        step_limit: Most steps.
    """
    found = starts.copy()
    left = np.arange(len(problem.windows))
    line = problem.linearise(theta, starts, slopes=False)
    misfit = problem.misfit(line.r)
    damping = np.ones_like(misfit)
    for _ in range(step_limit):
        moved = starts - line.start_step(damping)
        trial = problem.linearise(theta, moved, slopes=False)
        reached = problem.misfit(trial.r)
        better = reached < misfit
        starts = np.where(better, moved, starts)
        found[..., left] = starts
        going = np.asarray((np.abs(misfit - reached) >= CONVERGED).any(axis=0))
        if not going.any():
            break
        line = trial.where(better, line).take(going)
        misfit = np.where(better, reached, misfit)[:, going]
        damping = np.where(better, damping / 3, damping * 30)[:, going]
        starts, left = starts[..., going], left[going]
        problem = replace(problem, windows=problem.windows.take(going))
    return found
