"""What windows of a log say of the twin's parameters: the slopes and curvatures of likelihoods.

Close to what is believed, a window's log-likelihood of a deviation d (true minus believed) is
b'd - d'A d / 2, with A the Fisher information and b the score. The windows of one part of a log add
up, and every hypothesis is a prior of d: nothing else of a log is needed to weigh them all.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array, Mask
from twin.identify.logs import Log
from twin.identify.prepare import PreparedLog, Segment
from twin.shadow.belief import PARAMETERS, Belief


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
        cls,
        names: Sequence[str],
        spans: Array,
        information: Array,
        score: Array,
        height: Array | None = None,
        stopping: Mask | None = None,
        dispersion: Array | None = None,
    ) -> Evidence:
        """Evidence of some of the parameters.

        Args:
            names: Which, p of them.
            spans: Begin and end of each window in s, shape (W, 2).
            information: Shape (W, p, p).
            score: Shape (W, p).
            height: Log-likelihood there, shape (W,).
            stopping: Whether the ball rests in a part of it, shape (W,).
            dispersion: Mean square of what no deviation explains, shape (W,).
        """
        at = [PARAMETERS.index(name) for name in names]
        full = np.zeros((len(spans), len(PARAMETERS), len(PARAMETERS)))
        full[np.ix_(range(len(spans)), at, at)] = information
        slope = np.zeros((len(spans), len(PARAMETERS)))
        slope[:, at] = score
        return cls(
            spans[:, 0],
            spans[:, 1],
            full,
            slope,
            np.zeros(len(spans)) if height is None else height,
            np.zeros(len(spans), bool) if stopping is None else stopping,
            np.ones(len(spans)) if dispersion is None else dispersion,
        )

    @classmethod
    def join(cls, parts: Sequence[Evidence]) -> Evidence:
        """All windows of several, in the order in which they end."""
        joined = cls.beside(parts)
        return joined.take(np.argsort(joined.end, kind="stable"))

    @classmethod
    def beside(cls, parts: Sequence[Evidence]) -> Evidence:
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


def _times(matrix: Array, vector: Array) -> Array:
    return np.asarray((matrix @ vector[..., None])[..., 0])


NONE = Evidence.of((), np.zeros((0, 2)), np.zeros((0, 0, 0)), np.zeros((0, 0)))
"""No window at all."""
MISSED = 1.5
"""Periods from one row to the next from which on there is a gap."""
LATE = 0.5
"""Share of a period from which on a row was taken too late: what it holds is of another time."""


def gaps(log: Log, period: float) -> Array:
    """Begin and end in s of what is missing or late, shape (G, 2).

    Args:
        log: What was recorded.
        period: Seconds between rows.
    """
    known = np.isfinite(log.time)
    time = log.time[known]
    missing = np.flatnonzero(np.diff(time) > MISSED * period)
    found = np.stack((time[missing], time[missing + 1]), axis=-1)
    if log.late is not None:
        late = np.nan_to_num(log.late[known])
        behind = late > LATE * period
        found = np.concatenate((found, np.stack((time, time + late), axis=-1)[behind]))
    return found[np.argsort(found[:, 0], kind="stable")]


def clear(begin: Array, end: Array, gaps: Array, after: float = 0.0) -> Mask:
    """Which spans of time hold no part of a gap, shape (W,).

    Args:
        begin: Seconds, shape (W,).
        end: Seconds, shape (W,).
        gaps: Begin and end of each in s, shape (G, 2).
        after: Seconds for which a gap is still felt.
    """
    touched = (gaps[:, 0] < end[:, None]) & (gaps[:, 1] + after > begin[:, None])
    return np.asarray(~touched.any(axis=1))


def undisturbed(parts: Iterable[Evidence], gaps: Array, after: float = 0.0) -> Evidence:
    """What windows without a gap say.

    Args:
        parts: Of the segments of a log.
        gaps: Begin and end of each in s, shape (G, 2).
        after: Seconds for which a gap is still felt.
    """
    every = Evidence.join([NONE, *parts])
    return every.take(clear(every.begin, every.end, gaps, after))


WINDOW = 2.0
"""Length of a window in s."""
LEAST = 30
"""Samples below which a window says nothing."""
# The second differences of white noise are correlated: so many of them count as one.
_ALIKE = 35 / 18


def noise_level(ball: Array, variance: Array) -> float:
    """Logarithm of the noise of samples in a row, over what is believed.

    From how three in a row differ from a line, as second differences forget the ball's motion.

    Args:
        ball: Samples in m, shape (K, 2).
        variance: What is believed, m^2, shape (2,).
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
    parts = (_of_segment(segment, belief, since) for segment in log.segments)
    return undisturbed(parts, gaps)


def _of_segment(segment: Segment, belief: Belief, since: float) -> Evidence:
    begin = max(float(segment.time[0]), since)
    begins = begin + WINDOW * np.arange(int((segment.time[-1] - begin) / WINDOW))
    spans, levels, counts = [], [], []
    for begin in begins:
        ball = segment.ball[(segment.sampled >= begin) & (segment.sampled < begin + WINDOW)]
        if len(ball) >= LEAST:
            spans.append((begin, begin + WINDOW))
            levels.append(noise_level(ball, np.maximum(belief.screen, 1e-12)))
            counts.append(2 * (len(ball) - 2) / _ALIKE)
    # the logarithm of a standard deviation from n values has variance 1 / (2 n)
    information = 2 * np.array(counts)
    score = information * np.array(levels)
    ends = np.reshape(spans, (-1, 2))
    return Evidence.of(("noise",), ends, information[:, None, None], score[:, None])
