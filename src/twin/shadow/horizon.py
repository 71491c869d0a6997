"""How far the twin, set to a log's smoothed state, strays within a horizon, over its own spread.

The plate is the servos' response to the recorded commands, corrected by the encoders. What the twin
does not know, its state at the start and its parameters, is drawn as sigma points (Julier and
Uhlmann), so that a ball that may or may not stop has the spread that comes of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from controllers.arrays import Array, Mask
from twin.identify.parameters import BALL as BOUNDS
from twin.identify.prepare import ROLL, PreparedLog, Segment, speed
from twin.identify.search import START_DIFFERENCES, START_PRIOR, fit_starts
from twin.identify.twin_model import Problem
from twin.identify.windows import BIN, LOOKBACK, STEP, Spans, Windows, cut
from twin.shadow.belief import BALL, PARAMETERS, ROUGH, Belief
from twin.shadow.evidence import clear
from twin.shadow.friction_map import (
    FINE,
    THINNED,
    FrictionMap,
    Known,
    Ways,
    braked,
    directed,
    foreseen,
    state_moved,
    turned,
    unforeseen,
    unknown_motion,
    unresolved,
)
from twin.shadow.motion import portions

LEAD = 1.2
"""Seconds of samples from which the state at a start is smoothed."""
UNKNOWN = 4e-4
"""Standard deviation in m/s^2 of what the plate's play and cams, too, do to a ball unknown to the
twin: as much as a tilt of 0.004 deg."""
STEPS = 6
"""Most Gauss-Newton steps that look for the ball's start."""


@dataclass(frozen=True)
class Lead:
    """What W windows of ``LEAD`` say, as a likelihood of K unknowns around what the twin believes.

    Unknown are the parameters of ``BALL``, the ball's state where the window begins, forces of all
    kinds, and last by how much the friction differs in each of S stretches of the way.

    Attributes:
        information: Of the unknowns, shape (W, K, K).
        score: Of the unknowns, shape (W, K).
        onto: What each does to the state at the end of ``LEAD``, shape (W, 4, K).
        end: That state if the twin is right, x, y, x', y', shape (W, 4).
        places: Where the ball was at every ``THINNED`` steps but the last, m, shape (W, N, 2).
        stretches: S.
    """

    information: Array
    score: Array
    onto: Array
    end: Array
    places: Array
    stretches: int

    @classmethod
    def of(cls, windows: Windows, belief: Belief) -> Lead:
        """What windows say of their twin."""
        problem, theta = belief.problem(windows), belief.theta
        starts = fit_starts(problem, theta, problem.initial_starts(), STEPS)
        line = problem.linearise(theta, starts)
        end, slopes, places, speeds = _end_state(problem, theta, starts)
        pushes, friction = forces(belief, speeds), braking(belief, speeds)
        delay = belief.values["delay"]
        moved = turned(unknown_motion(windows, delay), pushes)
        slowed = turned(unknown_motion(windows, delay, FINE), friction)
        ball = line.by_parameter[0, ..., : len(BALL)]
        J = np.concatenate((ball, line.by_start[0], moved, slowed), axis=-1)  # noqa: N806
        pushed = turned(state_moved(windows, LEAD), pushes)
        held = turned(state_moved(windows, LEAD, FINE), friction)
        return cls(
            np.swapaxes(J, -1, -2) @ J,
            -np.einsum("wmk,wm->wk", J, line.r[0]),
            np.concatenate((slopes, pushed, held), axis=-1),
            end.T,
            places[:-1:THINNED].transpose(2, 0, 1),
            friction.shape[1],
        )

    def of_friction(self, belief: Belief) -> tuple[Array, Array]:
        """What is said of the friction alone, whatever all else is: (W, S, S) and (W, S)."""
        others = slice(None, -self.stretches)
        root = _root(belief, self.information.shape[-1] - self.stretches)
        A, b = root @ self.information[:, others], root @ self.score[:, others, None]  # noqa: N806
        both = np.concatenate((A[..., -self.stretches :], b), axis=-1)
        inner = np.eye(root.shape[-1]) + A[..., others] @ root
        taken = np.swapaxes(both[..., :-1], -1, -2) @ np.linalg.solve(inner, both)
        own = slice(-self.stretches, None)
        return self.information[:, own, own] - taken[..., :-1], self.score[:, own] - taken[..., -1]


def smoothed(lead: Lead, belief: Belief, known: Known) -> tuple[Array, Array]:
    """What windows say of the parameters and of the ball's state when they are over.

    The forces nobody knows are estimated along (a smoother), so that where the ball is at the end
    does not rest on how it came there.

    Args:
        lead: What the samples say.
        belief: The twin.
        known: What is known of the friction without them.

    Returns:
        Mean (W, K) and covariance (W, K, K) of the deviations of ``BALL`` and of the state's four
        numbers from ``lead.end``.
    """
    count, all_of = len(BALL), lead.information.shape[-1]
    root = np.zeros_like(lead.information)
    others = all_of - lead.stretches
    root[:, :others, :others] = _root(belief, others)
    root[:, others:, others:] = np.linalg.cholesky(
        known.covariance + 1e-12 * np.eye(lead.stretches)
    )
    expected = np.zeros_like(lead.score)
    expected[:, others:] = known.mean
    news = lead.score - (lead.information @ expected[..., None])[..., 0]
    across = np.swapaxes(root, -1, -2)
    covariance = np.linalg.inv(np.eye(all_of) + across @ lead.information @ root)
    mean = expected + (root @ (covariance @ (across @ news[..., None])))[..., 0]
    keep = np.broadcast_to(np.eye(count, all_of), (len(mean), count, all_of))
    onto = np.concatenate((keep, lead.onto), axis=1)
    spread = onto @ root @ covariance @ across @ np.swapaxes(onto, -1, -2)
    return (onto @ mean[..., None])[..., 0], (spread + np.swapaxes(spread, -1, -2)) / 2


def forces(belief: Belief, velocity: Array) -> Array:
    """What nobody knows pushes balls of some velocities (N, 2, W) with, as ``directed``."""
    along = belief.braking * np.hypot(ROUGH, unresolved(belief))
    return directed(velocity, STEP, along, np.hypot(belief.sloped, UNKNOWN))


def braking(belief: Belief, velocity: Array) -> Array:
    """What twice the friction slows balls of some velocities (N, 2, W) with, as ``braked``."""
    return braked(velocity, STEP, belief.braking)


def _root(belief: Belief, count: int) -> Array:
    """Standard deviations of the first unknowns before anything is seen, (count, count).

    What an uneven screen makes of the parameters is left out: the forces are unknowns of their own.
    """
    watched = [PARAMETERS.index(name) for name in BALL]
    variance = (belief.constant**2 + belief.changing[0] ** 2 - belief.uneven**2)[watched]
    sizes = np.ones(count)
    sizes[: len(BALL)] = np.sqrt(variance)
    sizes[len(BALL) : len(BALL) + 4] = np.diag(START_PRIOR) ** -0.5
    return np.diag(sizes)


def _end_state(problem: Problem, theta: Array, starts: Array) -> tuple[Array, Array, Array, Array]:
    """The ball's state (4, W) at the end of ``LEAD``, its slopes (W, 4, K), and the way to it.

    Slopes by the parameters of ``BALL`` and the start, by finite differences; places in m and
    velocities in m/s at every step, shape (N, 2, W).
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
    return states[:, 0], slopes, places[:, :, 0], speeds[:, :, 0]


KAPPA = 1.0
"""Weight of the middle sigma point."""


@dataclass(frozen=True)
class OpenLoop:
    """W replays.

    Attributes:
        belief: The twin.
        lead: What the windows up to their starts say.
        after: The windows that are foreseen.
    """

    belief: Belief
    lead: Lead
    after: Windows

    @property
    def ways(self) -> Ways:
        """Where the balls went up to the starts, and where the twins expect them to go on."""
        whole = self.belief.problem(self.after)
        places, _ = whole.replayed(self.belief.theta, self.lead.end.T[:, None])
        information, score = self.lead.of_friction(self.belief)
        ahead = places[:-1:THINNED, :, 0].transpose(2, 0, 1)
        start = self.after.begin + LOOKBACK
        return Ways(start, self.lead.places, information, score, ahead)

    def replayed(self, known: Known, ahead: float, period: float) -> tuple[Array, Array, Array]:
        """How far the balls are from where their twins are in the end, and how the twins went.

        Args:
            known: Of the friction on the way.
            ahead: Horizon in s.
            period: Seconds between the screen's samples.

        Returns:
            Error in m, shape (W, 2), NaN without a sample; predicted covariance of it in m^2, shape
            (W, 2, 2); places of the twins at every step from the start to the horizon, (W, N, 2).
        """
        points, weights = self._sigma_points(known)
        windows = self.after.resisted(1 + np.repeat(known.ahead, THINNED, axis=1))
        whole = self.belief.problem(windows)
        places, speeds = whole.replayed(*points)
        ball, _ = windows.at_samples(places, speeds, whole.values(points[0])["delay"])
        at = windows.time - (LOOKBACK + ahead)
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
        first, gone = round(LOOKBACK / STEP), LOOKBACK + ahead
        steps = round(gone / STEP) + 1
        way = np.einsum("c,nicw->niw", weights, speeds[:steps])
        spread += unforeseen(forces(self.belief, way), gone)
        friction = braking(self.belief, way)
        stretches = slice(friction.shape[1])
        spread += unforeseen(friction, gone, FINE, known.unsure[:, stretches, stretches])
        error = np.where(near[:, None], windows.ball[rows, sample] - middle, np.nan)
        return error, spread, np.einsum("c,nicw->wni", weights, places[first:steps])

    def _sigma_points(self, known: Known) -> tuple[tuple[Array, Array], Array]:
        """Parameters (C, W, P) and starts (4, C, W) for all that may be, and weights (C,).

        Both are what the samples before the start, and what is believed of the parameters and known
        of the screen, make of them.
        """
        mean, covariance = smoothed(self.lead, self.belief, known)
        windows, count = mean.shape
        side = np.sqrt(count + KAPPA) * np.swapaxes(np.linalg.cholesky(covariance), -1, -2)
        sides = np.moveaxis(np.stack((side, -side)), 2, 1)
        moved = mean + np.concatenate((np.zeros((1, windows, count)), *sides))
        every = np.tile(self.belief.theta[:, None], (len(moved), windows, 1))
        for k, name in enumerate(BALL):
            every[..., k] = np.maximum(every[..., k] + moved[..., k], BOUNDS[name].least)
        begun = self.lead.end.T[:, None] + np.moveaxis(moved[..., len(BALL) :], -1, 0)
        weights = np.full(len(moved), 1 / (2 * (count + KAPPA)))
        weights[0] = KAPPA / (count + KAPPA)
        return (every, begun), weights


MEDIAN, BAND = 2 * np.log(2.0), 5.991
"""Median and 95 % quantile of a chi-square of two degrees of freedom."""
ROWS = ("time", "error", "spread", "told", "path")
DRAWN = 5
"""Steps of a replay from one point of its path that is kept to the next."""


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
    ahead: float,
    every: float,
    since: float = -np.inf,
    until: float = np.inf,
    screen: FrictionMap | None = None,
) -> Replays | None:
    """Replays of a log from many starts; None if it is too short for any.

    Args:
        log: What was recorded.
        belief: The twin.
        gaps: Of the log; a replay over one tells nothing.
        ahead: Horizon in s.
        every: Seconds between the starts of two replays.
        since: The first start in s, where a log goes back further.
        until: Seconds; of replays that end later there is none.
        screen: Learns on; by default a screen of which nothing is known.
    """
    screen = screen or FrictionMap(belief)

    def spans(later: float, length: float) -> Callable[[Segment, float, float, float], Spans]:
        def chosen(segment: Segment, begin: float, end: float, longest: float) -> Spans:
            del segment, longest
            last = min(end, until) - (LEAD + ahead + BIN)
            begins = np.arange(max(begin, since - LEAD), last, every) + later
            return Spans(begins, np.full(len(begins), length), np.zeros(len(begins), bool))

        return chosen

    before = cut(log, belief.lag, LEAD, spans(0.0, LEAD))
    after = cut(log, belief.lag, ahead + BIN, spans(LEAD, ahead + BIN))
    if before is None or after is None:
        return None
    start = after.begin + LOOKBACK
    whole = clear(before.begin, before.begin + LOOKBACK + LEAD, gaps)
    parts = []
    for part in portions(len(start)):
        loop = OpenLoop(belief, Lead.of(before.take(part), belief), after.take(part))
        known = foreseen(loop.ways, whole[part], screen)
        parts.append(loop.replayed(known, ahead, log.sample_period))
    error, spread, path = (np.concatenate(each) for each in zip(*parts, strict=True))
    told = _moving(log, start, ahead)
    told &= clear(start - LEAD - LOOKBACK, start + ahead, gaps)
    return Replays(start, ahead, error, spread, told, path[:, ::DRAWN])


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
