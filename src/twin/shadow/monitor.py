"""A sequential test: since when, if at all, has something other than the twin made the log.

A CUSUM over windows in the form for changes of unknown size (Lai and Xing): after each window the
log-likelihood ratio of every cause against no change, its size integrated over its prior, is
maximised over the time of the change. What crosses a threshold is an alarm. How far the twin was
off before the change is learned from the windows before it: a rig with much that its twin leaves
out (uneven screen, play, a slow screen clock) scatters more than the twin expects.

The dead time has a test alone. A screen that answers 5 ms later moves the ball's samples by less
than a millimetre, now here, now there, but does so in every window: many small signs, of which none
may count for much. The test of all causes trusts a single window more, and so has to leave much
room for what differs from window to window where the ball stops; little of the dead time is left to
see there. Here each window is trusted with little, also where it and others would add up to much,
which bounds the outliers of stopping balls, and the room is smaller.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array
from twin.shadow.belief import CAUSES, CHANGING, PARAMETERS, STOPPING, Belief
from twin.shadow.evidence import Evidence, log_evidence, posterior

LATEST = 8.0
"""Seconds before a window that it learns nothing from, for a change may have begun in them."""
COUNTED = 4.0
"""What is expected of a rig of which nothing is known yet counts as so many windows:"""
FIRST = np.array([1.0 if name == "noise" else 1.5 for name in PARAMETERS])
"""a factor of three, but for what hardly differs from window to window on any rig."""
MOST = 10.0
"""Largest factor: a rig that is far from its twin is not one that scatters."""


def scatter(evidence: Evidence, belief: Belief) -> Array:
    """Factors on what the belief expects parameters to change by, shape (W, P).

    With d the deviation that a window alone would give a parameter, 1/a its variance and Q that
    which is expected from window to window, E (d - mean)^2 = 1/a + f^2 Q; windows count by how well
    they show Q.

    Args:
        evidence: Windows in the order of time, not softened.
        belief: The twin.
    """
    expected = belief.changing[evidence.stopping.astype(int)] ** 2
    a = np.diagonal(evidence.information, axis1=-2, axis2=-1)
    shows = a > 0
    own = 1 / np.where(shows, a, 1.0)
    sd = np.sqrt(own + expected)
    weight = np.where(shows, expected / sd**4, 0.0)
    d = evidence.score * own
    # what is far off all along does not scatter: of an outlier counts how far it is from the others
    usual = np.cumsum(weight * d, axis=0) / np.maximum(np.cumsum(weight, axis=0), 1e-300)
    d = np.clip(d, usual - MOST * sd, usual + MOST * sd)
    sums = [
        np.concatenate((np.zeros((1, a.shape[1])), np.cumsum(weight * each, axis=0)))
        for each in (np.ones_like(d), d, d**2 - own, expected)
    ]
    until = np.searchsorted(evidence.end, evidence.begin - LATEST)
    count, first, second, share = (each[until] for each in sums)
    spread = second - first**2 / np.maximum(count, 1e-300)
    squared = (COUNTED * FIRST**2 + spread) / (COUNTED + share)
    return np.asarray(np.sqrt(np.clip(squared, 1.0, MOST**2)))


LOOKBACKS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48)
"""Windows since the change that are tried."""
LEARNED = 120
"""Windows before the change from which is learned how far the twin was off: some minutes."""
BLOCK = 100
"""Windows that are worked on at a time."""


AT_MOST = 5.0
"""Log-likelihood ratio that one window may speak for a change: an outlier alone is no alarm."""
ROUNDS = 8
"""How often a window is weakened until it says no more than that."""


class _Sums:
    """Sums of evidence up to each window, in numbers of one size.

    Args:
        evidence: Windows in the order of time, softened.
        belief: What holds without a change; its uncertainty is the unit of every parameter.
        causes: What may have changed.
    """

    def __init__(
        self, evidence: Evidence, belief: Belief, causes: Sequence[str] = tuple(CAUSES)
    ) -> None:
        unit = belief.constant
        none = np.zeros((1, *evidence.information.shape[1:]))
        information = np.concatenate((none, np.cumsum(evidence.information, axis=0)))
        self._A = information * unit * unit[:, None]
        self._b = np.concatenate((none[:, 0], np.cumsum(evidence.score, axis=0))) * unit
        chosen = [list(CAUSES).index(name) for name in causes]
        moved = belief.changes[chosen] / unit / unit[:, None]
        self._alternatives = np.concatenate((np.zeros((1, *moved.shape[1:])), moved))
        self._eye = np.eye(len(unit))
        self._drift = np.diag((belief.drift / unit) ** 2)

    def ratio(
        self, begin: NDArray[np.int_], last: NDArray[np.int_], weaker: Array | float = 1.0
    ) -> Array:
        """Log-likelihood ratio of a change before windows ``begin`` up to ``last``, shape (...).

        Args:
            begin: First window after the change, shape (...).
            last: One past the last window that is counted, shape (...).
            weaker: By how much less the windows from the change on count, shape (...).
        """
        first = np.maximum(begin - LEARNED, 0)
        A, b = self._A, self._b  # noqa: N806
        mean, covariance = posterior(A[begin] - A[first], b[begin] - b[first], self._eye)
        logs = log_evidence(
            ((A[last] - A[begin]) / np.expand_dims(weaker, (-2, -1)))[..., None, :, :],
            ((b[last] - b[begin]) / np.expand_dims(weaker, -1))[..., None, :],
            (covariance + self._drift)[..., None, :, :] + self._alternatives,
            mean[..., None, :],
        )
        return np.asarray((logs[..., 1:] - logs[..., :1]).max(axis=-1))


def bounded(
    evidence: Evidence,
    belief: Belief,
    after: int = 0,
    causes: Sequence[str] = tuple(CAUSES),
    at_most: float = AT_MOST,
) -> Evidence:
    """The windows, each of them weakened to what one may say for a change.

    Args:
        evidence: Windows in the order of time, softened.
        belief: What holds without a change.
        after: Windows that are left out.
        causes: What may have changed.
        at_most: Log-likelihood ratio that one window may speak for it.
    """
    begin = np.arange(after, len(evidence))
    sums, weaker = _Sums(evidence, belief, causes), np.ones(len(begin))
    for _ in range(ROUNDS):  # the ratio falls less than in proportion, as a rig may have drifted
        weaker *= np.maximum(sums.ratio(begin, begin + 1, weaker) / at_most, 1.0)
    return evidence.take(begin).tempered(weaker)


def statistic(evidence: Evidence, belief: Belief, after: int = 0) -> Array:
    """After each window the largest log-likelihood ratio of a change so far, shape (W,).

    Args:
        evidence: Windows in the order of time, softened.
        belief: What holds without a change.
        after: Windows for which it is not worked out, but left at zero.
    """
    sums = _Sums(evidence, belief)
    largest = np.zeros(len(evidence))
    for first in range(after, len(evidence), BLOCK):
        last = 1 + np.arange(first, min(first + BLOCK, len(evidence)))
        begin = np.maximum(last[:, None] - np.array(LOOKBACKS), 0)
        ratio = sums.ratio(begin, np.broadcast_to(last[:, None], begin.shape))
        largest[last - 1] = ratio.max(axis=1)
    return largest


def added_up(
    evidence: Evidence, belief: Belief, after: int, causes: Sequence[str], at_most: float
) -> Array:
    """After each window the largest sum of what those before it add for a change, shape (W,).

    The ratio of ``statistic`` after one more window less that before it is what this one adds,
    given all the others since the change; no window may add more than ``at_most``.

    Args:
        evidence: Windows in the order of time, softened.
        belief: What holds without a change.
        after: Windows for which it is not worked out, but left at zero.
        causes: What may have changed.
        at_most: Log-likelihood ratio that one window may add.
    """
    sums, count = _Sums(evidence, belief, causes), len(evidence)
    largest = np.zeros(count)
    length = np.arange(LOOKBACKS[-1] + 1)
    for first in range(max(after - LOOKBACKS[-1] + 1, 0), count, BLOCK):
        begin = np.arange(first, min(first + BLOCK, count))[:, None]
        last = np.minimum(begin + length, count)
        ratio = sums.ratio(np.broadcast_to(begin, last.shape), last)
        total = np.cumsum(np.minimum(np.diff(ratio), at_most), axis=1)
        np.maximum.at(largest, last[:, 1:] - 1, total)
    largest[:after] = 0.0
    return largest


def onset(evidence: Evidence, belief: Belief, alarm: int, last: int) -> int:
    """The first window after the most likely change.

    Args:
        evidence: Windows in the order of time, softened.
        belief: What holds without a change.
        alarm: The window after which there was an alarm.
        last: The last window that is counted.
    """
    begin = np.arange(max(alarm + 1 - LOOKBACKS[-1], 0), alarm + 1)
    ratio = _Sums(evidence, belief).ratio(begin, np.full(len(begin), last + 1))
    return int(begin[ratio.argmax()])


class Before(NamedTuple):
    """How far the twin was off before a change, as far as the log has shown.

    Attributes:
        mean: Most probable deviation from the belief, shape (P,).
        covariance: How unsure that is, shape (P, P).
    """

    mean: Array
    covariance: Array


def baseline(evidence: Evidence, belief: Belief, change: int) -> Before:
    """What the windows before a change have shown.

    Args:
        evidence: Windows in the order of time, softened.
        belief: What holds without a change.
        change: The first window after it.
    """
    before = evidence.take(np.arange(max(change - LEARNED, 0), change))
    A, b = before.information.sum(axis=0), before.score.sum(axis=0)  # noqa: N806
    mean, covariance = posterior(A, b, belief.uncertainty)
    return Before(mean, covariance + np.diag(belief.drift**2))


CAUSE = ("dead time",)
LATE = PARAMETERS.index("delay")
ALONE = 0.5
"""Log-likelihood ratio that one window alone may speak for a change of the dead time,"""
ADDED = 1.8
"""and on top of what the windows before it have said."""
ROOM = 0.2
"""Share of what else is expected to differ between windows in which the ball stops."""
LATE_THRESHOLD = 3.4
"""Log-likelihood ratio at which this test raises an alarm."""


def limited(evidence: Evidence, belief: Belief, after: int = 0) -> Evidence:
    """The windows that show the dead time, each weakened to what one may say for a change of it.

    Args:
        evidence: Windows in the order of time, not softened.
        belief: The twin.
        after: Windows that are left out.
    """
    rolling = np.array([CHANGING[name] for name in PARAMETERS])
    stopping = np.maximum(rolling, [ROOM * STOPPING[name] for name in PARAMETERS])
    room = np.hypot(belief.unit * np.stack((rolling, stopping)), belief.uneven)
    shows = evidence.information[:, LATE, LATE] > 0
    narrow = evidence.take(shows).softened(room)
    return bounded(narrow, belief, int(shows[:after].sum()), CAUSE, ALONE)


def delayed(evidence: Evidence, belief: Belief, after: int = 0) -> Array:
    """After each window the largest log-likelihood ratio of another dead time so far, shape (W,).

    Args:
        evidence: Windows in the order of time, ``limited``.
        belief: The twin.
        after: Windows for which it is not worked out, but left at zero.
    """
    return added_up(evidence, belief, after, CAUSE, ADDED)


def standing(evidence: Evidence, ratio: Array, time: Array) -> Array:
    """The statistic as it stands at some times, shape (T,).

    Args:
        evidence: Windows of the test, in the order of time.
        ratio: The statistic after each, shape (W,).
        time: Seconds, shape (T,).
    """
    windows = np.searchsorted(evidence.end, time, side="right")
    return np.asarray(np.concatenate((np.zeros(1), ratio))[windows])
