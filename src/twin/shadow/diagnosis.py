"""Weighs the causes of an alarm: each with the likelihood around what it would have changed.

The evidence of the windows holds close to what is believed. A cause that changes the ball's motion
much is therefore expanded again where it puts the parameters, until both agree (Laplace's method).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr

from controllers.arrays import Array
from twin.identify.parameters import BALL as BOUNDS
from twin.identify.windows import Windows
from twin.shadow.ball import ball_evidence
from twin.shadow.belief import BALL, PARAMETERS, Belief
from twin.shadow.causes import CAUSES, Cause, changes, one_sided, words_of
from twin.shadow.evidence import Evidence, log_evidence, posterior
from twin.shadow.monitor import Before

ROUNDS = 3
"""How often a cause is expanded again,"""
SETTLED = 2
"""after how often likelihoods are close to what they come to,"""
HOPELESS = 20.0
"""and how much less likely than the best, as a logarithm, is then not worth a further time."""
MOVED = tuple(name for name, sizes in CAUSES.items() if set(sizes) <= set(BALL))
"""Causes that change the ball's motion."""


@dataclass(frozen=True)
class Suspicion:
    """The part of a log that an alarm is about.

    Attributes:
        windows: In which the ball moves; None if there are none.
        ball: Evidence of them around the belief, not softened.
        other: That of the plate and the screen, not softened.
    """

    windows: Windows | None
    ball: Evidence | None
    other: Evidence


@dataclass(frozen=True)
class _Hypothesis:
    """A cause, and the evidence around a deviation ``at`` from the belief, shape (P,).

    Attributes:
        name: Of the cause.
        prior: Covariance of the deviation, shape (P, P).
        ball: Windows of the ball, expanded at ``at``, softened.
        other: Evidence of plate and screen, expanded at the belief.
        at: Where, shape (P,).
    """

    name: str
    prior: Array
    ball: Evidence | None
    other: Evidence
    at: Array

    def sums(self) -> tuple[Array, Array, float]:
        """A, b and height about ``at``."""
        A, b = _sums(self.other)  # noqa: N806
        b = b - A @ self.at
        if self.ball is None:
            return A, b, 0.0
        more, slope = _sums(self.ball)
        return A + more, b + slope, float(self.ball.height.sum())

    def moved(self, before: Before) -> Array:
        """The most probable deviation from the belief, shape (P,)."""
        A, b, _ = self.sums()  # noqa: N806
        return np.asarray(self.at + posterior(A, b, self.prior, before.mean - self.at)[0])

    def log(self, before: Before, belief: Belief) -> float:
        """Logarithm of the marginal likelihood."""
        A, b, height = self.sums()  # noqa: N806
        mean = before.mean - self.at
        total = height + float(log_evidence(A, b, self.prior, mean))
        middle, covariance = posterior(A, b, self.prior, mean)
        for name in one_sided(belief):
            k = PARAMETERS.index(name)
            if name in CAUSES[self.name]:
                grown = (self.at + middle - before.mean)[k] / np.sqrt(max(covariance[k, k], 1e-24))
                total += float(np.log(2) + log_ndtr(grown))
        return total


def weigh(found: Suspicion, before: Before, belief: Belief) -> list[Cause]:
    """The causes of what is in a part of a log, the most probable first.

    Args:
        found: The part of the log.
        before: How far the twin was off before it.
        belief: The twin.
    """
    expanded = {} if found.ball is None else dict.fromkeys(CAUSES, found.ball)
    nowhere: Array = np.zeros(len(PARAMETERS))
    at = dict.fromkeys(CAUSES, nowhere)
    hypotheses = _hypotheses(found, expanded, at, before, belief)
    for number in range(ROUNDS if found.windows is not None else 0):
        assert found.windows is not None
        logs = np.array([each.log(before, belief) for each in hypotheses])
        for hypothesis, log in zip(hypotheses, logs, strict=True):
            hopeless = log <= logs.max() - HOPELESS and number >= SETTLED
            if hypothesis.name in MOVED and not hopeless:
                theta = _bounded(belief, hypothesis.moved(before))
                expanded[hypothesis.name] = ball_evidence(found.windows, belief, theta)
                at[hypothesis.name] = _deviation(belief, theta)
        hypotheses = _hypotheses(found, expanded, at, before, belief)
    logs = np.array([each.log(before, belief) for each in hypotheses])
    weights: Array = np.exp(logs - logs.max())
    weights /= weights.sum()
    causes = [
        Cause(each.name, float(p), words_of(each.name, each.moved(before) - before.mean, belief))
        for each, p in zip(hypotheses, weights, strict=True)
    ]
    return sorted(causes, key=lambda each: -each.probability)


def _hypotheses(
    found: Suspicion,
    expanded: Mapping[str, Evidence],
    at: Mapping[str, Array],
    before: Before,
    belief: Belief,
) -> list[_Hypothesis]:
    """The hypotheses, each with its evidence expanded where it puts the parameters.

    Args:
        found: The part of the log.
        expanded: Evidence of the ball by cause, not softened.
        at: Where, by cause, each shape (P,).
        before: How far the twin was off before.
        belief: The twin.
    """
    other = found.other.softened(belief.changing)
    balls: dict[str, Evidence] = {}
    if expanded:  # noise as large for every cause as the best of them leaves
        left = np.min([each.dispersion for each in expanded.values()], axis=0)
        balls = {k: ball.tempered(left).softened(belief.changing) for k, ball in expanded.items()}
    return [
        _Hypothesis(name, prior, balls.get(name), other, at[name])
        for name, prior in zip(CAUSES, before.covariance + changes(belief), strict=True)
    ]


def _sums(evidence: Evidence) -> tuple[Array, Array]:
    return evidence.information.sum(axis=0), evidence.score.sum(axis=0)


def _bounded(belief: Belief, moved: Array) -> Array:
    theta: Array = belief.theta[0].copy()
    for k, name in enumerate(BALL):
        value = theta[k] + moved[PARAMETERS.index(name)]
        theta[k] = min(max(value, BOUNDS[name].least), BOUNDS[name].most)
    return theta


def _deviation(belief: Belief, theta: Array) -> Array:
    at = np.zeros(len(PARAMETERS))
    at[[PARAMETERS.index(name) for name in BALL]] = (theta - belief.theta[0])[: len(BALL)]
    return at
