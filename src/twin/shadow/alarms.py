"""When reality has left the model, and why."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from controllers.arrays import Array, Mask
from twin.identify.windows import Windows
from twin.shadow import dead_time
from twin.shadow.belief import Belief
from twin.shadow.causes import Cause, in_words, likely
from twin.shadow.diagnosis import Suspicion, weigh
from twin.shadow.evidence import Evidence
from twin.shadow.monitor import baseline, onset

THRESHOLD = 12.0
"""Log-likelihood ratio of any cause at which an alarm is raised; ``dead_time`` has its own."""
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
        share = np.maximum(self.ratio / THRESHOLD, self.delayed / dead_time.THRESHOLD)
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
