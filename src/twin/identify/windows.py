"""Windows of a log that are replayed side by side: where they begin and end, and their samples."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from controllers.arrays import Array, Mask
from controllers.ballplate import BallPlate
from twin.identify.plate_motion import PlateMotion, plate_motion
from twin.identify.prepare import (
    ROLL,
    SPEED_SPAN,
    PreparedLog,
    Segment,
    interpolated,
    paces,
    rests,
    speed,
)
from twin.identify.replay import STEP, AccelerationField

LOOKBACK = 0.15
"""Each replay begins this long before its samples, in s: no fit finds a longer delay."""
BIN = 0.016
"""Ball samples within this time in s are averaged."""
BY_WINDOW = ("begin", "resting", "paces", "time", "ball", "weight")
"""What of ``Windows`` has one entry per window first."""


class Spans(NamedTuple):
    """Windows: when their samples begin, how long they last, and whether the ball rests first."""

    begin: Array
    length: Array
    resting: Mask


@dataclass(frozen=True)
class Windows:
    """W parts of a log, each with up to B averaged ball samples.

    Attributes:
        begin: When the replay of each begins, s, shape (W,).
        resting: Whether the ball then rests, shape (W,).
        paces: Speeds of the ball over the last seconds before, ``PACE`` apart, m/s, shape (W, K).
        field: What accelerates the ball.
        time: When the samples were taken, s from ``begin``, shape (W, B).
        ball: x and y in m, shape (W, B, 2).
        weight: One over the standard deviation of each, 0 where there is none, shape (W, B, 2).
    """

    begin: Array
    resting: Mask
    paces: Array
    field: AccelerationField
    time: Array
    ball: Array
    weight: Array

    def __len__(self) -> int:
        """Number of windows."""
        return len(self.begin)

    @classmethod
    def of(
        cls,
        model: BallPlate,
        motion: PlateMotion,
        segment: Segment,
        spans: Spans,
        sigma: Array,
        longest: float,
    ) -> Windows:
        """The windows of a segment, replays beginning ``LOOKBACK`` before the spans.

        Args:
            model: Ball parameters.
            motion: What the plate did.
            segment: The ball samples.
            spans: Where the windows are.
            sigma: Standard deviation of a sample along x and y in m, shape (2,).
            longest: Room for windows of up to this time in s.
        """
        begin = spans.begin - LOOKBACK
        grid = begin[:, None] + STEP * np.arange(round((LOOKBACK + longest) / STEP) + 1)
        angle, rate = (
            interpolated(grid, motion.time, values) for values in (motion.angle, motion.rate)
        )
        bins = round(longest / BIN)
        place = np.floor((segment.sampled - spans.begin[:, None]) / BIN + 1e-6).astype(int)
        row, sample = np.nonzero((place >= 0) & (place < np.round(spans.length / BIN)[:, None]))
        slot = row * bins + place[row, sample]
        count = np.bincount(slot, minlength=len(begin) * bins).astype(float)
        time, x, y = (
            (np.bincount(slot, values, count.size) / np.maximum(count, 1)).reshape(-1, bins)
            for values in (segment.sampled[sample] - begin[row], *segment.ball[sample].T)
        )
        return cls(
            begin,
            spans.resting,
            paces(segment, begin),
            AccelerationField.of(model, angle, rate),
            time,
            np.stack((x, y), axis=-1),
            np.sqrt(count).reshape(-1, bins, 1) / sigma,
        )

    def take(self, which: Mask) -> Windows:
        """Some of the windows."""
        field = AccelerationField(*(values[..., which] for values in self.field))
        return Windows(field=field, **{name: getattr(self, name)[which] for name in BY_WINDOW})

    @classmethod
    def join(cls, parts: Sequence[Windows]) -> Windows:
        """All windows of several segments."""
        every = zip(*(part.field for part in parts), strict=True)
        field = AccelerationField(*(np.concatenate(values, axis=-1) for values in every))
        rest = {name: np.concatenate([getattr(part, name) for part in parts]) for name in BY_WINDOW}
        return cls(field=field, **rest)

    def resisted(self, share: Array) -> Windows:
        """The windows if friction is more or less at times: by a share at each step, (W, N)."""
        normal = self.field.normal * np.maximum(share, 0.0).T[: len(self.field.normal), None]
        return replace(self, field=self.field._replace(normal=normal))

    @property
    def size(self) -> Array:
        """Number of values in each window, at least 1, shape (W,)."""
        return np.asarray(np.maximum((self.weight > 0).sum(axis=(1, 2)), 1))

    def at_samples(self, places: Array, speeds: Array, delay: Array) -> tuple[Array, Array]:
        """What the screen would have reported, with its rate, both shape (C, W, B, 2).

        Cubic Hermite interpolation of a replay.

        Args:
            places: Positions in m, shape (N, 2, C, W).
            speeds: Velocities in m/s, same shape.
            delay: Seconds, shape (C, 1) or (C, W).
        """
        steps, _, candidates, windows = places.shape
        # each sample lies a share s into the step of its replay that begins at index low
        at = np.maximum(self.time - delay[..., None], 0.0) / STEP
        low = np.minimum(at.astype(int), steps - 2)
        s = (at - low)[..., None]
        lanes = candidates * windows
        # places in the flattened arrays, which are found faster than by four numbers each
        own = np.arange(lanes).reshape(candidates, windows, 1, 1) + lanes * np.arange(2)
        index = (2 * lanes * low)[..., None] + own
        after = index + 2 * lanes
        p0, v0 = places.take(index), STEP * speeds.take(index)
        rise, v1 = places.take(after) - p0, STEP * speeds.take(after)
        # the cubic with these values and slopes at both ends of the step
        square, cube = 3 * rise - 2 * v0 - v1, v0 + v1 - 2 * rise
        place = p0 + s * (v0 + s * (square + s * cube))
        return place, (v0 + s * (2 * square + 3 * s * cube)) / STEP


def cut(
    log: PreparedLog,
    lag: float,
    longest: float,
    choose: Callable[[Segment, float, float, float], Spans],
) -> Windows | None:
    """All windows of a log; None if there are none.

    Args:
        log: What was recorded.
        lag: Time constant of the drives in s.
        longest: Longest window in s.
        choose: Called with a segment, first and last time of its windows in s, and ``longest``.
    """
    parts = []
    for segment in log.segments:
        begin, end = segment.time[0] + LOOKBACK, min(segment.time[-1], segment.sampled[-1])
        spans = choose(segment, begin, end, longest)
        if len(spans.begin):
            motion = plate_motion(segment, lag, log.own_lag)
            parts.append(Windows.of(log.model, motion, segment, spans, log.sigma, longest))
    return Windows.join(parts) if parts else None


def moving_spans(segment: Segment, begin: float, end: float, longest: float) -> Spans:
    """Windows one after another between two times, each begun at rest or in full roll.

    A window goes on until the ball has come to rest again or the longest time is up. Of a rest
    only the end is in a window: what comes before says nothing.

    Args:
        segment: The part of the log.
        begin: Seconds.
        end: Seconds.
        longest: Longest window in s.
    """
    time = segment.time
    moving = speed(time, segment.even_ball)
    still = rests(time, segment.even_ball, moving)
    found: list[tuple[float, float, bool]] = []
    at = begin
    while at < end - SPEED_SPAN:
        rest = next(((a, b) for a, b in still if a - 1e-9 <= at < b), None)
        if rest is None and moving[int(np.searchsorted(time, at))] <= ROLL:
            at += 0.02
            continue
        if rest is not None and rest[1] > end - SPEED_SPAN:
            break
        first = at if rest is None else max(at, rest[1] - SPEED_SPAN)
        after = first if rest is None else rest[1]
        stop = next((a for a, _ in still if a > after), end)
        last = min(first + longest, stop + SPEED_SPAN, end)
        if last - first > SPEED_SPAN:
            found.append((first, last - first, rest is not None))
        at = last
    columns = np.array(found, dtype=float).reshape(-1, 3)
    return Spans(columns[:, 0], columns[:, 1], columns[:, 2] > 0)
