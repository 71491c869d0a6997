"""When reality has left the model, and why: the causes of an alarm weighed against each other.

The evidence of the windows holds close to what is believed. A cause that changes the ball's motion
much is therefore expanded again where it puts the parameters, until both agree (Laplace's method).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.special import log_ndtr

from controllers.arrays import Array
from twin.identify.parameters import BALL as BOUNDS
from twin.identify.windows import Windows
from twin.shadow.belief import BALL, CAUSES, PARAMETERS, TABLES, Belief
from twin.shadow.evidence import Evidence, log_evidence, posterior
from twin.shadow.monitor import Before
from twin.shadow.motion import GAPS, ball_evidence

LEAST = 0.05
"""Probability below which a cause counts as ruled out."""


@dataclass(frozen=True)
class Cause:
    """A hypothesis and how probable it is, all of them being equally likely beforehand.

    Attributes:
        name: What has changed.
        probability: 0 to 1.
        change: By how much, in words.
    """

    name: str
    probability: float
    change: str


def likely(causes: Sequence[Cause]) -> list[Cause]:
    """Those that cannot be ruled out; of more than one it is not told which it is."""
    return [each for each in causes if each.probability >= LEAST]


def in_words(causes: Sequence[Cause]) -> str:
    """What has changed, or between what the log does not tell."""
    left = likely(causes)
    if len(left) == 1:
        return f"{left[0].name} ({left[0].change})"
    names = [f"{each.name} ({each.change}; {100 * each.probability:.0f} %)" for each in left]
    return f"not told apart: {', '.join(names[:-1])} or {names[-1]}"


def words_of(name: str, moved: Array, belief: Belief) -> str:
    """The size of a change in words.

    Args:
        name: Of the cause.
        moved: Change of the parameters, shape (P,).
        belief: What held before.
    """
    at = {p: float(moved[PARAMETERS.index(p)]) for p in CAUSES[name]}
    if name == "lost motion":
        gap = sum(share * width for share, width in zip(at.values(), GAPS, strict=True))
        return f"{np.degrees(gap):+.2f} deg"
    parts = [
        _in_words(p, v / belief.values["rolling"] if p == "rolling" else v) for p, v in at.items()
    ]
    if name == "another ball":
        return f"tilt gain {parts[0]}, rolling friction {parts[1]}"
    return ", ".join(parts)


def _in_words(parameter: str, value: float) -> str:
    """A change of a parameter in words, that of the rolling friction as a share."""
    about = TABLES["parameters"][parameter]
    size = np.exp(value) if parameter == "noise" else about["factor"] * value
    text: str = about["words"].format(size)
    return text


def one_sided(belief: Belief) -> list[str]:
    """Parameters that can only have grown, since they are believed to be at their least."""
    least = {
        "breakaway": belief.values["breakaway"] <= 1,
        "lag": belief.lag <= 0,
        "narrow_play": belief.play <= 0,
        "wide_play": belief.play <= 0,
    }
    return [name for name, there in least.items() if there]


ROUNDS = 3
"""How often a cause is expanded again,"""
SETTLED = 2
"""after how often likelihoods are close to what they come to,"""
HOPELESS = 20.0
"""and how much less likely than the best, as a logarithm, is then not worth a further time."""
MOVED = tuple(name for name, sizes in CAUSES.items() if set(sizes) <= set(BALL))
"""Causes that change the ball's motion."""


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
    ball: Evidence
    other: Evidence
    at: Array

    def sums(self) -> tuple[Array, Array, float]:
        """A, b and height about ``at``."""
        A, b = _sums(self.other)  # noqa: N806
        more, slope = _sums(self.ball)
        return A + more, b - A @ self.at + slope, float(self.ball.height.sum())

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


def weigh(
    ball: Evidence, windows: Windows | None, other: Evidence, before: Before, belief: Belief
) -> list[Cause]:
    """The causes of what is in a part of a log, the most probable first.

    Args:
        ball: Windows in which the ball moves, expanded around the belief, not softened.
        windows: The same, as they are replayed; None if there are none.
        other: Evidence of plate and screen, not softened.
        before: How far the twin was off before it.
        belief: The twin.
    """
    expanded = dict.fromkeys(CAUSES, ball)
    nowhere: Array = np.zeros(len(PARAMETERS))
    at = dict.fromkeys(CAUSES, nowhere)
    soft = other.softened(belief.changing)
    hypotheses = _hypotheses(soft, expanded, at, before, belief)
    for number in range(0 if windows is None else ROUNDS):
        assert windows is not None
        logs = np.array([each.log(before, belief) for each in hypotheses])
        for hypothesis, log in zip(hypotheses, logs, strict=True):
            hopeless = log <= logs.max() - HOPELESS and number >= SETTLED
            if hypothesis.name in MOVED and not hopeless:
                theta = _bounded(belief, hypothesis.moved(before))
                expanded[hypothesis.name] = ball_evidence(windows, belief, theta)
                at[hypothesis.name] = _deviation(belief, theta)
        hypotheses = _hypotheses(soft, expanded, at, before, belief)
    logs = np.array([each.log(before, belief) for each in hypotheses])
    weights: Array = np.exp(logs - logs.max())
    weights /= weights.sum()
    causes = [
        Cause(each.name, float(p), words_of(each.name, each.moved(before) - before.mean, belief))
        for each, p in zip(hypotheses, weights, strict=True)
    ]
    return sorted(causes, key=lambda each: -each.probability)


def _hypotheses(
    soft: Evidence,
    expanded: Mapping[str, Evidence],
    at: Mapping[str, Array],
    before: Before,
    belief: Belief,
) -> list[_Hypothesis]:
    """The hypotheses, each with its evidence expanded where it puts the parameters.

    Args:
        soft: Evidence of plate and screen, softened.
        expanded: Evidence of the ball by cause, not softened.
        at: Where, by cause, each shape (P,).
        before: How far the twin was off before.
        belief: The twin.
    """
    # noise as large for every cause as the best of them leaves
    left = np.min([each.dispersion for each in expanded.values()], axis=0)
    balls = [each.tempered(left).softened(belief.changing) for each in expanded.values()]
    priors = before.covariance + belief.changes
    return [
        _Hypothesis(name, prior, ball, soft, at[name])
        for name, prior, ball in zip(CAUSES, priors, balls, strict=True)
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
            "causes": [asdict(each) for each in likely(self.causes)],
        }

    @property
    def words(self) -> str:
        """One sentence."""
        return f"{self.time:.1f} s, since about {self.since:.1f} s: {in_words(self.causes)}"


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
