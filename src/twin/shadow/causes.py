"""Alarms, and their causes weighed against each other.

The evidence of the windows holds close to what is believed. A cause that changes the ball's motion
much is therefore expanded again where it puts the parameters, until both agree (Laplace's method).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from controllers.arrays import Array
from twin.identify.parameters import BALL_PARAMETERS as BOUNDS
from twin.identify.parameters import LEVEL_PARAMETERS
from twin.identify.windows import Windows
from twin.shadow.alarms import Before
from twin.shadow.belief import BALL_BELIEFS, BELIEF_TABLES, CAUSE_SIZES, WATCHED_PARAMETERS, Belief
from twin.shadow.evidence import (
    NO_EVIDENCE,
    Evidence,
    ball_evidence,
    log_evidence,
    posterior,
)
from twin.shadow.plate import PLAY_WIDTHS_RAD
from twin.shadow.possible import limits_of, log_possible


@dataclass(frozen=True, kw_only=True)
class CauseSearch:
    """How the causes of an alarm are weighed.

    Attributes:
        laplace_iterations: Laplace expansions of the likelihood of a cause.
        prune_after: Expansions after which unlikely causes are dropped.
        prune_llr: Log-likelihood below the best cause at which a cause is dropped.
    """

    laplace_iterations: int = 3
    prune_after: int = 2
    prune_llr: float = 20.0


CAUSE_SEARCH = CauseSearch()
MIN_CAUSE_PROBABILITY = 0.05
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
    """Causes that cannot be ruled out; where there are several, the log does not separate them."""
    return [each for each in causes if each.probability >= MIN_CAUSE_PROBABILITY]


def in_words(causes: Sequence[Cause]) -> str:
    """Describe what has changed, or the causes that the log cannot tell apart."""
    left = likely(causes)
    if len(left) == 1:
        return f"{left[0].name} ({left[0].change})"
    names = [f"{each.name} ({each.change}; {100 * each.probability:.0f} %)" for each in left]
    return f"not distinguishable: {', '.join(names[:-1])} or {names[-1]}"


def words_of(name: str, moved: Array, belief: Belief) -> str:
    """The size of a change in words.

    Args:
        name: Of the cause.
        moved: Change of the parameters, shape (P,).
        belief: What held before.
    """
    at = {p: float(moved[WATCHED_PARAMETERS.index(p)]) for p in CAUSE_SIZES[name]}
    if name == "lost motion":
        gap = sum(share * width for share, width in zip(at.values(), PLAY_WIDTHS_RAD, strict=True))
        return f"{np.degrees(gap):+.2f} deg"
    parts = []
    absent = LEVEL_PARAMETERS[belief.scenario.plant.axes :]
    for parameter, value in at.items():
        if parameter in absent:
            continue
        about = BELIEF_TABLES["parameters"][parameter]
        unit = belief.values["rolling"] if parameter == "rolling" else 1.0
        size = np.exp(value) if parameter == "noise" else about["factor"] * (value / unit)
        parts.append(about["words"].format(size))
    if name == "another ball":
        return f"tilt gain {parts[0]}, rolling friction {parts[1]}"
    return ", ".join(parts)


MOTION_CAUSES = tuple(
    name for name, sizes in CAUSE_SIZES.items() if set(sizes) <= set(BALL_BELIEFS)
)
"""Causes that change the ball's motion."""


@dataclass
class _Hypothesis:
    """A cause, and the evidence around a deviation ``at`` from the belief, shape (P,).

    Attributes:
        name: Of the cause.
        prior: Covariance of the deviation, shape (P, P).
        other: Evidence of plate and screen, expanded at the belief, softened.
        expanded: Windows of the ball, expanded at ``at``.
        at: Where, shape (P,).
        ball: The same windows, softened.
    """

    name: str
    prior: Array
    other: Evidence
    expanded: Evidence
    at: Array
    ball: Evidence = NO_EVIDENCE

    def sums(self) -> tuple[Array, Array, float]:
        """A, b and height about ``at``."""
        A, b = self.other.information.sum(axis=0), self.other.score.sum(axis=0)  # noqa: N806
        more, slope = self.ball.information.sum(axis=0), self.ball.score.sum(axis=0)
        return A + more, b - A @ self.at + slope, float(self.ball.height.sum())

    def moved(self, before: Before) -> Array:
        """The most probable deviation from the belief, shape (P,)."""
        A, b, _ = self.sums()  # noqa: N806
        return np.asarray(self.at + posterior(A, b, self.prior, before.mean - self.at)[0])

    def expand(self, before: Before, belief: Belief, windows: Windows) -> None:
        """Expand the windows of the ball anew where the cause puts the parameters."""
        watched, believed = (
            [WATCHED_PARAMETERS.index(name) for name in BALL_BELIEFS],
            belief.theta[0],
        )
        least, most = zip(
            *((BOUNDS[name].least, BOUNDS[name].most) for name in BALL_BELIEFS), strict=True
        )
        theta, count = believed.copy(), len(BALL_BELIEFS)
        theta[:count] = np.clip(theta[:count] + self.moved(before)[watched], least, most)
        self.expanded = ball_evidence(windows, belief, theta)
        self.at = np.zeros(len(WATCHED_PARAMETERS))
        self.at[watched] = (theta - believed)[:count]

    def log(self, before: Before, belief: Belief) -> float:
        """Logarithm of the marginal likelihood."""
        A, b, height = self.sums()  # noqa: N806
        mean = before.mean - self.at
        total = height + float(log_evidence(A, b, self.prior, mean))
        limit = limits_of(belief).get(self.name)
        if limit is not None:
            about = limit._replace(least=limit.least - float(limit.weights @ self.at))
            total += float(log_possible(A, b, self.prior, mean, about))
        return total


def weigh(
    ball: Evidence,
    windows: Windows | None,
    other: Evidence,
    before: Before,
    belief: Belief,
    search: CauseSearch = CAUSE_SEARCH,
) -> list[Cause]:
    """The causes of what is in a part of a log, the most probable first.

    Args:
        ball: Windows in which the ball moves, expanded around the belief, not softened.
        windows: The same, as they are replayed; None if there are none.
        other: Evidence of plate and screen, not softened.
        before: How far the twin was off before it.
        belief: The twin.
        search: Constants of the expansions.
    """
    soft, nowhere = other.softened(belief.changing), np.zeros(len(WATCHED_PARAMETERS))
    priors = before.covariance + belief.changes
    hypotheses = [
        _Hypothesis(name, prior, soft, ball, nowhere)
        for name, prior in zip(CAUSE_SIZES, priors, strict=True)
    ]
    logs = np.zeros(len(hypotheses))
    for number in range(1 + search.laplace_iterations):
        for each, log in zip(hypotheses, logs, strict=True):
            hopeless = log <= logs.max() - search.prune_llr and number > search.prune_after
            if number and windows is not None and each.name in MOTION_CAUSES and not hopeless:
                each.expand(before, belief, windows)
        # noise as large for every cause as the best of them leaves
        left = np.min([each.expanded.dispersion for each in hypotheses], axis=0)
        for each in hypotheses:
            each.ball = each.expanded.tempered(left).softened(belief.changing)
        logs = np.array([each.log(before, belief) for each in hypotheses])
    weights: Array = np.exp(logs - logs.max())
    weights /= weights.sum()
    causes = [
        Cause(each.name, float(p), words_of(each.name, each.moved(before) - before.mean, belief))
        for each, p in zip(hypotheses, weights, strict=True)
    ]
    return sorted(causes, key=lambda each: -each.probability)


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
