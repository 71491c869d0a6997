"""White noise of N rigs, one random stream per rig."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controllers.arrays import Array

Rigs = NDArray[np.integer]
"""Numbers of some rigs of a batch, shape (k,)."""
HeldPeriods = int | NDArray[np.integer]
"""A number of control periods for all rigs, or one per rig, shape (N,)."""


class Noise:
    """White Gaussian noise of N rigs, held for a number of control periods.

    Each rig draws from its own stream, so its noise does not depend on how many rigs run beside it.

    Args:
        variance: One variance per channel, shape (channels,), or (N, channels).
        seeds: One seed sequence per rig.
        hold: Control periods for which a draw is held.
    """

    BLOCK = 256

    def __init__(
        self, variance: ArrayLike, seeds: Sequence[np.random.SeedSequence], hold: HeldPeriods = 1
    ) -> None:
        self._streams = [np.random.default_rng(seed) for seed in seeds]
        self._hold = hold
        self._rows = np.arange(len(seeds))
        shape = self.BLOCK, len(seeds), np.shape(variance)[-1]
        self._drawn, self._block = np.zeros(shape), np.zeros(shape)
        self._scale = np.zeros(shape[1:])
        self._tick = 0
        self.silent = True
        """Whether every variance is zero."""
        self.change(variance)

    def change(self, variance: ArrayLike) -> None:
        """Have another variance from now on; what is drawn differs by its scale alone.

        Args:
            variance: One per channel, shape (channels,), or (N, channels).
        """
        scale = np.broadcast_to(np.sqrt(np.asarray(variance, float)), self._block.shape[1:])
        if np.array_equal(scale, self._scale):
            return
        self._scale = scale
        self._block = self._drawn * scale
        self.silent = not scale.any()

    def draw(self) -> Array:
        """The noise of the next control period, shape (N, channels)."""
        index, tick = (self._tick // self._hold) % self.BLOCK, self._tick
        self._tick += 1
        if isinstance(self._hold, int):
            if index == 0 and tick % self._hold == 0:
                self._block = np.empty_like(self._block)  # who was given of the old one keeps it
                for rig in range(len(self._streams)):
                    self._fill(rig)
            drawn: Array = self._block[index]
            return drawn
        for rig in np.flatnonzero((index == 0) & (tick % self._hold == 0)).tolist():
            self._fill(rig)
        each: Array = self._block[index, self._rows]
        return each

    def adopt(self, rigs: Rigs, other: Noise) -> None:
        """Let some rigs go on with the streams of another noise, from where each of those is.

        Args:
            rigs: Which.
            other: The noise of as many rigs, held for the same number of control periods.
        """
        assert isinstance(self._hold, int)
        drawn, held = -(-self._tick // self._hold), self._tick % self._hold > 0
        taken, channels = -(-other._tick // self._hold), self._scale.shape[1]
        place = drawn % self.BLOCK
        for rig, stream in zip(rigs.tolist(), other._streams, strict=True):
            seed = stream.bit_generator.seed_seq
            assert isinstance(seed, np.random.SeedSequence)
            self._streams[rig] = again = np.random.default_rng(seed)
            past = again.standard_normal((taken, channels))
            if place:  # the rest of this block; a whole one is drawn when it begins
                self._drawn[place:, rig] = again.standard_normal((self.BLOCK - place, channels))
                self._block[place:, rig] = self._drawn[place:, rig] * self._scale[rig]
            if held and taken:
                self._drawn[place - 1, rig] = past[-1]
                self._block[place - 1, rig] = past[-1] * self._scale[rig]

    def _fill(self, rig: int) -> None:
        drawn = self._streams[rig].standard_normal((self.BLOCK, self._scale.shape[1]))
        self._drawn[:, rig] = drawn
        self._block[:, rig] = drawn * self._scale[rig]
