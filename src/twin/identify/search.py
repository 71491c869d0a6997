"""Finds the best fit without a first guess: rolling first, then the breakaway, then all at once."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from controllers.arrays import Array, Mask
from controllers.ballplate import BallPlate
from twin.identify.bootstrap import Estimate, estimate
from twin.identify.levenberg_marquardt import Termination, fit_starts, minimise
from twin.identify.parameters import BALL
from twin.identify.problem import Linearisation, Problem
from twin.identify.windows import Windows

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
class FitResult:
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
        free, _ = self.linearisation.eliminate_starts()
        r, J = free[0, ..., 0], free[0, ..., 1:]  # noqa: N806
        weight = self.problem.weights(self.linearisation.r)[0]
        return estimate(
            self.theta,
            np.einsum("wmi,wmj,w->wij", J, J, weight),
            np.einsum("wmi,wm,w->wi", J, r, weight),
            np.einsum("wmi,wmj,w->ij", J, J, weight**2),
        )


def search(model: BallPlate, windows: Windows, names: tuple[str, ...], grip: float) -> FitResult:
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
    every = found.linearisation
    return FitResult(
        problem=problem,
        theta=found.theta[best[0]],
        starts=found.starts[:, best],
        linearisation=Linearisation(every.r[best], every.by_start[best], every.by_parameter[best]),
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
