"""What the screen's samples say of its noise, window by window."""

from __future__ import annotations

import numpy as np

from controllers.arrays import Array
from twin.identify.prepare import PreparedLog, Segment
from twin.shadow.belief import Belief
from twin.shadow.evidence import Evidence
from twin.shadow.gaps import undisturbed

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
) -> Evidence | None:
    """Evidence of ``noise``; None if no part of the log is long enough.

    Args:
        log: What was recorded.
        belief: The twin.
        gaps: Of the log; where there is one there is no evidence.
        since: When the first window begins, s, where the log goes back further.
    """
    parts = (_of_segment(segment, belief, since) for segment in log.segments)
    return undisturbed(parts, gaps)


def _of_segment(segment: Segment, belief: Belief, since: float) -> Evidence | None:
    begin = max(float(segment.time[0]), since)
    begins = begin + WINDOW * np.arange(int((segment.time[-1] - begin) / WINDOW))
    spans, levels, counts = [], [], []
    for begin in begins:
        ball = segment.ball[(segment.sampled >= begin) & (segment.sampled < begin + WINDOW)]
        if len(ball) >= LEAST:
            spans.append((begin, begin + WINDOW))
            levels.append(noise_level(ball, np.maximum(belief.screen, 1e-12)))
            counts.append(2 * (len(ball) - 2) / _ALIKE)
    if not spans:
        return None
    # the logarithm of a standard deviation from n values has variance 1 / (2 n)
    information = 2 * np.array(counts)
    score = information * np.array(levels)
    return Evidence.of(("noise",), np.array(spans), information[:, None, None], score[:, None])
