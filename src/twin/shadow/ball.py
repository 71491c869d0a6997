"""What the ball's motion says of friction, dead time, level and tilt gain, window by window."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from controllers.arrays import Array, Mask
from twin.identify.prepare import PreparedLog, Segment
from twin.identify.problem import START_PRIOR, Linearisation
from twin.identify.search import fit_starts
from twin.identify.windows import BIN, LOOKBACK, Spans, Windows, cut, moving_spans
from twin.shadow.belief import BALL, Belief
from twin.shadow.evidence import Evidence, clear, log_evidence
from twin.shadow.friction_map import products, unknown_motion

LONGEST = 2.0
"""Longest window in s: long enough for a small force to show, short enough to stay near it."""
WIDE = 100.0
"""Deviations that may explain a window, in what an identified twin may be wrong by."""
AT_ONCE = 500
"""Windows that are worked on at once: more no longer fit the processor's cache."""
STEPS = 8
"""Most Gauss-Newton steps that look for the ball's start in a window."""


def ball_windows(
    log: PreparedLog, belief: Belief, gaps: Array, since: float = -np.inf
) -> tuple[Windows | None, Array]:
    """The windows in which the ball moves, None if there are none, and when each ends, shape (W,).

    Args:
        log: What was recorded.
        belief: The twin.
        gaps: Of the log; a window that holds one is none.
        since: Seconds; what was before has been cut into windows already.
    """
    ends = [np.zeros(0)]

    def spans(segment: Segment, begin: float, end: float, longest: float) -> Spans:
        found = moving_spans(segment, max(begin, since), end, longest)
        whole = clear(found.begin - LOOKBACK, found.begin + found.length, gaps)
        found = Spans(found.begin[whole], found.length[whole], found.resting[whole])
        ends.append(found.begin + found.length)
        return found

    windows = cut(log, belief.lag, LONGEST, spans)
    return windows, np.concatenate(ends)


def portions(windows: int) -> Iterator[Mask]:
    """Parts of so many windows that are good to work on at a time."""
    at = np.arange(windows) // AT_ONCE
    return (np.asarray(at == number) for number in range(at[-1] + 1))


def ball_evidence(windows: Windows, belief: Belief, theta: Array | None = None) -> Evidence:
    """Evidence of ``BALL`` around parameters, the ball's start being whatever suits it best.

    Args:
        windows: In which the ball moves, at least one.
        belief: The twin.
        theta: Where the likelihood is expanded, shape (len(belief.names),); None for the belief.
    """
    at = belief.theta if theta is None else theta[None]
    parts = [_expanded(windows.take(part), belief, at) for part in portions(len(windows))]
    return Evidence.beside(parts)


def _expanded(windows: Windows, belief: Belief, theta: Array) -> Evidence:
    """Evidence of windows around parameters, shape (1, P)."""
    problem = belief.problem(windows)
    starts = fit_starts(problem, theta, problem.initial_starts(), STEPS)
    squares, score, information = _without_start(problem.linearise(theta, starts), windows, belief)
    counted = windows.weight[..., :1] > 0
    last = np.where(counted[..., 0], windows.time, 0.0).max(axis=1)
    spans = windows.begin[:, None] + np.stack((np.full(len(windows), LOOKBACK), last), axis=-1)
    height = -squares / 2
    stopping = windows.resting | (last - LOOKBACK < LONGEST - 2 * BIN)
    wide = np.maximum(belief.constant[: len(BALL)], 1e-9) * WIDE
    prior = np.diag(wide**2)
    # twice the log-likelihood that some deviation gains is what it takes off the squares
    gained = 2 * log_evidence(information, score, prior)
    gained += np.linalg.slogdet(np.eye(len(BALL)) + information @ prior)[1]
    left = (squares - gained) / np.maximum(windows.size - 4 - len(BALL), 1)
    left = np.maximum(left, 1.0)
    return Evidence.of(BALL, spans, information, score, height, stopping, left)


def _without_start(
    line: Linearisation, windows: Windows, belief: Belief
) -> tuple[Array, Array, Array]:
    """Squares (W,), score (W, p) and information (W, p, p), the starts fitted along."""
    parts = (line.r[0, ..., None], line.by_parameter[0, ..., : len(BALL)], line.by_start[0])
    unknown = unknown_motion(windows, belief.values["delay"])
    Q = products(np.concatenate(parts, axis=-1), unknown, belief.rough)  # noqa: N806
    k = 1 + len(BALL)
    own = Q[..., k:, k:] + START_PRIOR
    left = Q[..., :k, :k] - Q[..., :k, k:] @ np.linalg.solve(own, Q[..., k:, :k])
    return left[..., 0, 0], -left[..., 1:, 0], left[..., 1:, 1:]
