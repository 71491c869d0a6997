"""How far the twin strays in an open loop from the smoothed state of a log, over its own spread.

At every start the ball's state is that which suits the samples before it. From there the twin goes
on by itself; the plate is the servos' response to the recorded commands, corrected by the encoders.
What the twin does not know, its state at the start and its parameters, is drawn as sigma points
(Julier and Uhlmann), so that a ball that may or may not stop has the spread that comes of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from controllers.arrays import Array, Mask
from twin.identify.parameters import BALL as BOUNDS
from twin.identify.prepare import PreparedLog, Segment
from twin.identify.replay import STEP
from twin.identify.rests import ROLL, speed
from twin.identify.windows import BIN, LOOKBACK, Spans, Windows, cut
from twin.shadow.belief import BALL, Belief
from twin.shadow.beside import Beside, alike
from twin.shadow.friction_map import FrictionMap, Known, Ways, walked
from twin.shadow.gaps import clear
from twin.shadow.smoothing import LEAD, Lead, braking, forces, smoothed
from twin.shadow.unevenness import FINE, THINNED, unforeseen

HORIZONS = (0.5, 1.0, 2.0)
"""Seconds ahead that may be chosen."""
MEDIAN, BAND = 2 * np.log(2.0), 5.991
"""Median and 95 % quantile of a chi-square of two degrees of freedom."""
ROWS = ("time", "error", "spread", "told", "path")
DRAWN = 5
"""Steps of a replay from one point of its path that is kept to the next."""
KAPPA = 1.0
"""Weight of the middle sigma point."""


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
        portions = [(which, part, windows.take(which)) for which, part in twins.portions()]
        leads = [Lead.of(part) for _, part, _ in portions]
        ways = [
            _way(part, lead, rest) for (_, part, rest), lead in zip(portions, leads, strict=True)
        ]
        known = walked(Ways.join(ways), twins.owner, [screens[place] for place in some])
        recorded = [logs[place][0] for place in some]
        joined = Replays.join(
            [
                _replayed(part, lead, known.take(which), rest, ahead, recorded)
                for (which, part, rest), lead in zip(portions, leads, strict=True)
            ]
        )
        for number, place in enumerate(some):
            log, _, gaps = logs[place]
            of_log = joined.take(twins.owner == number)
            start = of_log.time
            told = _moving(log, start, ahead)
            told &= clear(start - LEAD - LOOKBACK, start + ahead, gaps)
            found[place] = replace(of_log, told=told)
    return found


def _way(before: Beside, lead: Lead, windows: Windows) -> Ways:
    """Where balls went up to the begin of windows, and where the twin expects them to go on."""
    whole = replace(before, windows=windows).problem
    places, _ = whole.replayed(before.theta, lead.end.T[:, None])
    information, score = lead.of_friction(before)
    ahead = places[:-1:THINNED, :, 0].transpose(2, 0, 1)
    return Ways(windows.begin + LOOKBACK, lead.places, information, score, ahead)


def _replayed(
    before: Beside,
    lead: Lead,
    known: Known,
    windows: Windows,
    ahead: float,
    logs: Sequence[PreparedLog],
) -> Replays:
    """Replays of windows from where the twin is at their begin; what they tell is left open."""
    points, weights = _sigma_points(before, lead, known)
    windows = windows.resisted(1 + np.repeat(known.ahead, THINNED, axis=1))
    whole = replace(before, windows=windows).problem
    places, speeds = whole.replayed(*points)
    ball, _ = windows.at_samples(places, speeds, whole.values(points[0])["delay"])
    at = windows.time - (LOOKBACK + ahead)
    # a screen of slow frames has not one in every bin; the twin is asked for the sample's own time
    away = np.where(windows.weight[..., 0] > 0, np.abs(at), np.inf)
    rows, sample = np.arange(len(windows)), np.argmin(away, axis=1)
    apart = np.maximum(BIN, [log.sample_period for log in logs])[before.owner]
    near = away[rows, sample] <= apart / 2 + 1e-6
    drawn = ball[:, rows, sample]
    middle = np.einsum("c,cwi->wi", weights, drawn)
    off = drawn - middle
    noise = 1 / np.maximum(windows.weight[rows, sample], 1e-12) ** 2
    spread = np.einsum("c,cwi,cwj->wij", weights, off, off)
    spread += noise[..., None] * np.eye(2)
    gone = LOOKBACK + ahead
    way = np.einsum("c,nicw->niw", weights, speeds[: round(gone / STEP) + 1])
    spread += unforeseen(forces(before, way), gone)
    friction = braking(before, way)
    among = known.unsure[:, : friction.shape[1], : friction.shape[1]]
    spread += unforeseen(friction, gone, FINE, among)
    error = np.where(near[:, None], windows.ball[rows, sample] - middle, np.nan)
    start = windows.begin + LOOKBACK
    path = np.einsum("c,nicw->wni", weights, places)[:, round(LOOKBACK / STEP) :]
    path = path[:, : round(ahead / STEP) + 1 : DRAWN]
    return Replays(start, ahead, error, spread, np.zeros(len(start), bool), path)


def _sigma_points(beside: Beside, lead: Lead, known: Known) -> tuple[tuple[Array, Array], Array]:
    """Parameters (C, W, P) and starts (4, C, W) that stand for all that may be, and weights (C,).

    Both are what the samples before the start, and what is believed of the parameters and known of
    the screen, make of them.
    """
    mean, covariance = smoothed(lead, beside, known)
    windows, count = mean.shape
    side = np.sqrt(count + KAPPA) * np.swapaxes(np.linalg.cholesky(covariance), -1, -2)
    sides = np.moveaxis(np.stack((side, -side)), 2, 1)
    offsets = np.concatenate((np.zeros((1, windows, count)), *sides))
    moved = mean + offsets
    every = np.repeat(beside.theta, len(moved), axis=0)
    for k, name in enumerate(BALL):
        every[..., k] = np.maximum(every[..., k] + moved[..., k], BOUNDS[name].least)
    begun = lead.end.T[:, None] + np.moveaxis(moved[..., len(BALL) :], -1, 0)
    weights = np.full(len(moved), 1 / (2 * (count + KAPPA)))
    weights[0] = KAPPA / (count + KAPPA)
    return (every, begun), weights


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
