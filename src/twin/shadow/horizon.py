"""How far the twin strays from a log within a horizon, over its own predicted spread."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from controllers.arrays import Array, Mask
from twin.identify.prepare import PreparedLog, Segment
from twin.identify.rests import ROLL, speed
from twin.identify.windows import BIN, LOOKBACK, Spans, cut
from twin.shadow.ball import portions
from twin.shadow.belief import Belief
from twin.shadow.friction_map import FrictionMap, foreseen
from twin.shadow.gaps import clear
from twin.shadow.open_loop import OpenLoop
from twin.shadow.smoothing import LEAD

MEDIAN, BAND = 2 * np.log(2.0), 5.991
"""Median and 95 % quantile of a chi-square of two degrees of freedom."""
ROWS = ("time", "error", "spread", "told", "path")
DRAWN = 5
"""Steps of a replay from one point of its path that is kept to the next."""


@dataclass(frozen=True)
class Replays:
    """Replays of one horizon.

    Attributes:
        time: When each was started, s, shape (W,).
        ahead: Horizon in s.
        error: Measured ball minus replay at the horizon, m, shape (W, 2); NaN without a sample.
        spread: Predicted covariance of it, m^2, shape (W, 2, 2).
        told: Whether the ball moved, so that the replay can tell anything, shape (W,).
        path: Where the twin's ball is from the start on, every ``DRAWN`` steps, m, shape (W, N, 2).
    """

    time: Array
    ahead: float
    error: Array
    spread: Array
    told: Mask
    path: Array

    def take(self, which: Mask) -> Replays:
        """Some of them."""
        parts: dict[str, Any] = {name: getattr(self, name)[which] for name in ROWS}
        return replace(self, **parts)

    @classmethod
    def join(cls, parts: Sequence[Replays]) -> Replays:
        """All of several of one horizon."""
        rows: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in parts]) for name in ROWS
        }
        return replace(parts[0], **rows)

    @property
    def square(self) -> Array:
        """Squared error in units of the predicted spread, e' S^-1 e, shape (W,)."""
        solved = np.linalg.solve(self.spread, self.error[..., None])[..., 0]
        return np.asarray((self.error * solved).sum(axis=-1))

    @property
    def score(self) -> Array:
        """Error over predicted spread, scaled so that half of all are below 1, shape (W,)."""
        return np.asarray(np.sqrt(self.square / MEDIAN))

    @property
    def distance(self) -> Array:
        """Length of the error, m, shape (W,)."""
        return np.hypot(self.error[:, 0], self.error[:, 1])

    @property
    def band(self) -> Array:
        """How far the 95 % ellipse reaches in the direction of the error, m, shape (W,)."""
        return np.asarray(self.distance * np.sqrt(BAND / np.maximum(self.square, 1e-12)))

    @property
    def counted(self) -> Mask:
        """Those that tell something, shape (W,)."""
        return np.asarray(self.told & np.isfinite(self.error).all(axis=-1))


def replays(
    log: PreparedLog,
    belief: Belief,
    gaps: Array,
    ahead: float,
    every: float,
    since: float = -np.inf,
    until: float = np.inf,
    screen: FrictionMap | None = None,
) -> Replays | None:
    """Replays of a log from many starts; None if it is too short for any.

    Args:
        log: What was recorded.
        belief: The twin.
        gaps: Of the log; a replay over one tells nothing.
        ahead: Horizon in s.
        every: Seconds between the starts of two replays.
        since: The first start in s, where a log goes back further.
        until: Seconds; of replays that end later there is none.
        screen: Learns on; by default a screen of which nothing is known.
    """
    screen = screen or FrictionMap(belief)

    def spans(later: float, length: float) -> Callable[[Segment, float, float, float], Spans]:
        def chosen(segment: Segment, begin: float, end: float, longest: float) -> Spans:
            del segment, longest
            last = min(end, until) - (LEAD + ahead + BIN)
            begins = np.arange(max(begin, since - LEAD), last, every) + later
            return Spans(begins, np.full(len(begins), length), np.zeros(len(begins), bool))

        return chosen

    before = cut(log, belief.lag, LEAD, spans(0.0, LEAD))
    after = cut(log, belief.lag, ahead + BIN, spans(LEAD, ahead + BIN))
    if before is None or after is None:
        return None
    start = after.begin + LOOKBACK
    whole = clear(before.begin, before.begin + LOOKBACK + LEAD, gaps)
    parts = []
    for part in portions(len(start)):
        loop = OpenLoop.of(belief, before.take(part), after.take(part))
        known = foreseen(loop.ways, whole[part], screen)
        parts.append(loop.replayed(known, ahead, log.sample_period))
    error, spread, path = (np.concatenate(each) for each in zip(*parts, strict=True))
    told = _moving(log, start, ahead)
    told &= clear(start - LEAD - LOOKBACK, start + ahead, gaps)
    return Replays(start, ahead, error, spread, told, path[:, ::DRAWN])


def _moving(log: PreparedLog, start: Array, ahead: float) -> Mask:
    """Whether the ball rolls at all from each start to its horizon."""
    told = np.zeros(len(start), bool)
    for segment in log.segments:
        fast = np.concatenate(([0], np.cumsum(speed(segment.time, segment.even_ball) > ROLL)))
        inside = (start >= segment.time[0]) & (start <= segment.time[-1])
        first = np.searchsorted(segment.time, start[inside])
        last = np.searchsorted(segment.time, np.minimum(start[inside] + ahead, segment.time[-1]))
        told[inside] = fast[last] > fast[first]
    return told
