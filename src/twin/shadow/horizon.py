"""How far the twin, set to a log's smoothed state, strays within a horizon, over its own spread.

The plate is the servos' response to the recorded commands, corrected by the encoders. What the twin
does not know, its state at the start and its parameters, is drawn as sigma points (Julier and
Uhlmann), so that a ball that may or may not stop has the spread that comes of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from controllers.arrays import Array, Mask
from twin.identify.parameters import BALL as BOUNDS
from twin.identify.prepare import ROLL, PreparedLog, Segment, speed
from twin.identify.search import START_DIFFERENCES, START_PRIOR, fit_starts
from twin.identify.twin_model import Problem
from twin.identify.windows import (
    BIN,
    LOOKBACK,
    STEP,
    STRETCH,
    Spans,
    Windows,
    cut,
    edges_of,
    unknown_motion,
)
from twin.shadow.belief import BALL, PARAMETERS, Belief
from twin.shadow.evidence import clear, portions

AHEAD = 1.0
"""Seconds that replays go ahead: the horizon."""
LEAD = 1.2
"""Seconds of samples from which the state at a start is smoothed."""
UNKNOWN = 4e-4
"""Standard deviation in m/s^2 of what the plate's play and cams, too, do to a ball unknown to the
twin: as much as a tilt of 0.004 deg."""
STEPS = 6
"""Most Gauss-Newton steps that look for the ball's start."""


def smoothed(windows: Windows, belief: Belief) -> tuple[Array, Array, Array]:
    """What windows of ``LEAD`` say of the parameters and of the ball's state when they are over.

    Unknown are the parameters of ``BALL``, the ball's state where a window begins, and the forces
    nobody knows: those are estimated along (a smoother), so that where the ball is at the end does
    not rest on how it came there.

    Args:
        windows: W windows.
        belief: The twin.

    Returns:
        Mean (W, K) and covariance (W, K, K) of the deviations of ``BALL`` and of the state's four
        numbers x, y, x', y' at the end from what they are if the twin is right, and that, (4, W).
    """
    problem, theta, count = belief.problem(windows), belief.theta, len(BALL)
    starts = fit_starts(problem, theta, problem.initial_starts(), STEPS)
    line = problem.linearise(theta, starts)
    end, slopes, speeds = _end_state(problem, theta, starts)
    pushes = forces(belief, speeds)
    moved = turned(unknown_motion(windows, belief.values["delay"]), pushes)
    J = np.concatenate((line.by_parameter[0, ..., :count], line.by_start[0], moved), axis=-1)  # noqa: N806
    # standard deviations of the unknowns before anything is seen; what an uneven screen makes of
    # the parameters is left out, as the forces are unknowns of their own
    watched = [PARAMETERS.index(name) for name in BALL]
    variance = (belief.constant**2 + belief.changing[0] ** 2 - belief.uneven**2)[watched]
    sizes = np.ones(J.shape[-1])
    sizes[: count + 4] = *np.sqrt(variance), *np.diag(START_PRIOR) ** -0.5
    J = J * sizes  # noqa: N806
    Jt = np.swapaxes(J, -1, -2)  # noqa: N806
    covariance = np.linalg.inv(np.eye(len(sizes)) + Jt @ J)
    mean = -covariance @ Jt @ line.r[0][..., None]
    keep = np.broadcast_to(np.eye(count, len(sizes)), (len(J), count, len(sizes)))
    state = np.concatenate((slopes, turned(state_moved(windows), pushes)), axis=-1)
    onto = np.concatenate((keep, state), axis=1) * sizes
    spread = onto @ covariance @ np.swapaxes(onto, -1, -2)
    return (onto @ mean)[..., 0], (spread + np.swapaxes(spread, -1, -2)) / 2, end


def forces(belief: Belief, velocity: Array) -> Array:
    """What nobody knows pushes balls of some velocities (N, 2, W) with, as ``directed``."""
    return directed(velocity, belief.rough, np.hypot(belief.sloped, UNKNOWN))


def state_moved(windows: Windows) -> Array:
    """What the same accelerations add to x, y, x' and y' at the end of ``LEAD``, (4, 2 S)."""
    since = np.maximum(LEAD - edges_of(windows), 0.0)
    moved, hurried = -np.diff(since**2) / 2, -np.diff(since)
    return np.concatenate([np.kron(each, np.eye(2)) for each in (moved, hurried)])


def directed(velocity: Array, along: float, across: float) -> Array:
    """What turns unit accelerations of every ``STRETCH`` into the unknown ones, (W, S, 2, 2).

    What is unknown of the friction pushes along the ball's way, all else in any direction. The
    roots of their covariances.

    Args:
        velocity: Of the balls in m/s at every ``STEP``, shape (N, 2, W).
        along: Standard deviation in m/s^2 of what acts along the way.
        across: The same of what acts along each axis.
    """
    edges = np.arange(0, len(velocity) - 1, round(STRETCH / STEP))
    count = np.diff(edges, append=len(velocity))[:, None, None]
    way = np.moveaxis(np.add.reduceat(velocity, edges, axis=0) / count, 2, 0)
    heading = way / np.maximum(np.hypot(way[..., 0], way[..., 1]), 1e-9)[..., None]
    more = np.hypot(along, across) - across
    onward = heading[..., None] * heading[..., None, :]
    return np.asarray(more * onward + across * np.eye(2))


def unforeseen(forces: Array, ahead: float) -> Array:
    """Covariance in m^2 of where unknown accelerations take balls, shape (W, 2, 2).

    Args:
        forces: As ``directed`` gives them, shape (W, S, 2, 2).
        ahead: Seconds from the begin of the first.
    """
    edges = STRETCH * np.arange(forces.shape[1] + 1)
    moved = -np.diff(np.maximum(ahead - edges, 0.0) ** 2) / 2
    by = moved[:, None, None] * forces
    return np.asarray(np.einsum("wsij,wskj->wik", by, by))


def turned(columns: Array, forces: Array) -> Array:
    """Columns for unit accelerations as those for the unknown ones, shape (W, M, 2 S).

    Args:
        columns: Of both axes of every stretch, shape (W, M, 2 S) or (M, 2 S).
        forces: As ``directed`` gives them, shape (W, S, 2, 2).
    """
    split = columns.reshape(*columns.shape[:-1], -1, 2)[..., None, :]
    both = split @ forces[:, None, : split.shape[-3]]
    return np.asarray(both[..., 0, :].reshape(*both.shape[:-3], -1))


def _end_state(problem: Problem, theta: Array, starts: Array) -> tuple[Array, Array, Array]:
    """The ball's state (4, W) at the end of ``LEAD``, its slopes (W, 4, K), and its velocity.

    Slopes by the parameters of ``BALL`` and the start, by finite differences; velocity in m/s at
    every step, shape (N, 2, W).
    """
    steps = [BOUNDS[name].difference for name in BALL]
    size = np.array([*steps, *START_DIFFERENCES])
    thetas = np.repeat(theta, 1 + len(size), axis=0)
    begun = np.repeat(starts, 1 + len(size), axis=1)
    for k, step in enumerate(steps):
        thetas[1 + k, k] += step
    for k, step in enumerate(START_DIFFERENCES):
        begun[k, 1 + len(steps) + k] += step
    places, speeds = problem.replayed(thetas, begun)
    at = round(LEAD / STEP)
    states = np.concatenate((places[at], speeds[at]))
    size = np.where(size > 0, size, 1.0)
    slopes = np.moveaxis((states[:, 1:] - states[:, :1]) / size[:, None], 2, 0)
    return states[:, 0], slopes, speeds[:, :, 0]


KAPPA = 1.0
"""Weight of the middle sigma point."""


def _replayed(
    before: Windows, windows: Windows, belief: Belief, period: float
) -> tuple[Array, Array, Array]:
    """How far the balls are from where their twins are in the end, and how the twins went.

    Args:
        before: The windows up to the starts.
        windows: Those that are foreseen.
        belief: The twin.
        period: Seconds between the screen's samples.

    Returns:
        Error in m, shape (W, 2), NaN without a sample; predicted covariance of it in m^2, shape
        (W, 2, 2); places of the twins at every step from the start to the horizon, (W, N, 2).
    """
    points, weights = _sigma_points(before, belief)
    whole = belief.problem(windows)
    places, speeds = whole.replayed(*points)
    ball, _ = windows.at_samples(places, speeds, whole.values(points[0])["delay"])
    at = windows.time - (LOOKBACK + AHEAD)
    # a screen of slow frames has not one in every bin; the twin is asked for the sample's time
    away = np.where(windows.weight[..., 0] > 0, np.abs(at), np.inf)
    rows, sample = np.arange(len(windows)), np.argmin(away, axis=1)
    near = away[rows, sample] <= max(BIN, period) / 2 + 1e-6
    drawn = ball[:, rows, sample]
    middle = np.einsum("c,cwi->wi", weights, drawn)
    off = drawn - middle
    noise = 1 / np.maximum(windows.weight[rows, sample], 1e-12) ** 2
    spread = np.einsum("c,cwi,cwj->wij", weights, off, off) + noise[..., None] * np.eye(2)
    # the smoothed state is that at the begin of the windows, LOOKBACK before the start
    first, gone = round(LOOKBACK / STEP), LOOKBACK + AHEAD
    steps = round(gone / STEP) + 1
    way = np.einsum("c,nicw->niw", weights, speeds[:steps])
    spread += unforeseen(forces(belief, way), gone)
    error = np.where(near[:, None], windows.ball[rows, sample] - middle, np.nan)
    return error, spread, np.einsum("c,nicw->wni", weights, places[first:steps])


def _sigma_points(before: Windows, belief: Belief) -> tuple[tuple[Array, Array], Array]:
    """Parameters (C, W, P) and starts (4, C, W) for all that may be, and weights (C,).

    Both are what the samples before the start, and what is believed, make of them.
    """
    mean, covariance, end = smoothed(before, belief)
    windows, count = mean.shape
    side = np.sqrt(count + KAPPA) * np.swapaxes(np.linalg.cholesky(covariance), -1, -2)
    sides = np.moveaxis(np.stack((side, -side)), 2, 1)
    moved = mean + np.concatenate((np.zeros((1, windows, count)), *sides))
    every = np.tile(belief.theta[:, None], (len(moved), windows, 1))
    for k, name in enumerate(BALL):
        every[..., k] = np.maximum(every[..., k] + moved[..., k], BOUNDS[name].least)
    begun = end[:, None] + np.moveaxis(moved[..., len(BALL) :], -1, 0)
    weights = np.full(len(moved), 1 / (2 * (count + KAPPA)))
    weights[0] = KAPPA / (count + KAPPA)
    return (every, begun), weights


MEDIAN, BAND = 2 * np.log(2.0), 5.991
"""Median and 95 % quantile of a chi-square of two degrees of freedom."""
DRAWN = 5
"""Steps of a replay from one point of its path that is kept to the next."""


class Replays(NamedTuple):
    """Replays to the horizon.

    Attributes:
        time: When each was started, s, shape (W,).
        error: Measured ball minus replay at the horizon, m, shape (W, 2); NaN without a sample.
        spread: Predicted covariance of it, m^2, shape (W, 2, 2).
        told: Whether the ball moved, so that the replay can tell anything, shape (W,).
        path: Where the twin's ball is from the start on, every ``DRAWN`` steps, m, shape (W, N, 2).
    """

    time: Array
    error: Array
    spread: Array
    told: Mask
    path: Array

    def take(self, which: Mask) -> Replays:
        """Some of them."""
        return Replays._make(each[which] for each in self)

    @classmethod
    def join(cls, parts: Sequence[Replays]) -> Replays:
        """All of several."""
        return cls(*map(np.concatenate, zip(*parts, strict=True)))

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
    def distance(self) -> Array:
        """Length of the error, m, shape (W,)."""
        return np.hypot(self.error[:, 0], self.error[:, 1])

    @property
    def band(self) -> Array:
        """How far the 95 % ellipse reaches in the direction of the error, m, shape (W,)."""
        return np.asarray(self.distance * np.sqrt(BAND / np.maximum(self.square, 1e-12)))

    @property
    def counted(self) -> Mask:
        """Those that tell something, shape (W,)."""
        return np.asarray(self.told & np.isfinite(self.error).all(axis=-1))


def replays(
    log: PreparedLog,
    belief: Belief,
    gaps: Array,
    every: float = AHEAD,
    since: float = -np.inf,
    until: float = np.inf,
) -> Replays | None:
    """Replays of a log from many starts; None if it is too short for any.

    Args:
        log: What was recorded.
        belief: The twin.
        gaps: Of the log; a replay over one tells nothing.
        every: Seconds between the starts of two replays.
        since: The first start in s, where a log goes back further.
        until: Seconds; of replays that end later there is none.
    """

    def spans(later: float, length: float) -> Callable[[Segment, float, float, float], Spans]:
        def chosen(segment: Segment, begin: float, end: float, longest: float) -> Spans:
            del segment, longest
            last = min(end, until) - (LEAD + AHEAD + BIN)
            begins = np.arange(max(begin, since - LEAD), last, every) + later
            return Spans(begins, np.full(len(begins), length), np.zeros(len(begins), bool))

        return chosen

    before = cut(log, belief.lag, LEAD, spans(0.0, LEAD))
    after = cut(log, belief.lag, AHEAD + BIN, spans(LEAD, AHEAD + BIN))
    if before is None or after is None:
        return None
    start = after.begin + LOOKBACK
    parts = [
        _replayed(before.take(part), after.take(part), belief, log.sample_period)
        for part in portions(len(start))
    ]
    error, spread, path = (np.concatenate(each) for each in zip(*parts, strict=True))
    told = _moving(log, start) & clear(start - LEAD - LOOKBACK, start + AHEAD, gaps)
    return Replays(start, error, spread, told, path[:, ::DRAWN])


def _moving(log: PreparedLog, start: Array) -> Mask:
    """Whether the ball rolls at all from each start to its horizon."""
    told = np.zeros(len(start), bool)
    for segment in log.segments:
        fast = np.concatenate(([0], np.cumsum(speed(segment.time, segment.even_ball) > ROLL)))
        inside = (start >= segment.time[0]) & (start <= segment.time[-1])
        first = np.searchsorted(segment.time, start[inside])
        last = np.searchsorted(segment.time, np.minimum(start[inside] + AHEAD, segment.time[-1]))
        told[inside] = fast[last] > fast[first]
    return told
