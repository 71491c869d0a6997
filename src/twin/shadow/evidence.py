"""Evidence of windows of a log on the twin's parameters: slopes and curvatures of likelihoods.

Close to what is believed, a window's log-likelihood of a deviation d (true minus believed) is
b'd - d'A d / 2, with A the Fisher information and b the score. The windows of one part of a log add
up, and every hypothesis is a prior of d: nothing else of a log is needed to weigh them all.

Of friction, dead time, level and tilt gain the ball's motion tells; of the drives' lag, lost
motion, and what the cams make of it, the plate's (`plate`); of the screen's noise its samples.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array, Mask
from twin.identify.least_squares import Linearisation, fit_starts
from twin.identify.logs import Log
from twin.identify.parameters import LEVEL_PARAMETERS
from twin.identify.prepare import PreparedLog, Segment
from twin.identify.windows import (
    LOOKBACK_S,
    SAMPLE_BIN_S,
    Spans,
    Windows,
    cut,
    moving_spans,
    unknown_motion,
)
from twin.shadow.belief import BALL_BELIEFS, WATCHED_PARAMETERS, Belief


@dataclass(frozen=True)
class Evidence:
    """W windows, in the order in which they end.

    Attributes:
        begin: Seconds, shape (W,).
        end: Seconds, shape (W,).
        information: A of each, shape (W, P, P).
        score: b of each, shape (W, P).
        height: Log-likelihood where it was expanded, up to a constant, shape (W,).
        stopping: Whether the ball rests in a part of it, where a touch of noise decides when and
            how it goes on, shape (W,).
        dispersion: Mean square, at least 1, of what no deviation explains in it, in noise
            variances, shape (W,).
    """

    begin: Array
    end: Array
    information: Array
    score: Array
    height: Array
    stopping: Mask
    dispersion: Array

    def __len__(self) -> int:
        """Number of windows."""
        return len(self.begin)

    @classmethod
    def of(
        cls, names: Sequence[str], spans: Array, information: Array, score: Array, **more: Any
    ) -> Evidence:
        """Evidence of some of the parameters.

        Args:
            names: Which, p of them.
            spans: Begin and end of each window in s, shape (W, 2).
            information: Shape (W, p, p).
            score: Shape (W, p).
            more: The further attributes; by default of plain windows that are explained.
        """
        at, count = [WATCHED_PARAMETERS.index(name) for name in names], len(spans)
        full = np.zeros((count, len(WATCHED_PARAMETERS), len(WATCHED_PARAMETERS)))
        full[np.ix_(range(count), at, at)] = information
        slope = np.zeros((count, len(WATCHED_PARAMETERS)))
        slope[:, at] = score
        plain = {"height": np.zeros(count), "stopping": np.zeros(count, bool)}
        more = {**plain, "dispersion": np.ones(count), **more}
        return cls(spans[:, 0], spans[:, 1], full, slope, **more)

    @classmethod
    def join(cls, parts: Sequence[Evidence]) -> Evidence:
        """All windows of several, in the order in which they end."""
        joined = cls.concatenate(parts)
        return joined.take(np.argsort(joined.end, kind="stable"))

    @classmethod
    def concatenate(cls, parts: Sequence[Evidence]) -> Evidence:
        """All windows of several, one part after the other."""
        return cls(
            *(np.concatenate([getattr(part, item.name) for part in parts]) for item in fields(cls))
        )

    def take(self, which: Mask | NDArray[np.int_]) -> Evidence:
        """Some of the windows."""
        return Evidence(*(getattr(self, item.name)[which] for item in fields(self)))

    def tempered(self, dispersion: Array) -> Evidence:
        """The evidence if noise variances are larger by factors, shape (W,): quasi-likelihood."""
        return replace(
            self,
            information=self.information / dispersion[:, None, None],
            score=self.score / dispersion[:, None],
            height=self.height / dispersion,
        )

    def softened(self, changing: Array, factors: Array | float = 1.0) -> Evidence:
        """The evidence if the parameters also differ from window to window.

        With a deviation of its own of covariance Q in each window, the information becomes
        (A^-1 + Q)^-1 = (I + A Q)^-1 A, and the score (I + A Q)^-1 b.

        Args:
            changing: Standard deviations, shape (2, P): while the ball rolls, and where it stops.
            factors: On them, shape (W, P).
        """
        A = self.information  # noqa: N806
        variance = (factors * changing[self.stopping.astype(int)]) ** 2
        both = np.concatenate((A, self.score[..., None]), axis=-1)
        less = np.linalg.solve(np.eye(A.shape[-1]) + A * variance[:, None], both)
        return replace(
            self,
            information=less[..., :-1],
            score=less[..., -1],
            height=self.height
            + log_evidence(A, self.score, variance[..., None] * np.eye(A.shape[-1])),
        )


def log_evidence(
    information: Array, score: Array, prior: Array, mean: Array | float = 0.0
) -> Array:
    """Logarithm of the marginal likelihood over the likelihood at d = 0, shape (...).

    The integral of exp(b'd - d'A d / 2) over d ~ N(m, V), which with c = b - A m is
    b'm - m'A m / 2 + (c' V (I + A V)^-1 c - ln det(I + A V)) / 2.

    Args:
        information: A, shape (..., P, P).
        score: b, shape (..., P).
        prior: V, shape (..., P, P).
        mean: m, shape (..., P).
    """
    m = np.broadcast_to(mean, score.shape)
    pull = _times(information, m)
    c = score - pull
    AV = np.eye(information.shape[-1]) + information @ prior  # noqa: N806
    fit = (c * _times(prior, np.linalg.solve(AV, c[..., None])[..., 0])).sum(axis=-1)
    at_mean = ((score - pull / 2) * m).sum(axis=-1)
    return np.asarray(at_mean + (fit - np.linalg.slogdet(AV)[1]) / 2)


def posterior(
    information: Array, score: Array, prior: Array, mean: Array | float = 0.0
) -> tuple[Array, Array]:
    """Mean (..., P) and covariance (..., P, P) of d, arguments as for ``log_evidence``."""
    m = np.broadcast_to(mean, score.shape)
    AV = np.eye(information.shape[-1]) + information @ prior  # noqa: N806
    # V (I + A V)^-1, symmetric
    covariance = np.swapaxes(np.linalg.solve(np.swapaxes(AV, -1, -2), prior), -1, -2)
    return m + _times(covariance, score - _times(information, m)), covariance


def without_rest(information: Array, score: Array, count: int) -> tuple[Array, Array]:
    """Evidence of the first parameters d, shapes (W, count, count) and (W, count).

    The likelihood is integrated over the others, e ~ N(0, I). Of A and b in blocks, what is left
    is A_dd - A_de (I + A_ee)^-1 A_ed and b_d - A_de (I + A_ee)^-1 b_e.

    Args:
        information: A of all, shape (W, p, p).
        score: b of all, shape (W, p).
        count: Number of the first ones.
    """
    d, e = slice(count), slice(count, None)
    rest = information[:, e, e]
    both = np.concatenate((information[:, e, d], score[:, e, None]), axis=-1)
    less = information[:, d, e] @ np.linalg.solve(np.eye(rest.shape[-1]) + rest, both)
    return information[:, d, d] - less[..., :-1], score[:, d] - less[..., -1]


def _times(matrix: Array, vector: Array) -> Array:
    return np.asarray((matrix @ vector[..., None])[..., 0])


NO_EVIDENCE = Evidence.of((), np.zeros((0, 2)), np.zeros((0, 0, 0)), np.zeros((0, 0)))
"""No window at all."""
GAP_PERIODS = 1.5
"""Periods between two rows above which there is a gap."""
LATE_ROW_SHARE = 0.5
"""Share of a period above which a row was taken too late: its values are of a different time."""


def gaps(log: Log, period: float) -> Array:
    """Begin and end in s of what is missing or late, shape (G, 2).

    Args:
        log: What was recorded.
        period: Seconds between rows.
    """
    known = np.isfinite(log.time)
    time = log.time[known]
    missing = np.flatnonzero(np.diff(time) > GAP_PERIODS * period)
    found = np.stack((time[missing], time[missing + 1]), axis=-1)
    if log.late is not None:
        late = np.nan_to_num(log.late[known])
        behind = late > LATE_ROW_SHARE * period
        found = np.concatenate((found, np.stack((time, time + late), axis=-1)[behind]))
    return found[np.argsort(found[:, 0], kind="stable")]


def clear(begin: Array, end: Array, gaps: Array, after: float = 0.0) -> Mask:
    """Find the spans of time that hold no part of a gap, shape (W,).

    Args:
        begin: Seconds, shape (W,).
        end: Seconds, shape (W,).
        gaps: Begin and end of each in s, shape (G, 2).
        after: Seconds for which a gap is still felt.
    """
    touched = (gaps[:, 0] < end[:, None]) & (gaps[:, 1] + after > begin[:, None])
    return np.asarray(~touched.any(axis=1))


def without_gaps(parts: Iterable[Evidence], gaps: Array, after: float = 0.0) -> Evidence:
    """Evidence of windows without a gap.

    Args:
        parts: Of the segments of a log.
        gaps: Begin and end of each in s, shape (G, 2).
        after: Seconds for which a gap is still felt.
    """
    every = Evidence.join([NO_EVIDENCE, *parts])
    return every.take(clear(every.begin, every.end, gaps, after))


PLATE_WINDOW_S = 2.0
"""Length in s of a window of the plate or of the screen."""
MIN_SCREEN_SAMPLES = 30
"""Samples below which a window of the screen shows nothing."""
# The second differences of white noise are correlated: so many of them count as one.
_NOISE_RATIO = 35 / 18


def noise_level(ball: Array, variance: Array) -> float:
    """Logarithm of the noise of samples in a row, over what is believed.

    From how three in a row differ from a line, as second differences forget the ball's motion.

    Args:
        ball: Samples in m, shape (K, A) along A axes.
        variance: What is believed, m^2, shape (A,).
    """
    bend = np.diff(ball, n=2, axis=0)
    return float(np.log(((bend**2).mean(axis=0) / (6 * variance)).mean()) / 2)


def noise_evidence(
    log: PreparedLog, belief: Belief, gaps: Array, since: float = -np.inf
) -> Evidence:
    """Evidence of ``noise``; none if no part of the log is long enough.

    Args:
        log: What was recorded.
        belief: The twin.
        gaps: Of the log; where there is one there is no evidence.
        since: When the first window begins, s, where the log goes back further.
    """
    parts = (_noise_of(segment, belief, log.axes, since) for segment in log.segments)
    return without_gaps(parts, gaps)


def _noise_of(segment: Segment, belief: Belief, axes: int, since: float) -> Evidence:
    begin = max(float(segment.time[0]), since)
    begins = begin + PLATE_WINDOW_S * np.arange(int((segment.time[-1] - begin) / PLATE_WINDOW_S))
    spans, levels, counts = [], [], []
    for begin in begins:
        ball = segment.ball[(segment.sampled >= begin) & (segment.sampled < begin + PLATE_WINDOW_S)]
        if len(ball) >= MIN_SCREEN_SAMPLES:
            spans.append((begin, begin + PLATE_WINDOW_S))
            variance = np.maximum(belief.screen, 1e-12)
            levels.append(noise_level(ball[:, :axes], variance[:axes]))
            counts.append(axes * (len(ball) - 2) / _NOISE_RATIO)
    # the logarithm of a standard deviation from n values has variance 1 / (2 n)
    information = 2 * np.array(counts)
    score = information * np.array(levels)
    ends = np.reshape(spans, (-1, 2))
    return Evidence.of(("noise",), ends, information[:, None, None], score[:, None])


MAX_WINDOW_S = 2.0
"""Longest window in s: long enough for a small force to show, short enough to stay near it."""
MAX_EXPLAINING_STDS = 100.0
"""Deviations that may explain a window, in what an identified twin may be wrong by."""
WINDOWS_AT_ONCE = 500
"""Windows that are worked on at once: more no longer fit the processor's cache."""
MAX_START_STEPS = 8
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
        whole = clear(found.begin - LOOKBACK_S, found.begin + found.length, gaps)
        found = Spans(found.begin[whole], found.length[whole], found.resting[whole])
        ends.append(found.begin + found.length)
        return found

    windows = cut(log, belief.lag, MAX_WINDOW_S, spans)
    return windows, np.concatenate(ends)


def portions(windows: int) -> Iterator[Mask]:
    """Parts of so many windows that are good to work on at a time."""
    at = np.arange(windows) // WINDOWS_AT_ONCE
    return (np.asarray(at == number) for number in range(at[-1] + 1))


def ball_evidence(windows: Windows, belief: Belief, theta: Array | None = None) -> Evidence:
    """Evidence of ``BALL_BELIEFS`` around parameters, with a free start of the ball.

    Args:
        windows: In which the ball moves, at least one.
        belief: The twin.
        theta: Where the likelihood is expanded, shape (len(belief.names),); None for the belief.
    """
    at = belief.theta if theta is None else theta[None]
    parts = [_expand(windows.take(part), belief, at) for part in portions(len(windows))]
    return Evidence.concatenate(parts)


def _expand(windows: Windows, belief: Belief, theta: Array) -> Evidence:
    """Evidence of windows around parameters, shape (1, P)."""
    problem = belief.problem(windows)
    starts = fit_starts(problem, theta, problem.initial_starts(), MAX_START_STEPS)
    squares, score, information = _without_start(problem.linearise(theta, starts), windows, belief)
    counted = windows.weight[..., :1] > 0
    last = np.where(counted[..., 0], windows.time, 0.0).max(axis=1)
    spans = windows.begin[:, None] + np.stack((np.full(len(windows), LOOKBACK_S), last), axis=-1)
    height = -squares / 2
    stopping = windows.resting | (last - LOOKBACK_S < MAX_WINDOW_S - 2 * SAMPLE_BIN_S)
    wide = np.maximum(belief.constant[: len(BALL_BELIEFS)], 1e-9) * MAX_EXPLAINING_STDS
    prior = np.diag(wide**2)
    # twice the log-likelihood that some deviation gains is the reduction of the squares
    gained = 2 * log_evidence(information, score, prior)
    gained += np.linalg.slogdet(np.eye(len(BALL_BELIEFS)) + information @ prior)[1]
    # a rig of one axis has half a start, and one level
    unknowns = 2 * windows.axes + len(BALL_BELIEFS) - len(LEVEL_PARAMETERS[windows.axes :])
    left = (squares - gained) / np.maximum(windows.size - unknowns, 1)
    left = np.maximum(left, 1.0)
    parts = {"height": height, "stopping": stopping, "dispersion": left}
    return Evidence.of(BALL_BELIEFS, spans, information, score, **parts)


def _without_start(
    line: Linearisation, windows: Windows, belief: Belief
) -> tuple[Array, Array, Array]:
    """Squares (W,), score (W, p) and information (W, p, p), the starts fitted along."""
    unknown = unknown_motion(windows, belief.values["delay"])
    size = float(np.hypot(belief.rough, belief.sloped))
    line = line._replace(by_parameter=line.by_parameter[..., : len(BALL_BELIEFS)])
    left, _ = line.without_starts(size * unknown)
    return left[:, 0, 0], -left[:, 1:, 0], left[:, 1:, 1:]
