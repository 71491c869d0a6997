"""Weighs the causes of an alarm: each with the likelihood around what it would have changed.

The evidence of the windows holds close to what is believed. A cause that changes the ball's motion
much is therefore expanded again where it puts the parameters, until both agree (Laplace's method).
"""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr

from controllers.arrays import Array, Mask
from twin.hal.interface import SCREEN
from twin.identify.parameters import BALL as BOUNDS
from twin.identify.windows import Windows
from twin.shadow.ball import Expansion, ball_evidence
from twin.shadow.belief import BALL, PARAMETERS, Belief
from twin.shadow.causes import CAUSES, CELLS, PATCH, Cause, changes, one_sided, words_of
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
ROLLING = "rolling friction"


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
        changed: Windows of the ball in which it holds, expanded at ``at``, softened.
        unchanged: The others, expanded at the belief.
        other: Evidence of plate and screen, expanded at the belief.
        at: Where, shape (P,).
    """

    name: str
    prior: Array
    changed: Evidence | None
    unchanged: Evidence | None
    other: Evidence
    at: Array

    def sums(self) -> tuple[Array, Array, float]:
        """A, b and height about ``at`` of all in which the cause holds."""
        A, b = _sums(self.other)  # noqa: N806
        b = b - A @ self.at
        if self.changed is None:
            return A, b, 0.0
        more, slope = _sums(self.changed)
        return A + more, b + slope, float(self.changed.height.sum())

    def moved(self, before: Before) -> Array:
        """The most probable deviation from the belief, shape (P,)."""
        A, b, _ = self.sums()  # noqa: N806
        return np.asarray(self.at + posterior(A, b, self.prior, before.mean - self.at)[0])

    def log(self, before: Before, belief: Belief) -> float:
        """Logarithm of the marginal likelihood."""
        A, b, height = self.sums()  # noqa: N806
        mean = before.mean - self.at
        total = height + float(log_evidence(A, b, self.prior, mean))
        if self.unchanged is not None and self.name == PATCH:
            rest = log_evidence(*_sums(self.unchanged), before.covariance, before.mean)
            return total + float(self.unchanged.height.sum() + rest - np.log(np.prod(CELLS)))
        middle, covariance = posterior(A, b, self.prior, mean)
        for name in one_sided(belief):
            k = PARAMETERS.index(name)
            if name in CAUSES[self.name]:
                grown = (self.at + middle - before.mean)[k] / np.sqrt(max(covariance[k, k], 1e-24))
                total += float(np.log(2) + log_ndtr(grown))
        return total


Weighing = Generator[Sequence[Expansion], list[Evidence], "list[Cause]"]
"""Asks for evidence, takes it, and returns causes: what many ask for is worked out in one go."""


def weighed(tasks: Sequence[Weighing]) -> list[list[Cause]]:
    """The causes that each of several weighings comes to."""
    found: list[list[Cause]] = [[] for _ in tasks]
    answers: dict[int, list[Evidence]] = {number: [] for number in range(len(tasks))}
    begun = False
    while answers:
        asked: dict[int, Sequence[Expansion]] = {}
        for number, answer in answers.items():
            try:
                asked[number] = tasks[number].send(answer) if begun else next(tasks[number])
            except StopIteration as done:
                found[number] = done.value
        evidence = iter(ball_evidence([each for many in asked.values() for each in many]))
        answers = {number: [next(evidence) for _ in many] for number, many in asked.items()}
        begun = True
    return found


def weigh(found: Suspicion, before: Before, belief: Belief) -> Weighing:
    """The causes of what is in a part of a log, the most probable first.

    Args:
        found: The part of the log.
        before: How far the twin was off before it.
        belief: The twin.
    """
    expanded = {} if found.ball is None else dict.fromkeys((*CAUSES, PATCH), found.ball)
    nowhere: Array = np.zeros(len(PARAMETERS))
    at = dict.fromkeys((*CAUSES, PATCH), nowhere)
    hypotheses = _hypotheses(found, expanded, at, before, belief)
    for number in range(ROUNDS if found.windows is not None else 0):
        assert found.windows is not None
        logs = np.array([each.log(before, belief) for each in hypotheses])
        again = [
            each
            for each, log in zip(hypotheses, logs, strict=True)
            if each.name in (*MOVED, PATCH) and (log > logs.max() - HOPELESS or number < SETTLED)
        ]
        thetas = [_bounded(belief, each.moved(before)) for each in again]
        evidence = yield [Expansion(found.windows, belief, theta) for theta in thetas]
        for hypothesis, theta, ball in zip(again, thetas, evidence, strict=True):
            expanded[hypothesis.name], at[hypothesis.name] = ball, _deviation(belief, theta)
        hypotheses = _hypotheses(found, expanded, at, before, belief)
    logs = np.array([each.log(before, belief) for each in hypotheses])
    weights: Array = np.exp(logs - logs.max())
    weights /= weights.sum()
    causes = []
    for each, weight in zip(hypotheses, weights, strict=True):
        moved = each.moved(before) - before.mean
        words = words_of(ROLLING if each.name == PATCH else each.name, moved, belief)
        if each.name == PATCH and each.changed is not None:
            x, y = 1000 * each.changed.place.mean(axis=0)
            words = f"friction {words} around x = {x:.0f}, y = {y:.0f} mm"
        causes.append(Cause(each.name, float(weight), words))
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
    priors = dict(zip(CAUSES, before.covariance + changes(belief), strict=True))
    if found.ball is None:
        return [_Hypothesis(name, priors[name], None, None, other, at[name]) for name in CAUSES]
    # noise as large for every cause as the best of them leaves
    left = np.min([each.dispersion for each in expanded.values()], axis=0)

    def calm(ball: Evidence) -> Evidence:
        return ball.tempered(left).softened(belief.changing)

    made = [
        _Hypothesis(name, priors[name], calm(expanded[name]), None, other, at[name])
        for name in CAUSES
    ]
    usual = calm(found.ball)
    inside = _cell(usual, before, belief)
    parts = calm(expanded[PATCH]).take(inside), usual.take(~inside)
    return [*made, _Hypothesis(PATCH, priors[ROLLING], *parts, other, at[PATCH])]


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


def _cells(ball: Evidence) -> Array:
    share = np.asarray(ball.place / np.array(SCREEN) + 0.5)
    place = np.clip((share * CELLS).astype(int), 0, np.array(CELLS) - 1)
    return np.asarray(place[:, 0] * CELLS[1] + place[:, 1])


def _cell(ball: Evidence, before: Before, belief: Belief) -> Mask:
    """The windows in the part of the screen in which a change of friction explains most."""
    cells = _cells(ball)
    changed = before.covariance + changes(belief)[list(CAUSES).index(ROLLING)]
    best, chosen = -np.inf, np.asarray(cells == cells[0])
    for cell in np.unique(cells):
        inside = np.asarray(cells == cell)
        total = sum(
            float(log_evidence(*_sums(ball.take(part)), prior, before.mean))
            for part, prior in ((inside, changed), (~inside, before.covariance))
        )
        if total > best:
            best, chosen = total, inside
    return chosen
