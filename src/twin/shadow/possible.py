"""What a change cannot make of a rig: a breakaway ratio below 1, a lag or a gap below zero.

A cause is a Gaussian prior of the deviation, and a part of it may be impossible. This part is left
out: the prior is truncated, and what is left is scaled to a probability of 1.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr

from controllers.arrays import Array
from twin.shadow.belief import WATCHED_PARAMETERS, Belief
from twin.shadow.evidence import posterior
from twin.shadow.plate import PLAY_WIDTHS_RAD


class Limit(NamedTuple):
    """What a deviation d from the belief has to fulfil: w'd >= l.

    Attributes:
        weights: w, shape (P,).
        least: l.
    """

    weights: Array
    least: float


def limits_of(belief: Belief) -> dict[str, Limit]:
    """The limits of causes that have one, by their names; what is believed is within them."""
    unit = dict(zip(WATCHED_PARAMETERS, np.eye(len(WATCHED_PARAMETERS)), strict=True))
    narrow, wide = PLAY_WIDTHS_RAD
    gap = narrow * unit["narrow_play"] + wide * unit["wide_play"]
    return {
        "breakaway": Limit(unit["breakaway"], min(0.0, 1 - belief.values["breakaway"])),
        "servo lag": Limit(unit["lag"], -belief.lag),
        "lost motion": Limit(gap, -belief.play),
    }


def log_possible(
    information: Array, score: Array, prior: Array, mean: Array, limit: Limit
) -> Array:
    """What a prior without its impossible part adds to ``log_evidence``, shape (...).

    The integral of the likelihood over N(m, V) truncated to w'd >= l is the integral over N(m, V),
    times the possible share of the posterior N(p, S) over the possible share of the prior:
    ln Phi((w'p - l) / sqrt(w'S w)) - ln Phi((w'm - l) / sqrt(w'V w)).

    Args:
        information: A, shape (..., P, P).
        score: b, shape (..., P).
        prior: V, shape (..., P, P).
        mean: m, shape (..., P).
        limit: w and l.
    """
    after = posterior(information, score, prior, mean)
    shares = [_log_share(*each, limit) for each in (after, (mean, prior))]
    return np.asarray(shares[0] - shares[1])


def _log_share(mean: Array, covariance: Array, limit: Limit) -> Array:
    """Logarithm of the probability that a Gaussian deviation is possible, shape (...)."""
    weights = limit.weights
    variance = np.maximum(weights @ covariance @ weights, 1e-24)
    return np.asarray(log_ndtr((mean @ weights - limit.least) / np.sqrt(variance)))
