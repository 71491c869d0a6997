"""Finds the best fit without a first guess: rolling first, then the breakaway, then all at once.

Levenberg-Marquardt for many candidates at once: scipy's least_squares takes one start at a time and
knows nothing of the structure, a handful of common parameters and four numbers of each window's
own, which are eliminated here. Replaying all candidates and all finite differences in one batch
makes a fit some twenty times as fast.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from controllers.arrays import Array, Mask
from controllers.ballplate import BallPlate
from twin.identify.bootstrap import Estimate, estimate
from twin.identify.parameters import BALL
from twin.identify.problem import Fitting, Linearisation, Problem
from twin.identify.windows import Windows

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


def fit_starts(problem: Fitting, theta: Array, starts: Array, step_limit: int) -> Array:
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
        rest: Any = problem
        problem = replace(rest, windows=rest.windows.take(going))
    return found


def minimise(
    problem: Fitting,
    theta: Array,
    starts: Array,
    step_limit: int,
    patience: int = 2,
    polish: int = 0,
) -> Minimum:
    """Fit the parameters together with the starts, from each of C first guesses.

    Args:
        problem: What is fitted.
        theta: First guesses, shape (C, P).
        starts: Starts that suit them, shape (4, C, W).
        step_limit: Most steps.
        patience: So many steps one after another that gain nothing end it.
        polish: Steps by which starts are fitted to the parameters of a step before it is judged.
    """
    least, most = problem.bounds
    current = problem.linearise(theta, starts)
    cost = problem.cost(current.r)
    damping = np.full(len(theta), 1e-2)
    eye = np.eye(len(problem.names))
    rejected, decrease = np.zeros(len(theta), dtype=int), np.zeros(len(theta))
    idle = np.zeros(len(theta), dtype=int)
    steps = 0
    while steps < step_limit and (idle < patience).any():
        steps += 1
        # starts that a step would throw too far are held back with the parameters
        free, follow = current.eliminate_starts(np.maximum(damping - 1.0, 0.0))
        r, J = free[..., 0], free[..., 1:]  # noqa: N806
        weighted = np.swapaxes(J * problem.weights(current.r)[..., None, None], -1, -2)
        normal, slope = (weighted @ J).sum(axis=1), (weighted @ r[..., None]).sum(axis=1)
        # what stands at a bound and would go beyond stays there, and the others know it
        held = ((theta <= least) & (slope[..., 0] > 0)) | ((theta >= most) & (slope[..., 0] < 0))
        slope = np.where(held[..., None], 0.0, slope)
        normal = np.where(held[..., None] | held[..., None, :], 0.0, normal)
        # Marquardt's scaling by the diagonal, so that no unit matters
        scale = np.diagonal(normal, axis1=-2, axis2=-1)[..., None] * eye
        damped = normal + damping[:, None, None] * scale + 1e-9 * eye
        moved = np.clip(theta - np.linalg.solve(damped, slope)[..., 0], least, most)
        step = np.concatenate((np.ones((len(theta), 1)), moved - theta), axis=-1)
        shifted = starts - np.moveaxis(follow @ step[:, None, :, None], -2, 0)[..., 0]
        if polish:
            shifted = fit_starts(problem, moved, shifted, polish)
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
    reason = CONVERGED if idle[best] >= patience else STEP_LIMIT
    termination = Termination(reason, steps, step_limit, int(rejected[best]), float(decrease[best]))
    return Minimum(theta, starts, cost, current, termination)


BREAKAWAY_RATIOS = 1 + np.linspace(0, 2.2, 32) ** 1.3
"""Breakaway ratios that are tried."""
FITTED_GUESSES = 3
"""This many of them, the best, are first guesses of a full fit."""
UNEXPLAINED = 2.0
"""Mean square misfit over the usual one above which a window is left out at the end: where the
ball nearly comes to rest, a touch of noise decides whether it does, and no replay can know."""
CREEPS = float(stats.chi2.ppf(0.99, 2))
"""Noise variances by which a free speed at the start may seem to improve a window begun at rest."""


@dataclass(frozen=True)
class BestFit:
    """The best fit found.

    Attributes:
        problem: What was fitted.
        theta: The parameters, shape (P,).
        starts: The ball's start in each window, shape (4, 1, W).
        linearisation: Residuals and slopes there, of one candidate.
        cost: Its cost.
        left_out: How many windows no candidate explains.
        termination: How the last minimisation ended.
    """

    problem: Problem
    theta: Array
    starts: Array
    linearisation: Linearisation
    cost: float
    left_out: int
    termination: Termination

    def estimate(self) -> Estimate:
        """The parameters and their uncertainty, every window an independent observation."""
        return estimated(self.problem, self.theta, self.linearisation)


def estimated(problem: Fitting, theta: Array, found: Linearisation) -> Estimate:
    """Parameters, shape (P,), and their uncertainty, every window an independent observation.

    Args:
        problem: What was fitted.
        theta: The fit.
        found: Residuals and slopes there, of one candidate.
    """
    free, _ = found.eliminate_starts()
    r, J = free[0, ..., 0], free[0, ..., 1:]  # noqa: N806
    weight = problem.weights(found.r)[0]
    return estimate(
        theta,
        np.einsum("wmi,wmj,w->wij", J, J, weight),
        np.einsum("wmi,wm,w->wi", J, r, weight),
        np.einsum("wmi,wmj,w->ij", J, J, weight**2),
    )


def search(model: BallPlate, windows: Windows, names: tuple[str, ...], grip: float) -> BestFit:
    """Fit the parameters, from many starts; ``grip`` as in ``replay``.

    A ball that never starts moving in a replay tells the fit nothing, so its steps must begin near
    the truth: windows in which the ball rolls throughout give rolling friction, delay and level
    from any start; with those, the windows that begin at rest are tried with one breakaway ratio
    after another; from the best of these all windows and all parameters are fitted. Windows that
    are then not explained at all are left out, and the rest is fitted again; so is all if in some
    windows the ball did not rest at first, but crept.
    """
    problem = Problem(model, windows, names, grip)
    guesses = _scan_breakaway(problem, _fit_rolling(problem))
    starts = np.repeat(problem.initial_starts(), len(guesses), axis=1)
    starts = fit_starts(problem, guesses, starts, 3)
    found = minimise(problem, guesses, starts, 12)
    while True:
        best = np.argsort(found.cost)[:1]
        misfit = problem.misfit(found.linearisation.r[best])[0]
        kept = misfit < UNEXPLAINED * max(1.0, float(np.median(misfit)))
        if kept.all() or kept.sum() < max(3, len(windows) / 2):
            break
        problem = replace(problem, windows=problem.windows.take(kept))
        found = minimise(problem, found.theta, found.starts[:, :, kept], 12)
    creeping = _creeping(problem, found.theta[best], found.starts[:, best])
    if creeping.any():
        crept = np.isin(windows.begin, problem.windows.begin[creeping])
        resting = windows.resting & ~crept
        return search(model, replace(windows, resting=resting), names, grip)
    return BestFit(
        problem=problem,
        theta=found.theta[best[0]],
        starts=found.starts[:, best],
        linearisation=Linearisation(*(part[best] for part in found.linearisation[:3])),
        cost=float(found.cost[best[0]]),
        left_out=len(windows) - len(problem.windows),
        termination=found.termination,
    )


def _creeping(problem: Problem, theta: Array, starts: Array) -> Mask:
    """Windows begun at rest that a ball which creeps at first explains better, shape (W,)."""
    windows = problem.windows
    free = replace(problem, windows=replace(windows, resting=np.zeros_like(windows.resting)))
    going = fit_starts(free, theta, free.initial_starts(), 8)
    rest, roll = (
        problem.misfit(problem.linearise(theta, each, slopes=False).r)[0] * windows.size
        for each in (starts, going)
    )
    return np.asarray(windows.resting & (rest - roll > CREEPS))


def _fit_rolling(whole: Problem) -> Array:
    """Candidates for all parameters from the windows that begin in full roll, shape (C, P)."""
    windows, names = whole.windows, whole.names
    smooth = tuple(name for name in names if name not in ("breakaway", "stribeck", "dwell"))
    first = np.array([[BALL[name].start for name in names]])
    rolling = ~windows.resting
    if rolling.sum() < 3:
        found = np.repeat(first, 4, axis=0)
        found[:, names.index("rolling")] = (5e-5, 1e-4, 2e-4, 4e-4)
        return found
    problem = replace(whole, windows=windows.take(rolling), names=smooth)
    theta = np.array([[BALL[name].start for name in smooth]]).repeat(4, axis=0)
    theta[:, smooth.index("rolling")] = (1e-4, 1e-4, 4e-4, 4e-4)
    theta[:, smooth.index("delay")] = (0.02, 0.07, 0.02, 0.07)
    starts = fit_starts(problem, theta, np.repeat(problem.initial_starts(), 4, axis=1), 2)
    minimum = minimise(problem, theta, starts, 8)
    for k, name in enumerate(smooth):
        first[:, names.index(name)] = minimum.theta[np.argmin(minimum.cost), k]
    return first


def _scan_breakaway(problem: Problem, guesses: Array) -> Array:
    """The guesses with the breakaway ratios that suit the windows begun at rest, shape (C, P)."""
    windows, names = problem.windows, problem.names
    if not windows.resting.any():
        return guesses
    at_rest = replace(problem, windows=windows.take(windows.resting))
    tried = np.repeat(guesses, len(BREAKAWAY_RATIOS), axis=0)
    tried[:, names.index("breakaway")] = np.tile(BREAKAWAY_RATIOS, len(guesses))
    starts = np.repeat(at_rest.initial_starts(), len(tried), axis=1)
    fitted = at_rest.linearise(tried, fit_starts(at_rest, tried, starts, 1), slopes=False)
    return np.asarray(tried[np.argsort(at_rest.cost(fitted.r))[:FITTED_GUESSES]])
