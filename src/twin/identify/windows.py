"""Windows of a log that are replayed side by side, and a replay seen as the log sees the ball."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from controllers.arrays import Array, Mask
from controllers.ballplate import BallPlate
from twin.identify.motion import Motion
from twin.identify.phases import Spans
from twin.identify.prepare import Stretch
from twin.identify.replay import STEP, Field

LOOKBACK = 0.15
"""Each replay begins this long before its samples, in s: no fit finds a longer delay."""
BIN = 0.016
"""Ball samples within this time in s are averaged."""


@dataclass(frozen=True)
class Windows:
    """W stretches of a log, each with up to B averaged ball samples.

    Attributes:
        begin: When the replay of each begins, s, shape (W,).
        resting: Whether the ball then rests, shape (W,).
        field: What accelerates the ball.
        time: When the samples were seen, s from ``begin``, shape (W, B).
        ball: x and y in m, shape (W, B, 2).
        weight: One over the standard deviation of each, 0 where there is none, shape (W, B, 2).
    """

    begin: Array
    resting: Mask
    field: Field
    time: Array
    ball: Array
    weight: Array

    def __len__(self) -> int:
        """Number of windows."""
        return len(self.begin)

    @classmethod
    def cut(
        cls,
        model: BallPlate,
        motion: Motion,
        stretch: Stretch,
        spans: Spans,
        sigma: Array,
        longest: float,
    ) -> Windows:
        """The windows of a stretch, replays beginning ``LOOKBACK`` before the spans.

        Args:
            model: Ball parameters.
            motion: What the plate did.
            stretch: The ball samples.
            spans: Where the windows are.
            sigma: Standard deviation of a sample along x and y in m, shape (2,).
            longest: Room for windows of up to this time in s.
        """
        begin = spans.begin - LOOKBACK
        grid = begin[:, None] + STEP * np.arange(round((LOOKBACK + longest) / STEP) + 1)
        angle, rate = (
            np.stack([np.interp(grid, motion.time, values[:, axis]) for axis in (0, 1)], axis=-1)
            for values in (motion.angle, motion.rate)
        )
        bins = round(longest / BIN)
        place = np.floor((stretch.seen - spans.begin[:, None]) / BIN + 1e-6).astype(int)
        row, sample = np.nonzero((place >= 0) & (place < np.round(spans.length / BIN)[:, None]))
        slot = row * bins + place[row, sample]
        count = np.bincount(slot, minlength=len(begin) * bins).astype(float)
        time, x, y = (
            (np.bincount(slot, values, count.size) / np.maximum(count, 1)).reshape(-1, bins)
            for values in (stretch.seen[sample] - begin[row], *stretch.ball[sample].T)
        )
        return cls(
            begin,
            spans.resting,
            Field.of(model, angle, rate),
            time,
            np.stack((x, y), axis=-1),
            np.sqrt(count).reshape(-1, bins, 1) / sigma,
        )

    def take(self, which: Mask) -> Windows:
        """Some of the windows."""
        field = Field(*(getattr(self.field, item.name)[..., which] for item in fields(Field)))
        return Windows(
            self.begin[which],
            self.resting[which],
            field,
            self.time[which],
            self.ball[which],
            self.weight[which],
        )

    @classmethod
    def join(cls, parts: Sequence[Windows]) -> Windows:
        """All windows of several stretches."""
        field = Field(
            *(
                np.concatenate([getattr(part.field, item.name) for part in parts], axis=-1)
                for item in fields(Field)
            )
        )
        rest = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in ("begin", "resting", "time", "ball", "weight")
        }
        return cls(field=field, **rest)

    @property
    def size(self) -> Array:
        """Number of values in each window, at least 1, shape (W,)."""
        return np.asarray(np.maximum((self.weight > 0).sum(axis=(1, 2)), 1))

    def seen(self, places: Array, speeds: Array, delay: Array) -> tuple[Array, Array]:
        """What the screen would have reported, with its rate, both shape (C, W, B, 2).

        Cubic Hermite interpolation of a replay.

        Args:
            places: Positions in m, shape (N, 2, C, W).
            speeds: Velocities in m/s, same shape.
            delay: Seconds, shape (C, 1).
        """
        steps, _, candidates, windows = places.shape
        at = np.maximum(self.time - delay[..., None], 0.0) / STEP
        low = np.minimum(at.astype(int), steps - 2)
        s = (at - low)[..., None]
        c, w = np.ogrid[:candidates, :windows]
        index = (low, slice(None), c[..., None], w[..., None])
        after = (low + 1, *index[1:])
        p0, rise = places[index], places[after] - places[index]
        v0, v1 = STEP * speeds[index], STEP * speeds[after]
        square, cube = 3 * rise - 2 * v0 - v1, v0 + v1 - 2 * rise
        place = p0 + s * (v0 + s * (square + s * cube))
        return place, (v0 + s * (2 * square + 3 * s * cube)) / STEP
