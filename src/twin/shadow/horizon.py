"""How far the twin strays in an open loop from the smoothed state of a log, over its own spread.

At every start the ball's state is that which suits the samples before it. From there the twin goes
on by itself; the plate is the servos' response to the recorded commands, corrected by the encoders.
What the twin does not know, its state at the start and its parameters, is drawn as sigma points
(Julier and Uhlmann), so that a ball that may or may not stop has the spread that comes of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from controllers.arrays import Array, Mask
from twin.identify.levenberg_marquardt import fit_starts
from twin.identify.parameters import BALL as BOUNDS
from twin.identify.prepare import PreparedLog, Segment
from twin.identify.problem import Problem
from twin.identify.replay import STEP, AccelerationField
from twin.identify.windows import BIN, LOOKBACK, ROLL, Spans, Windows, cut, speed
from twin.shadow.belief import BALL, PARAMETERS, Belief

HORIZONS = (0.5, 1.0, 2.0)
"""Seconds ahead that may be chosen."""
LEAD = 0.4
"""Seconds of samples from which the state at a start is smoothed."""
MEDIAN, BAND = 2 * np.log(2.0), 5.991
"""Median and 95 % quantile of a chi-square of two degrees of freedom."""
ROWS = ("time", "error", "spread", "told", "path")
DRAWN = 5
"""Steps of a replay from one point of its path that is kept to the next."""
STEPS = 6
"""Gauss-Newton steps that look for the ball's start,"""
CONVERGED = 1e-4
"""and the decrease of the misfit, in noise variances, below which they are enough."""


@dataclass(frozen=True)
class Replays:
    """Replays of one horizon.

    Attributes:
        time: When each was started, s, shape (W,).
        ahead: Horizon in s.
        error: Measured ball minus replay at the horizon, m, shape (W, 2); NaN without a sample.
        spread: Predicted covariance of it, m^2, shape (W, 2, 2).
        told: Whether the ball moved, so that the replay can tell anything, shape (W,).
        path: Where the twin's ball is from the start on, every ``DRAWN`` steps, m, shape (W, N, 2).
    """

    time: Array
    ahead: float
    error: Array
    spread: Array
    told: Mask
    path: Array

    def take(self, which: Mask) -> Replays:
        """Some of them."""
        parts: dict[str, Any] = {name: getattr(self, name)[which] for name in ROWS}
        return replace(self, **parts)

    @classmethod
    def join(cls, parts: Sequence[Replays]) -> Replays:
        """All of several of one horizon."""
        rows: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in parts]) for name in ROWS
        }
        return replace(parts[0], **rows)

    @property
    def square(self) -> Array:
        """Squared error in units of the predicted spread, e' S^-1 e, shape (W,)."""
        solved = np.linalg.solve(self.spread, self.error[..., None])[..., 0]
        return np.asarray((self.error * solved).sum(axis=-1))

    @property
    def score(self) -> Array:
        """Error over predicted spread, scaled so that half of all are below 1, shape (W,)."""
        return np.asarray(np.sqrt(self.square / MEDIAN))

    @property
    def counted(self) -> Mask:
        """Those that tell something, shape (W,)."""
        return np.asarray(self.told & np.isfinite(self.error).all(axis=-1))


def replays(
    log: PreparedLog, belief: Belief, ahead: float, every: float, since: float = -np.inf
) -> Replays | None:
    """Replays of a log from many starts; None if it is too short for any.

    Args:
        log: What was recorded.
        belief: The twin.
        ahead: Horizon in s.
        every: Seconds between the starts of two replays.
        since: The first start in s, where the log goes back further.
    """

    def spans(segment: Segment, begin: float, end: float, longest: float) -> Spans:
        del segment
        begins = np.arange(max(begin, since - LEAD), end - longest, every)
        return Spans(begins, np.full(len(begins), longest), np.zeros(len(begins), bool))

    windows = cut(log, belief.lag, LEAD + ahead + BIN, spans)
    if windows is None:
        return None
    known = belief.problem(_lead(windows))
    points, weights = _sigma_points(known, belief)
    whole = belief.problem(windows)
    places, speeds = whole.replayed(points[0], points[1])
    delay = whole.values(points[0])["delay"]
    ball, _ = windows.at_samples(places, speeds, delay)
    at = windows.time - (LOOKBACK + LEAD + ahead)
    near = (np.abs(at) <= BIN / 2 + 1e-6) & (windows.weight[..., 0] > 0)
    rows, sample = np.arange(len(windows)), np.argmax(near, axis=1)
    drawn = ball[:, rows, sample]
    middle = np.einsum("c,cwi->wi", weights, drawn)
    away = drawn - middle
    noise = 1 / np.maximum(windows.weight[rows, sample], 1e-12) ** 2
    spread = np.einsum("c,cwi,cwj->wij", weights, away, away) + noise[..., None] * np.eye(2)
    error = np.where(near.any(axis=1)[:, None], windows.ball[rows, sample] - middle, np.nan)
    start = windows.begin + LOOKBACK + LEAD
    path = np.einsum("c,nicw->wni", weights, places)[:, round((LOOKBACK + LEAD) / STEP) :]
    path = path[:, : round(ahead / STEP) + 1 : DRAWN]
    return Replays(start, ahead, error, spread, _moving(log, start, ahead), path)


def _lead(windows: Windows) -> Windows:
    """The samples from which a start is smoothed, and as much of the field as they need."""
    bins, steps = round(LEAD / BIN) + 1, round((LOOKBACK + LEAD + BIN) / STEP) + 1
    before = windows.time[:, :bins] < LOOKBACK + LEAD
    field = {item.name: getattr(windows.field, item.name)[:steps] for item in fields(windows.field)}
    return replace(
        windows,
        field=AccelerationField(**field),
        time=windows.time[:, :bins],
        ball=windows.ball[:, :bins],
        weight=windows.weight[:, :bins] * before[..., None],
    )


def _sigma_points(problem: Problem, belief: Belief) -> tuple[tuple[Array, Array], Array]:
    """Parameters (C, P) and starts (4, C, W) that stand for all that may be, and weights (C,).

    The parameters vary by what is not known of them; with them goes the start that suits the
    samples then, and that varies by what the samples leave open.
    """
    theta = belief.theta
    starts, _ = fit_starts(problem, theta, problem.initial_starts(), STEPS, CONVERGED)
    line = problem.linearise(theta, starts)
    _, follow = line.eliminate_starts()
    Z = line.by_start[0]  # noqa: N806
    left = np.linalg.cholesky(np.linalg.inv(np.swapaxes(Z, -1, -2) @ Z + START_PRIOR))
    watched = [PARAMETERS.index(name) for name in BALL]
    sd = np.hypot(belief.constant, belief.changing[0])[watched]
    count = len(BALL) + 4
    reach = np.sqrt(count + KAPPA)
    thetas, begun = [theta[0]], [starts[:, 0]]
    for sign in (1.0, -1.0):
        for k in range(len(BALL)):
            moved = theta[0].copy()
            moved[k] = max(moved[k] + sign * reach * sd[k], BOUNDS[BALL[k]].least)
            thetas.append(moved)
            begun.append(starts[:, 0] - (moved[k] - theta[0, k]) * follow[0, :, :, 1 + k].T)
        for k in range(4):
            thetas.append(theta[0])
            begun.append(starts[:, 0] + sign * reach * left[:, :, k].T)
    weights = np.full(2 * count + 1, 1 / (2 * (count + KAPPA)))
    weights[0] = KAPPA / (count + KAPPA)
    return (np.array(thetas), np.stack(begun, axis=1)), weights


START_PRIOR = np.diag(np.array([0.02, 0.02, 0.3, 0.3]) ** -2.0)
"""As weak as that of a fit: positions within 20 mm, velocities within 0.3 m/s."""
KAPPA = 1.0
"""Weight of the middle point."""


def _moving(log: PreparedLog, start: Array, ahead: float) -> Mask:
    """Whether the ball rolls at all from each start to its horizon."""
    told = np.zeros(len(start), bool)
    for segment in log.segments:
        fast = np.concatenate(([0], np.cumsum(speed(segment.time, segment.even_ball) > ROLL)))
        inside = (start >= segment.time[0]) & (start <= segment.time[-1])
        first = np.searchsorted(segment.time, start[inside])
        last = np.searchsorted(segment.time, np.minimum(start[inside] + ahead, segment.time[-1]))
        told[inside] = fast[last] > fast[first]
    return told
