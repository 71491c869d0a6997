"""When reality has left the model, and why: the causes of an alarm weighed against each other.

The evidence of the windows holds close to what is believed. A cause that changes the ball's motion
much is therefore expanded again where it puts the parameters, until both agree (Laplace's method).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import log_ndtr

from controllers.arrays import Array, Mask
from twin.identify.parameters import BALL as BOUNDS
from twin.identify.windows import Windows
from twin.shadow.ball import ball_evidence
from twin.shadow.belief import BALL, PARAMETERS, Belief
from twin.shadow.causes import CAUSES, Cause, changes, in_words, likely, one_sided, words_of
from twin.shadow.evidence import Evidence, log_evidence, posterior
from twin.shadow.monitor import LATE_THRESHOLD, Before, baseline, onset

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


THRESHOLD = 12.0
"""Log-likelihood ratio of any cause at which an alarm is raised; the dead time has its own."""
SETTLING = 15.0
"""Seconds after an alarm that are looked at for its cause."""
STRADDLING = 2.0
"""Seconds after the most likely time of a change in which it may still lie,"""
ENOUGH = 2
"""which are left out where at least so many windows come after."""


@dataclass(frozen=True)
class Alarm:
    """Reality has left the model.

    Attributes:
        time: When it was noticed, s.
        since: The most likely time of the change, s.
        ratio: Log-likelihood ratio of a change against none, in the test that raised it.
        causes: All hypotheses, the most probable first.
    """

    time: float
    since: float
    ratio: float
    causes: tuple[Cause, ...]

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``: the causes that cannot be ruled out."""
        return {
            "time": self.time,
            "since": self.since,
            "log_likelihood_ratio": self.ratio,
            "words": self.words,
            "causes": [each.as_dict() for each in likely(self.causes)],
        }

    @property
    def words(self) -> str:
        """One sentence."""
        return f"{self.time:.1f} s, since about {self.since:.1f} s: {in_words(self.causes)}"


@dataclass(frozen=True)
class Findings:
    """What the windows of a log say, from which alarms are made.

    Attributes:
        soft: All of it, softened, in the order of time.
        factors: Learned of the scatter from window to window, shape (W, P).
        ratio: The statistic of the sequential test after each window of it, shape (W,).
        delayed: That of the test for the dead time alone, shape (W,).
        ball: Windows in which the ball moves, not softened; None if there are none.
        windows: The same, as they are replayed.
        other: Evidence of plate and screen, not softened.
    """

    soft: Evidence
    factors: Array
    ratio: Array
    delayed: Array
    ball: Evidence | None
    windows: Windows | None
    other: Evidence

    @property
    def crossings(self) -> list[int]:
        """Windows at which a test comes to exceed its threshold, both having been far below it."""
        share = np.maximum(self.ratio / THRESHOLD, self.delayed / LATE_THRESHOLD)
        return crossings(share)

    def crossed(self, crossing: int) -> float:
        """The log-likelihood ratio of the test that a window raises an alarm by."""
        of_all = float(self.ratio[crossing])
        return of_all if of_all > THRESHOLD else float(self.delayed[crossing])

    def alarm(self, crossing: int, belief: Belief) -> Alarm:
        """The alarm after a window of ``soft``: since when, and why.

        Args:
            crossing: Which window.
            belief: The twin.
        """
        soft = self.soft
        end = float(soft.end[crossing]) + SETTLING
        last = int(np.searchsorted(soft.end, end, side="right")) - 1
        since = onset(soft, belief, crossing, last)
        begin = float(soft.begin[since])
        scattering = replace(belief, changing=belief.changing * self.factors[since])
        causes = weigh(self._suspicion(begin, end), baseline(soft, belief, since), scattering)
        return Alarm(float(soft.end[crossing]), begin, self.crossed(crossing), tuple(causes))

    def _suspicion(self, begin: float, end: float) -> Suspicion:
        """What the log holds between two times in s."""

        def between(part: Evidence) -> Mask:
            return np.asarray((part.begin >= begin - 1e-9) & (part.end <= end))

        rest, ball = self.other.take(between(self.other)), self.ball
        if ball is None or self.windows is None or not between(ball).any():
            return Suspicion(None, None, rest)
        chosen = between(ball)
        # a window in which the change may lie speaks for neither before nor after
        clear = chosen & (ball.begin >= begin + STRADDLING)
        if clear.sum() >= ENOUGH:
            chosen = clear
        return Suspicion(self.windows.take(chosen), ball.take(chosen), rest)


def crossings(share: Array) -> list[int]:
    """Windows at which a statistic comes to exceed its threshold, having been far below it.

    Args:
        share: The statistic over its threshold, shape (W,).
    """
    found, armed = [], True
    for window, value in enumerate(share):
        if armed and value > 1:
            found.append(window)
        armed = value < 1 / 3 if not armed or value > 1 else armed
    return found
