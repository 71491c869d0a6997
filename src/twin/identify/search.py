"""Finds the best fit from nothing: rolling first, then what it takes to start, then all at once."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from controllers.arrays import Array
from controllers.ballplate import BallPlate
from twin.identify.descend import descend, settle
from twin.identify.motion import plate_motion
from twin.identify.parameters import BALL
from twin.identify.phases import spans
from twin.identify.prepare import Data
from twin.identify.problem import Linear, Problem
from twin.identify.windows import LOOKBACK, Windows

LONGEST = 2.5
"""Longest window in s: long enough for friction to add up, short enough to forget a bad start."""
RATIOS = 1 + np.linspace(0, 2.2, 32) ** 1.3
"""Breakaway ratios that are tried."""
UNEXPLAINED = 2.0
"""Mean square misfit over the usual one from which on a window is left out at the end: where the
ball nearly comes to rest, a touch of noise decides whether it does, and no replay can know."""
STARTS = 3
"""So many of them are followed to their end."""


@dataclass(frozen=True)
class Fit:
    """The best fit found.

    Attributes:
        problem: What was fitted.
        theta: The parameters, shape (P,).
        starts: The ball's start in each window, shape (4, 1, W).
        linear: Residuals and slopes there, of one candidate.
        costs: What the candidates followed to their end came to, best first.
        values: And their parameters, shape (candidates, P).
        left_out: How many windows no candidate explains.
    """

    problem: Problem
    theta: Array
    starts: Array
    linear: Linear
    costs: Array
    values: Array
    left_out: int


def cut(data: Data, lag: float, longest: float = LONGEST) -> Windows | None:
    """All windows of the data; None if there are none.

    Args:
        data: What was recorded.
        lag: Time constant of the drives in s.
        longest: Longest window in s.
    """
    parts = []
    for stretch in data.stretches:
        motion = plate_motion(stretch.time, stretch.plate, stretch.command, lag, data.own_lag)
        begin, end = stretch.time[0] + LOOKBACK, min(stretch.time[-1], stretch.seen[-1])
        found = spans(stretch.time, stretch.even_ball, begin, end, longest)
        if len(found.begin):
            parts.append(Windows.cut(data.model, motion, stretch, found, data.sigma, longest))
    return Windows.join(parts) if parts else None


def search(model: BallPlate, windows: Windows, names: tuple[str, ...], grip: float) -> Fit:
    """Fit the parameters, from many starts; ``grip`` as in ``replay``.

    A ball that never starts moving in a replay tells the fit nothing, so its steps must begin near
    the truth: windows in which the ball rolls throughout give rolling friction, delay and level
    from any start; with those, the windows that begin at rest are tried with one breakaway ratio
    after another; from the best of these all windows and all parameters are fitted. Windows that
    are then not explained at all are left out, and the rest is fitted again.
    """
    problem = Problem(model, windows, names, grip)
    guesses = _refine(problem, _rolling(problem))
    starts = np.repeat(problem.starts(), len(guesses), axis=1)
    starts, _ = settle(problem, guesses, starts, 3)
    theta, starts, cost, linear = descend(problem, guesses, starts, 12)
    while True:
        misfit = problem.misfit(linear.r[np.argsort(cost)[:1]])[0]
        kept = misfit < UNEXPLAINED * max(1.0, float(np.median(misfit)))
        if kept.all() or kept.sum() < max(3, len(windows) / 2):
            break
        problem = replace(problem, windows=problem.windows.take(kept))
        theta, starts, cost, linear = descend(problem, theta, starts[:, :, kept], 12)
    order = np.argsort(cost)
    best = order[:1]
    linear = Linear(linear.r[best], linear.by_start[best], linear.by_parameter[best])
    left_out = len(windows) - len(problem.windows)
    return Fit(
        problem, theta[best[0]], starts[:, best], linear, cost[order], theta[order], left_out
    )


def _rolling(whole: Problem) -> Array:
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
    starts, _ = settle(problem, theta, np.repeat(problem.starts(), 4, axis=1), 2)
    theta, _, cost, _ = descend(problem, theta, starts, 8)
    for k, name in enumerate(smooth):
        first[:, names.index(name)] = theta[np.argmin(cost), k]
    return first


def _refine(problem: Problem, found: Array) -> Array:
    """The candidates with the breakaway ratios that suit the windows begun at rest, (C, P)."""
    windows, names = problem.windows, problem.names
    if not windows.resting.any():
        return found
    at_rest = replace(problem, windows=windows.take(windows.resting))
    tried = np.repeat(found, len(RATIOS), axis=0)
    tried[:, names.index("breakaway")] = np.tile(RATIOS, len(found))
    starts = np.repeat(at_rest.starts(), len(tried), axis=1)
    _, linear = settle(at_rest, tried, starts, 1)
    return np.asarray(tried[np.argsort(at_rest.cost(linear.r))[:STARTS]])
