"""How far the twin strays from a log within a horizon, over its own predicted spread."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from controllers.arrays import Array, Mask
from twin.identify.prepare import PreparedLog, Segment
from twin.identify.rests import ROLL, speed
from twin.identify.windows import BIN, LOOKBACK, Spans, Windows, cut
from twin.shadow.belief import Belief
from twin.shadow.beside import Beside, alike
from twin.shadow.friction_map import FrictionMap, Ways, foreseen
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
    logs: Sequence[tuple[PreparedLog, Belief, Array]],
    ahead: float,
    every: float,
    since: float = -np.inf,
    until: float = np.inf,
    maps: Sequence[FrictionMap] | None = None,
) -> list[Replays | None]:
    """Replays of logs from many starts, of each; None if it is too short for any.

    Args:
        logs: What was recorded, the twin, and the gaps: a replay over one tells nothing.
        ahead: Horizon in s.
        every: Seconds between the starts of two replays.
        since: The first start in s, where a log goes back further.
        until: Seconds; of replays that end later there is none.
        maps: Of the screen of each log, which learn on; by default of one nothing is known of.
    """
    screens = [FrictionMap(belief) for _, belief, _ in logs] if maps is None else maps

    def spans(later: float, length: float) -> Callable[[Segment, float, float, float], Spans]:
        def chosen(segment: Segment, begin: float, end: float, longest: float) -> Spans:
            del segment, longest
            last = min(end, until) - (LEAD + ahead + BIN)
            begins = np.arange(max(begin, since - LEAD), last, every) + later
            return Spans(begins, np.full(len(begins), length), np.zeros(len(begins), bool))

        return chosen

    before: dict[int, Windows] = {}
    after: dict[int, Windows] = {}
    for place, (log, belief, _) in enumerate(logs):
        smoothed = cut(log, belief.lag, LEAD, spans(0.0, LEAD))
        gone_on = cut(log, belief.lag, ahead + BIN, spans(LEAD, ahead + BIN))
        if smoothed is not None and gone_on is not None:
            before[place], after[place] = smoothed, gone_on
    found: list[Replays | None] = [None] * len(logs)
    places = [*before]
    for group in alike([logs[place][1] for place in places]):
        some = [places[each] for each in group]
        twins = Beside.of([(before[place], logs[place][1]) for place in some])
        windows = Windows.join([after[place] for place in some])
        loops = [OpenLoop.of(part, windows.take(which)) for which, part in twins.portions()]
        ways = Ways.join([loop.ways for loop in loops])
        seen = [(before[place], logs[place][2]) for place in some]
        whole = [clear(each.begin, each.begin + LOOKBACK + LEAD, gaps) for each, gaps in seen]
        owned = [screens[place] for place in some]
        known = foreseen(ways, np.concatenate(whole), twins.owner, owned)
        period = np.array([logs[place][0].sample_period for place in some])[twins.owner]
        parts = [
            loop.replayed(known.take(which), ahead, period[which])
            for loop, (which, _) in zip(loops, twins.portions(), strict=True)
        ]
        error, spread, path = (np.concatenate(each) for each in zip(*parts, strict=True))
        for number, place in enumerate(some):
            log, _, gaps = logs[place]
            own = twins.owner == number
            start = ways.start[own]
            told = _moving(log, start, ahead)
            told &= clear(start - LEAD - LOOKBACK, start + ahead, gaps)
            found[place] = Replays(start, ahead, error[own], spread[own], told, path[own, ::DRAWN])
    return found


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
