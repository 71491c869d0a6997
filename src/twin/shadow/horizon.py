"""How far the twin, set to a log's smoothed state, strays within a horizon, over its own spread.

The plate is the servos' response to the recorded commands, corrected by the encoders. What the twin
does not know, its state at the start and its parameters, is drawn as sigma points (Julier and
Uhlmann), so that a ball that may or may not stop has the spread that comes of it. A screen that is
rough here and smooth there takes a ball the same way when it comes there again: a map of the
friction is learnt from the ways that lead to the starts, and the replays roll over it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from controllers.arrays import Array, Mask
from controllers.observers.friction_map import gaussian_field
from twin.identify.least_squares import START_DIFFERENCES, START_PRIOR, fit_starts
from twin.identify.parameters import BALL_PARAMETERS as BOUNDS
from twin.identify.prepare import ROLL_SPEED_M_S, PreparedLog, Segment, speed
from twin.identify.twin_fit import TwinProblem
from twin.identify.windows import (
    FORCE_STRETCH_S,
    LOOKBACK_S,
    REPLAY_STEP_S,
    SAMPLE_BIN_S,
    Spans,
    Windows,
    cut,
    edges_of,
    unknown_motion,
)
from twin.shadow.belief import BALL_BELIEFS, MIN_UNEVENNESS, WATCHED_PARAMETERS, Belief
from twin.shadow.evidence import clear, portions, posterior
from twin.sim.plant.friction import SurfaceMap

HORIZON_S = 1.0
"""Seconds that replays go ahead: the horizon."""
LEAD_S = 1.2
"""Seconds of samples from which the state at a start is smoothed."""
UNKNOWN_ACCELERATION_STD = 4e-4
"""Standard deviation in m/s^2 of what the plate's play and cams, too, do to a ball unknown to the
twin: as much as a tilt of 0.004 deg."""
MAX_HORIZON_STEPS = 6
"""Most Gauss-Newton steps that look for the ball's start."""


FRICTION_MAP_SPACING_M = 0.045
"""Distance in m between the points of a map, at most."""
CORRELATION_LENGTH = 0.6
"""Length over which the friction is held to be alike, in patches of the screen."""
UNMAPPED_SHARE = 0.3
"""Share of the unevenness that no map of such points can show."""
MAX_STRETCH_MISFIT = 4.0
"""Mean square by which a way moves the friction of its stretches, over its expected variance: more
is nothing that a screen does."""
MAP_FORGETTING_S = 3600.0
"""Time in s after which a screen's friction has changed, by dust and wear."""
MAP_QUERY_STEPS = 5
"""Steps of a replay from one place at which a map is asked to the next."""
MAP_LEARNING_INTERVAL_S = 1.0
"""Seconds from one way that a map learns from to the next, at least: what two of them share is
counted twice."""


class FrictionMap:
    """Relative deviation m of the rolling friction at the points of a grid, straight between them.

    They are a Gaussian field that slowly changes,

        E m(p, t) m(q, t + h) = s^2 exp(-|p - q|^2 / (2 l^2)) exp(-|h| / T),

    and what is learnt of them adds up (Kalman).

    Args:
        belief: States how uneven the screen is, and the size of its patches.
    """

    def __init__(self, belief: Belief) -> None:
        plant = belief.scenario.plant
        patch, spread = plant.surface.patch_mm / 1000, plant.surface.spread_percent / 100
        shown = min(1.0, patch / FRICTION_MAP_SPACING_M)
        self.left = np.hypot(
            MIN_UNEVENNESS, spread * np.hypot(UNMAPPED_SHARE, np.sqrt(1 - shown**2))
        )
        """Standard deviation of what the map does not show."""
        length = CORRELATION_LENGTH * max(patch, FRICTION_MAP_SPACING_M)
        self.grid, self._prior = gaussian_field(
            plant.size, FRICTION_MAP_SPACING_M, shown * spread, length
        )
        units = np.eye(len(self._prior)).reshape(-1, *self.grid)
        self._units = SurfaceMap(relative=units, size=plant.size)
        self.mean, self.covariance = np.zeros(len(self._prior)), self._prior
        """At the points, shapes (n,) and (n, n)."""
        self.until = -np.inf
        """When what has been learnt ends, s."""

    def shares(self, places: Array) -> Array:
        """Share of every point in places in m, from shape (..., 2) to (..., n)."""
        return self._units(places[..., None, :])[0]

    def learn(self, rows: Array, mean: Array, covariance: Array, until: float) -> None:
        """Take in what has been found of the friction in S stretches up to a time in s.

        Args:
            rows: Share of every point in the stretches, shape (S, n).
            mean: Of the deviations, with what the map knew of them, shape (S,).
            covariance: Of the same, shape (S, S).
            until: Seconds.
        """
        kept = np.exp((self.until - until) / MAP_FORGETTING_S)
        self.mean, self.until = kept * self.mean, until
        self.covariance = kept**2 * self.covariance + (1 - kept**2) * self._prior
        known, news = self.known(rows), mean - rows @ self.mean
        gain = np.linalg.solve(known, rows @ self.covariance).T
        if news @ np.linalg.solve(known, news) <= MAX_STRETCH_MISFIT * len(news):
            self.mean = self.mean + gain @ news
            self.covariance = self.covariance - gain @ (known - covariance) @ gain.T

    def known(self, rows: Array) -> Array:
        """Covariance of the deviations in stretches that show rows (S, n), shape (S, S)."""
        return rows @ self.covariance @ rows.T + self.left**2 * np.eye(len(rows))


class Smoothed(NamedTuple):
    """Prediction from windows of ``LEAD`` on what follows.

    Attributes:
        mean: Of the deviations of ``BALL_BELIEFS`` and of the state's four numbers x, y, x', y' at
            the end from what they are if the twin is right, shape (W, K).
        covariance: Of the same, shape (W, K, K).
        end: That state if the twin is right, shape (4, W).
        friction: Relative friction of every place as known by then.
        unsure: Variance of it.
    """

    mean: Array
    covariance: Array
    end: Array
    friction: SurfaceMap
    unsure: SurfaceMap


def smooth(windows: Windows, belief: Belief, screen: FrictionMap, whole: Mask) -> Smoothed:
    """What windows say of the parameters, the ball's state when they are over, and the friction.

    Unknown are the parameters of ``BALL_BELIEFS``, the ball's state where a window begins, the
    forces that nobody knows, and by how much the friction differs on each stretch of the way: all
    are estimated along (a smoother), so that where the ball is at the end does not rest on how it
    came there.

    Args:
        windows: W windows.
        belief: The twin.
        screen: Learns from one window after the other.
        whole: From which it may, shape (W,).
    """
    problem, theta, count = belief.problem(windows), belief.theta, len(BALL_BELIEFS)
    starts = fit_starts(problem, theta, problem.initial_starts(), MAX_HORIZON_STEPS)
    line = problem.linearise(theta, starts)
    end, slopes, places, speeds = _end_state(problem, theta, starts)
    pushes, slowed = forces(belief, speeds), braking(belief, speeds)
    unknown, onto = unknown_motion(windows, belief.values["delay"]), state_moved(windows)
    moved = [to_acceleration_columns(unknown, each) for each in (pushes, slowed)]
    J = np.concatenate((line.by_parameter[0, ..., :count], line.by_start[0], *moved), axis=-1)  # noqa: N806
    # covariance of the unknowns before anything is seen; what an uneven screen makes of
    # the parameters is left out, as the friction and the forces are unknowns of their own
    watched = [WATCHED_PARAMETERS.index(name) for name in BALL_BELIEFS]
    variance = (belief.constant**2 + belief.changing[0] ** 2 - belief.uneven**2)[watched]
    others, all_of = J.shape[-1] - slowed.shape[1], J.shape[-1]
    prior = np.eye(all_of)
    np.fill_diagonal(prior[: count + 4, : count + 4], [*variance, *1 / np.diag(START_PRIOR)])
    keep = np.broadcast_to(np.eye(count, all_of), (len(J), count, all_of))
    state = np.concatenate(
        (slopes, *(to_acceleration_columns(onto, each) for each in (pushes, slowed))), axis=-1
    )
    onto = np.concatenate((keep, state), axis=1)
    found = []
    for w, start in enumerate(windows.begin):
        rows = stretches(screen.shares(places[:-1:MAP_QUERY_STEPS, :, w]), MAP_QUERY_STEPS)
        prior[others:, others:] = screen.known(rows)
        expected = np.concatenate((np.zeros(others), rows @ screen.mean))
        score = -J[w].T @ line.r[0, w]
        mean, covariance = posterior(J[w].T @ J[w], score, prior, expected)
        if whole[w] and start > screen.until + MAP_LEARNING_INTERVAL_S - 1e-6:
            screen.learn(rows, mean[others:], covariance[others:, others:], float(start))
        spread = onto[w] @ covariance @ onto[w].T
        variances = np.maximum(np.diag(screen.covariance), 0.0) + screen.left**2
        found.append((onto[w] @ mean, (spread + spread.T) / 2, screen.mean, variances))
    mean, covariance, known, variances = (np.stack(each) for each in zip(*found, strict=True))
    friction, unsure = (
        SurfaceMap(relative=each.reshape(-1, *screen.grid), size=belief.scenario.plant.size)
        for each in (np.maximum(1 + known, 0.0), variances)
    )
    return Smoothed(mean, covariance, end, friction, unsure)


def stretches(values: Array, every: int = 1) -> Array:
    """Means over each ``STRETCH`` of values at one in so many steps, shape (N, ...)."""
    edges = np.arange(0, len(values), round(FORCE_STRETCH_S / REPLAY_STEP_S) // every)
    count = np.diff(edges, append=len(values))
    means = np.add.reduceat(values, edges, axis=0)
    return np.asarray(means / count.reshape(-1, *[1] * (values.ndim - 1)))


def forces(belief: Belief, velocity: Array) -> Array:
    """What turns unit accelerations of every ``STRETCH`` into the unknown ones, (W, S, 2, 2)."""
    many = velocity.shape[2], len(stretches(velocity[:-1])), 2, 2
    return np.broadcast_to(np.hypot(belief.sloped, UNKNOWN_ACCELERATION_STD) * np.eye(2), many)


def braking(belief: Belief, velocity: Array) -> Array:
    """What twice the friction slows balls by in every ``STRETCH``, m/s^2, shape (W, S, 2, 1).

    A ball that hardly moves has as much friction as it takes to hold it, whatever there is.

    Args:
        belief: The twin.
        velocity: Of the balls in m/s at every ``STEP``, shape (N, 2, W).
    """
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    heading = velocity / np.where(speed > ROLL_SPEED_M_S, speed, np.inf)[:, None]
    size = belief.model.k1 * belief.values["rolling"] / belief.model.radius
    return np.asarray(-size * np.moveaxis(stretches(heading[:-1]), 2, 0)[..., None])


def state_moved(windows: Windows) -> Array:
    """What the same accelerations add to x, y, x' and y' at the end of ``LEAD``, (4, 2 S)."""
    since = np.maximum(LEAD_S - edges_of(windows), 0.0)
    moved, hurried = -np.diff(since**2) / 2, -np.diff(since)
    return np.concatenate([np.kron(each, np.eye(2)) for each in (moved, hurried)])


def unforeseen(forces: Array, ahead: float) -> Array:
    """Covariance in m^2 of where unknown accelerations take balls, shape (W, 2, 2).

    Args:
        forces: As ``forces`` or ``braking`` gives them, shape (W, S, 2, R).
        ahead: Seconds from the begin of the first.
    """
    edges = FORCE_STRETCH_S * np.arange(forces.shape[1] + 1)
    moved = -np.diff(np.maximum(ahead - edges, 0.0) ** 2) / 2
    by = moved[:, None, None] * forces
    return np.asarray(np.einsum("wsij,wskj->wik", by, by))


def to_acceleration_columns(columns: Array, forces: Array) -> Array:
    """Columns for unit accelerations as those for the unknown ones, shape (W, M, R S).

    Args:
        columns: Of both axes of every stretch, shape (W, M, 2 S) or (M, 2 S).
        forces: As ``forces`` or ``braking`` gives them, shape (W, S, 2, R).
    """
    split = columns.reshape(*columns.shape[:-1], -1, 2)[..., None, :]
    both = split @ forces[:, None, : split.shape[-3]]
    return np.asarray(both[..., 0, :].reshape(*both.shape[:-3], -1))


def _end_state(
    problem: TwinProblem, theta: Array, starts: Array
) -> tuple[Array, Array, Array, Array]:
    """The ball's state (4, W) at the end of ``LEAD``, its slopes (W, 4, K), and the way to it.

    Slopes by the parameters of ``BALL_BELIEFS`` and the start, by finite differences; places in m
    and velocities in m/s at every step, shape (N, 2, W).
    """
    steps = [BOUNDS[name].difference for name in BALL_BELIEFS]
    size = np.array([*steps, *START_DIFFERENCES])
    thetas = np.repeat(theta, 1 + len(size), axis=0)
    begun = np.repeat(starts, 1 + len(size), axis=1)
    for k, step in enumerate(steps):
        thetas[1 + k, k] += step
    for k, step in enumerate(START_DIFFERENCES):
        begun[k, 1 + len(steps) + k] += step
    places, speeds = problem.replay(thetas, begun)
    at = round(LEAD_S / REPLAY_STEP_S)
    states = np.concatenate((places[at], speeds[at]))
    size = np.where(size > 0, size, 1.0)
    slopes = np.moveaxis((states[:, 1:] - states[:, :1]) / size[:, None], 2, 0)
    return states[:, 0], slopes, places[:, :, 0], speeds[:, :, 0]


SIGMA_POINT_WEIGHT = 1.0
"""Weight of the middle sigma point."""


def _replay(
    before: Smoothed, windows: Windows, belief: Belief, period: float
) -> tuple[Array, Array, Array]:
    """How far the balls are from where their twins are in the end, and how the twins went.

    Args:
        before: What the windows up to the starts say.
        windows: Those that are foreseen.
        belief: The twin.
        period: Seconds between the screen's samples.

    Returns:
        Error in m, shape (W, 2), NaN without a sample; predicted covariance of it in m^2, shape
        (W, 2, 2); places of the twins at every step from the start to the horizon, (W, N, 2).
    """
    points, weights = _sigma_points(before, belief)
    whole = belief.problem(windows)
    uneven = belief.scenario.plant.surface.spread_percent > 0
    places, speeds = whole.replay(*points, before.friction if uneven else None)
    ball, _ = windows.at_samples(places, speeds, whole.values(points[0])["delay"])
    at = windows.time - (LOOKBACK_S + HORIZON_S)
    # a screen of slow frames has not one in every bin; the twin is asked for the sample's time
    away = np.where(windows.weight[..., 0] > 0, np.abs(at), np.inf)
    rows, sample = np.arange(len(windows)), np.argmin(away, axis=1)
    near = away[rows, sample] <= max(SAMPLE_BIN_S, period) / 2 + 1e-6
    drawn = ball[:, rows, sample]
    middle = np.einsum("c,cwi->wi", weights, drawn)
    off = drawn - middle
    noise = 1 / np.maximum(windows.weight[rows, sample], 1e-12) ** 2
    spread = np.einsum("c,cwi,cwj->wij", weights, off, off) + noise[..., None] * np.eye(2)
    # the smoothed state is at the begin of the windows, LOOKBACK before the start
    first, elapsed = round(LOOKBACK_S / REPLAY_STEP_S), LOOKBACK_S + HORIZON_S
    steps = round(elapsed / REPLAY_STEP_S) + 1
    way, going = (np.einsum("c,nicw->niw", weights, each[:steps]) for each in (places, speeds))
    unsure = stretches(before.unsure(np.moveaxis(way[:-1], 1, -1))[0]).T
    braked = np.sqrt(unsure)[..., None, None] * braking(belief, going)
    spread += unforeseen(forces(belief, going), elapsed) + unforeseen(braked, elapsed)
    error = np.where(near[:, None], windows.ball[rows, sample] - middle, np.nan)
    return error, spread, np.moveaxis(way[first:], -1, 0)


def _sigma_points(before: Smoothed, belief: Belief) -> tuple[tuple[Array, Array], Array]:
    """Parameters (C, W, P) and starts (4, C, W) for all that may be, and weights (C,).

    Both are what the samples before the start, and what is believed, make of them.
    """
    mean, covariance, end, *_ = before
    windows, count = mean.shape
    side = np.sqrt(count + SIGMA_POINT_WEIGHT) * np.swapaxes(np.linalg.cholesky(covariance), -1, -2)
    sides = np.moveaxis(np.stack((side, -side)), 2, 1)
    moved = mean + np.concatenate((np.zeros((1, windows, count)), *sides))
    every = np.tile(belief.theta[:, None], (len(moved), windows, 1))
    for k, name in enumerate(BALL_BELIEFS):
        about, believed = BOUNDS[name], every[..., k]
        most = np.maximum(about.most, believed)
        every[..., k] = np.clip(believed + moved[..., k], about.least, most)
    begun = end[:, None] + np.moveaxis(moved[..., len(BALL_BELIEFS) :], -1, 0)
    weights = np.full(len(moved), 1 / (2 * (count + SIGMA_POINT_WEIGHT)))
    weights[0] = SIGMA_POINT_WEIGHT / (count + SIGMA_POINT_WEIGHT)
    return (every, begun), weights


CHI_SQUARE_MEDIAN, CHI_SQUARE_95 = 2 * np.log(2.0), 5.991
"""Median and 95 % quantile of a chi-square of two degrees of freedom."""
CHI_SQUARES = {1: (0.4549, 3.841), 2: (CHI_SQUARE_MEDIAN, CHI_SQUARE_95)}
"""The same by degrees of freedom, the number of axes."""
PATH_STEPS = 5
"""Steps of a replay from one point of its path that is kept to the next."""


class Replays(NamedTuple):
    """Replays to the horizon.

    Attributes:
        time: When each was started, s, shape (W,).
        error: Measured ball minus replay at the horizon, m, shape (W, 2); NaN without a sample.
        spread: Predicted covariance of it, m^2, shape (W, 2, 2).
        moved: Whether the ball moved, so that the replay shows anything, shape (W,).
        path: Where the twin's ball is from the start on, every ``DRAWN`` steps, m, shape (W, N, 2).
        axes: Number of axes of the rig; of 1 the second error is 0.
    """

    time: Array
    error: Array
    spread: Array
    moved: Mask
    path: Array
    axes: int = 2

    def take(self, which: Mask) -> Replays:
        """Some of them."""
        return Replays._make((*(each[which] for each in self[:-1]), self.axes))

    @classmethod
    def join(cls, parts: Sequence[Replays]) -> Replays:
        """All of several."""
        every = zip(*(part[:-1] for part in parts), strict=True)
        return cls._make((*map(np.concatenate, every), parts[0].axes))

    @property
    def square(self) -> Array:
        """Squared error in units of the predicted spread, e' S^-1 e, shape (W,)."""
        solved = np.linalg.solve(self.spread, self.error[..., None])[..., 0]
        return np.asarray((self.error * solved).sum(axis=-1))

    @property
    def score(self) -> Array:
        """Error over predicted spread, scaled so that half of all are below 1, shape (W,)."""
        return np.asarray(np.sqrt(self.square / CHI_SQUARES[self.axes][0]))

    @property
    def distance(self) -> Array:
        """Length of the error, m, shape (W,)."""
        return np.hypot(self.error[:, 0], self.error[:, 1])

    @property
    def band(self) -> Array:
        """How far the 95 % ellipse reaches in the direction of the error, m, shape (W,)."""
        most = CHI_SQUARES[self.axes][1]
        return np.asarray(self.distance * np.sqrt(most / np.maximum(self.square, 1e-12)))

    @property
    def inside(self) -> Mask:
        """Whether the error is within the 95 % ellipse, shape (W,)."""
        return np.asarray(self.square <= CHI_SQUARES[self.axes][1])

    @property
    def counted(self) -> Mask:
        """Windows in which the ball moved and the error is finite, shape (W,)."""
        return np.asarray(self.moved & np.isfinite(self.error).all(axis=-1))


def replays(
    log: PreparedLog,
    belief: Belief,
    gaps: Array,
    every: float = HORIZON_S,
    since: float = -np.inf,
    until: float = np.inf,
    screen: FrictionMap | None = None,
) -> Replays | None:
    """Replays of a log from many starts; None if it is too short for any.

    Args:
        log: What was recorded.
        belief: The twin.
        gaps: Of the log; a replay over one tells nothing.
        every: Seconds between the starts of two replays.
        since: The first start in s, where a log goes back further.
        until: Seconds; of replays that end later there is none.
        screen: Learns on; by default one of which nothing is known.
    """
    screen = screen or FrictionMap(belief)

    def spans(later: float, length: float) -> Callable[[Segment, float, float, float], Spans]:
        def chosen(segment: Segment, begin: float, end: float, longest: float) -> Spans:
            del segment, longest
            last = min(end, until) - (LEAD_S + HORIZON_S + SAMPLE_BIN_S)
            begins = np.arange(max(begin, since - LEAD_S), last, every) + later
            return Spans(begins, np.full(len(begins), length), np.zeros(len(begins), bool))

        return chosen

    before = cut(log, belief.lag, LEAD_S, spans(0.0, LEAD_S))
    after = cut(log, belief.lag, HORIZON_S + SAMPLE_BIN_S, spans(LEAD_S, HORIZON_S + SAMPLE_BIN_S))
    if before is None or after is None:
        return None
    start = after.begin + LOOKBACK_S
    whole = clear(before.begin, before.begin + LOOKBACK_S + LEAD_S, gaps)
    parts = []
    for part in portions(len(start)):
        found = smooth(before.take(part), belief, screen, whole[part])
        parts.append(_replay(found, after.take(part), belief, log.sample_period))
    error, spread, path = (np.concatenate(each) for each in zip(*parts, strict=True))
    moved = _moving(log, start) & clear(start - LEAD_S - LOOKBACK_S, start + HORIZON_S, gaps)
    return Replays(start, error, spread, moved, path[:, ::PATH_STEPS], log.axes)


def _moving(log: PreparedLog, start: Array) -> Mask:
    """Whether the ball rolls at all from each start to its horizon."""
    moved = np.zeros(len(start), bool)
    for segment in log.segments:
        fast = np.concatenate(
            ([0], np.cumsum(speed(segment.time, segment.even_ball) > ROLL_SPEED_M_S))
        )
        inside = (start >= segment.time[0]) & (start <= segment.time[-1])
        first = np.searchsorted(segment.time, start[inside])
        last = np.searchsorted(
            segment.time, np.minimum(start[inside] + HORIZON_S, segment.time[-1])
        )
        moved[inside] = fast[last] > fast[first]
    return moved
