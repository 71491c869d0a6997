"""What the real sensors make of the truth: dead time, frames, grids, counts and noise."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from controllers.arrays import Array, Mask
from twin.hal.interface import SCREEN, Touch


class Noise:
    """White Gaussian noise of N rigs, held for a number of control periods.

    Each rig draws from its own stream, so its noise does not depend on how many rigs run beside it.

    Args:
        variance: One variance a channel.
        seeds: One seed sequence a rig.
        hold: Control periods for which a draw is held.
    """

    BLOCK = 256

    def __init__(
        self,
        variance: Sequence[float] | Array,
        seeds: Sequence[np.random.SeedSequence],
        hold: int = 1,
    ) -> None:
        self._scale = np.sqrt(np.asarray(variance, dtype=float))
        self._streams = [np.random.default_rng(seed) for seed in seeds]
        self._hold = hold
        self.silent = not self._scale.any()
        """Whether every variance is zero."""
        self._block = np.empty((0, len(seeds), len(variance)))
        self._tick = 0

    def draw(self) -> Array:
        """The noise of the next control period, shape (N, channels)."""
        index = (self._tick // self._hold) % self.BLOCK
        if index == 0 and self._tick % self._hold == 0:
            shape = (self.BLOCK, len(self._scale))
            self._block = np.empty((self.BLOCK, len(self._streams), len(self._scale)))
            for rig, stream in enumerate(self._streams):
                self._block[:, rig] = stream.standard_normal(shape)
            self._block *= self._scale
        self._tick += 1
        drawn: Array = self._block[index]
        return drawn


@dataclass(frozen=True, kw_only=True)
class TouchModel:
    """A touch screen's imperfections; zero switches each off.

    Attributes:
        dead_time: Seconds from a touch to its arrival.
        frame_rate: Frames a second; 0 for a fresh sample every control period.
        grid: Positions the screen tells apart along each side.
        variance: Noise variance of x and y in m^2.
        spread: Standard deviation in s of the dead time from sample to sample.
        rotation: Angle in rad by which the screen is mounted turned about the plate's normal.
    """

    dead_time: float = 0.042
    frame_rate: float = 0.0
    grid: int = 4096
    variance: tuple[float, float] = (0.0, 0.0)
    spread: float = 0.0
    rotation: float = 0.0


class SimulatedScreen:
    """A touch screen looking at N simulated balls, sampled once a control period.

    Args:
        model: The imperfections.
        period: Control period in s.
        seeds: One seed sequence a rig.
        hold: Control periods for which a noise draw is held.
    """

    def __init__(
        self,
        model: TouchModel,
        period: float,
        seeds: Sequence[np.random.SeedSequence],
        hold: int = 1,
    ) -> None:
        self.model = model
        self._period = period
        self._noise = Noise(model.variance, [s.spawn(1)[0] for s in seeds], hold)
        self._frame = 1 / model.frame_rate if model.frame_rate > 0 else 0.0
        phase = [np.random.default_rng(s.spawn(1)[0]).random() for s in seeds]
        self._phase = np.array(phase) * self._frame
        self._delay = model.dead_time / period
        # As far back as is kept: a sample may be late by four standard deviations at most.
        self._latest = model.dead_time + 4 * model.spread
        self._length = 2 + math.ceil((self._latest + self._frame) / period)
        self._pitch = np.divide(SCREEN, model.grid) if model.grid else np.zeros(2)
        self._rows = np.arange(len(seeds))
        self._fresh = np.zeros(len(seeds))
        # Streams of their own, beside those spawned: with and without spread, all else is the same.
        apart = [np.random.SeedSequence(s.entropy, spawn_key=(*s.spawn_key, 1000)) for s in seeds]
        self._spread = Noise((model.spread**2,), apart, hold)
        self._late = np.full(len(seeds), model.dead_time)
        self._shown = np.full(len(seeds), np.nan)
        cos, sin = math.cos(model.rotation), math.sin(model.rotation)
        self._turn = np.array([[cos, -sin], [sin, cos]]) if model.rotation else None
        self._tick = -1

    def see(self, position: Array, touching: Mask) -> None:
        """Take in the true ball positions (N, 2) of a new control period."""
        if self._tick < 0:
            self._past = np.tile(position, (self._length, 1, 1))
            self._felt = np.tile(touching, (self._length, 1))
        self._tick += 1
        slot = self._tick % self._length
        self._past[slot] = position
        self._felt[slot] = touching

    def read(self) -> Touch:
        """The newest sample that has arrived."""
        if self._frame:
            position, touched, age = self._newest_frame()
        elif self._spread.silent:
            position, touched = self._look_back(self._delay)
            age = self._fresh
        else:
            position, touched = self._look_back_each(self._dead_time())
            age = self._fresh
        if self._turn is not None:
            position = position @ self._turn
        if not self._noise.silent:
            position = position + self._noise.draw()
        if self.model.grid:
            position = np.rint(position / self._pitch) * self._pitch
        return Touch(position, age, touched)

    def _look_back(self, periods: float) -> tuple[Array, Mask]:
        """Ball at a common number of periods ago, between two samples by a straight line."""
        whole = math.floor(periods)
        share = periods - whole
        newer = (self._tick - whole) % self._length
        if share < 1e-9:
            return self._past[newer].copy(), self._felt[newer]
        older = (newer - 1) % self._length
        return (1 - share) * self._past[newer] + share * self._past[older], self._felt[newer]

    def _dead_time(self) -> Array:
        """Each rig's dead time of a new sample, s, shape (N,)."""
        drawn = self.model.dead_time + self._spread.draw()[:, 0]
        limited: Array = np.minimum(np.maximum(drawn, 0.0), self._latest)
        return limited

    def _look_back_each(self, time: Array) -> tuple[Array, Mask]:
        """Ball at each rig's own time in s ago, shape (N,)."""
        back = time / self._period
        whole = np.floor(back).astype(int)
        share = (back - whole)[:, None]
        newer = (self._tick - whole) % self._length
        older = (newer - 1) % self._length
        position = (1 - share) * self._past[newer, self._rows] + share * self._past[
            older, self._rows
        ]
        return position, self._felt[newer, self._rows]

    def _newest_frame(self) -> tuple[Array, Mask, Array]:
        """Frames arrive on their clock; how old what they show is may spread from one to next."""
        lag = self._tick * self._period - self.model.dead_time - self._phase
        frame = np.floor(lag / self._frame)
        age = lag - frame * self._frame
        if not self._spread.silent:
            self._late = np.where(frame != self._shown, self._dead_time(), self._late)
            self._shown = frame
        position, touched = self._look_back_each(self._late + age)
        return position, touched, age


@dataclass(frozen=True, kw_only=True)
class EncoderModel:
    """The plate encoders' imperfections; zero switches each off.

    Attributes:
        counts: Counts a revolution: 4096 pulses with fourfold decoding.
        variance: Noise variance of phi and theta in rad^2.
    """

    counts: int = 16384
    variance: tuple[float, float] = (0.0, 0.0)


class SimulatedEncoders:
    """Two incremental encoders on N simulated plates.

    Args:
        model: The imperfections.
        seeds: One seed sequence a rig.
        hold: Control periods for which a noise draw is held.
    """

    def __init__(
        self, model: EncoderModel, seeds: Sequence[np.random.SeedSequence], hold: int = 1
    ) -> None:
        self._noise = Noise(model.variance, [s.spawn(1)[0] for s in seeds], hold)
        self._count = 2 * math.pi / model.counts if model.counts else 0.0

    def read(self, plate: Array) -> Array:
        """Measured plate angles in rad for the true ones, both (N, 2)."""
        if not self._noise.silent:
            plate = plate + self._noise.draw()
        if self._count:
            plate = np.rint(plate / self._count) * self._count
        return plate
