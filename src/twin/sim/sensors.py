"""Sensors of a simulated rig: noise, plate encoders, touch screen."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from controllers.arrays import Array, Mask, Number, column, constant, put, some
from twin.base.followers import FREE, GIVEN, Followers
from twin.base.settings import Unit, jump, ramp, setting
from twin.hal.interface import SCREEN_SIZE_M, Touch

Rigs = NDArray[np.integer]
"""Numbers of some rigs of a batch, shape (k,)."""
HeldPeriods = int | NDArray[np.integer]
"""A number of control periods for all rigs, or one per rig, shape (N,)."""


class Noise:
    """White Gaussian noise of N rigs, held for a number of control periods.

    Each rig draws from its own stream, so its noise does not depend on the number of rigs.

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
        """Have a new variance from now on; only the scale of the drawn numbers changes.

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
            return self._block[index]
        for rig in np.flatnonzero((index == 0) & (tick % self._hold == 0)).tolist():
            self._fill(rig)
        return self._block[index, self._rows]

    def adopt(self, rigs: Rigs, other: Noise) -> None:
        """Let some rigs go on with the streams of ``other``, from the present place of each.

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


def periods(time: Array, period: float) -> tuple[NDArray[np.integer], Array]:
    """Whole periods of times in s, shape (N,), and the share of one that is left, (N, 1)."""
    back = time / period
    whole = np.floor(back).astype(int)
    share = (back - whole)[:, None]
    # rounding is not a share of a period
    share[share < 1e-9] = 0.0
    return whole, share


ENCODER_COUNTS_PER_TURN = 245760
"""Counts of a plate encoder per turn."""


ENCODER_FOLLOWERS = Followers(
    mechanism=GIVEN,
    equations=GIVEN,
    source=FREE,
    identify="takes the samples as recorded and estimates their noise",
    symbols="measure y without errors",
)


@dataclass(frozen=True, kw_only=True)
class EncoderModel:
    """The plate encoders' imperfections; zero switches each off.

    Fields may be arrays with one entry per rig.

    Attributes:
        counts: Counts per revolution: 4096 pulses, fourfold decoding, and 15 more of each, for
            every plate angle printed in Tables 9.2 to 9.9 is a multiple of 360/245760 deg.
        variance: Noise variance of phi and theta in rad^2; Table B.1.
    """

    counts: Number = setting(
        "sensors.encoders.counts",
        ENCODER_COUNTS_PER_TURN,
        followed_by=ENCODER_FOLLOWERS.by("encoders", 0),
        ge=0,
    )
    variance: tuple[float, float] | Array = ramp(
        "sensors.encoders.variance",
        (1.5433e-10, 1.1580e-10),
        followed_by=ENCODER_FOLLOWERS.by("encoders", (0.0, 0.0)),
        otherwise=(0.0, 0.0),
        ge=0,
    )


class SimulatedEncoders:
    """Two incremental encoders on N simulated plates.

    Args:
        model: The imperfections.
        seeds: One seed sequence per rig.
        hold: Control periods for which a noise draw is held.
    """

    def __init__(
        self, model: EncoderModel, seeds: Sequence[np.random.SeedSequence], hold: HeldPeriods = 1
    ) -> None:
        self._noise = Noise(model.variance, [s.spawn(1)[0] for s in seeds], hold)
        counts = np.asarray(column(model.counts), float)
        self._exact = counts == 0
        self._counting, self._mixed = bool(counts.any()), bool(self._exact.any())
        self._count = constant(2 * math.pi / np.where(self._exact, 1.0, counts))

    def change(self, model: EncoderModel) -> None:
        """Have the noise of a new model from now on."""
        self._noise.change(model.variance)

    def adopt(self, rigs: Rigs, other: SimulatedEncoders) -> None:
        """Let some rigs go on with the noise of others that count alike."""
        self._noise.adopt(rigs, other._noise)

    def read(self, plate: Array) -> Array:
        """Measured plate angles in rad for the true ones, both (N, 2)."""
        if not self._noise.silent:
            plate = plate + self._noise.draw()
        if self._counting:
            counted = np.rint(plate / self._count) * self._count
            plate = np.where(self._exact, plate, counted) if self._mixed else counted
        return plate


SCREEN_FOLLOWERS = ENCODER_FOLLOWERS
FRAME_FOLLOWERS = SCREEN_FOLLOWERS.by("frames")
DELAY_FOLLOWERS = replace(SCREEN_FOLLOWERS, identify=FREE, symbols=GIVEN)
SIZE_FOLLOWERS = replace(
    SCREEN_FOLLOWERS,
    explain="compares runs of one build of the rig",
    identify="fits samples from the screen, however large it is",
    symbols="bound the ball by the operating area",
)


@dataclass(frozen=True, kw_only=True)
class TouchModel:
    """A touch screen's imperfections; zero switches each off.

    Fields may be arrays with one entry per rig.

    Attributes:
        size: Sides of the screen along x and y, in m; a ball beyond them has left the plate.
        dead_time: Time from a touch to its arrival, in s.
        frame_rate: Frames a second, in Hz; 0 for a fresh sample every control period.
        grid: Number of positions that the screen resolves along each of its sides.
        variance: Noise variance of x and y in m^2; Table B.1.
        spread: Standard deviation in s of the dead time from sample to sample; Table 7.2 has
            0.00187.
        jitter: Standard deviation in s of when a frame is taken, and so arrives, about its clock;
            at most half a frame either way. Without frames it does nothing.
        lost: Share of the frames that never arrive, each by itself. Without frames it does nothing.
        hidden: Rectangle of the plate in which the ball is not seen: minimum x and y, maximum
            x and y, m; none if the maxima are not larger.
        rotation: Angle in rad by which the screen is mounted turned about the plate's normal.
    """

    size: tuple[float, float] | Array = setting(
        "plant.size", SCREEN_SIZE_M, followed_by=SIZE_FOLLOWERS, ge=0.05, le=5
    )
    dead_time: Number = ramp(
        "sensors.touch.dead_time",
        0.042,
        followed_by=DELAY_FOLLOWERS.by("deadtime", 0.0),
        ge=0,
        le=1,
    )
    spread: Number = setting(
        "sensors.touch.dead_time_spread",
        0.0,
        followed_by=SCREEN_FOLLOWERS.by("spread"),
        ge=0,
        le=0.1,
    )
    jitter: Number = ramp("sensors.touch.jitter", 0.0, followed_by=FRAME_FOLLOWERS, ge=0, le=0.1)
    lost: Number = ramp("sensors.touch.lost", 0.0, followed_by=FRAME_FOLLOWERS, ge=0, le=0.9)
    hidden: tuple[float, float, float, float] | Array = jump(
        "sensors.touch.hidden", (0.0,) * 4, followed_by=FRAME_FOLLOWERS
    )
    rotation: Number = ramp(
        "sensors.touch.rotation_deg",
        0.0,
        Unit.DEG,
        followed_by=SCREEN_FOLLOWERS.by("coupling"),
        ge=-45,
        le=45,
    )
    frame_rate: Number = jump(
        "sensors.touch.frame_rate", 0.0, followed_by=FRAME_FOLLOWERS, ge=0, le=10_000
    )
    grid: Number = setting(
        "sensors.touch.grid", 4096, followed_by=SCREEN_FOLLOWERS.by("touch", 0), ge=0
    )
    variance: tuple[float, float] | Array = ramp(
        "sensors.touch.variance",
        (7.2538e-7, 1.7721e-7),
        followed_by=SCREEN_FOLLOWERS.by("touch", (0.0, 0.0)),
        otherwise=(0.0, 0.0),
        ge=0,
    )


class SimulatedScreen:
    """A touch screen looking at N simulated balls, sampled once per control period.

    Noise and grid belong to a frame: between two frames the screen reports the same position.

    Args:
        model: The imperfections.
        period: Control period in s.
        seeds: One seed sequence per rig.
        hold: Control periods for which a noise draw is held.
    """

    def __init__(
        self,
        model: TouchModel,
        period: float,
        seeds: Sequence[np.random.SeedSequence],
        hold: HeldPeriods = 1,
    ) -> None:
        rigs = len(seeds)

        def each(value: Number) -> Array:
            return np.broadcast_to(np.asarray(value, float), (rigs,))

        self._period = period
        self._model = model
        self._noise = Noise(model.variance, [s.spawn(1)[0] for s in seeds], hold)
        self._offset = np.array([np.random.default_rng(s.spawn(1)[0]).random() for s in seeds])
        # Streams of their own, apart from the spawned ones: the spread changes nothing else.
        apart = [np.random.SeedSequence(s.entropy, spawn_key=(*s.spawn_key, 1000)) for s in seeds]
        self._spread = Noise(each(model.spread)[:, None] ** 2, apart, hold)
        clocks = [np.random.SeedSequence(s.entropy, spawn_key=(*s.spawn_key, 1001)) for s in seeds]
        self._clock = Noise(np.ones(2), clocks)
        """Of each frame when it is taken, and whether it is lost; drawn in every period."""
        self._equip(model)
        self._wait(each(model.dead_time), each(model.spread))
        self._begun = np.zeros(rigs, int)
        self._rows = np.arange(rigs)
        self._fresh = np.zeros(rigs)
        self._frame_times = np.full((4, rigs), np.nan)
        """Number of the newest frame, when it and the one before arrive, and the one shown did."""
        self._tick = -1
        self._past: Array = np.empty((0, rigs, 2))
        self._felt: Mask = np.empty((0, rigs), bool)

    def _equip(self, model: TouchModel) -> None:
        """Have the frames, the grid and the rotation of a model."""
        rate, grid, rotation = (
            np.broadcast_to(np.asarray(value, float), self._offset.shape)
            for value in (model.frame_rate, model.grid, model.rotation)
        )
        self._framed = rate > 0
        self._frames = bool(self._framed.any())
        self._frame = np.divide(1.0, rate, out=np.zeros(len(rate)), where=self._framed)
        self._phase = self._offset * self._frame
        grid = grid[:, None]
        self._continuous = grid == 0
        self._gridded, self._mixed = bool(grid.any()), bool(self._continuous.any())
        self._pitch = np.divide(model.size, np.where(self._continuous, 1.0, grid))
        self._turn = (np.cos(rotation), np.sin(rotation)) if rotation.any() else None
        self._out_of_sight = np.split(np.asarray(model.hidden, float), 2, axis=-1)
        self._hides = bool((self._out_of_sight[1] > self._out_of_sight[0]).all(axis=-1).any())
        self._jitter = np.broadcast_to(np.asarray(model.jitter, float), rate.shape)
        self._early = np.where(self._jitter > 0, self._frame / 2, 0.0)
        lost = np.broadcast_to(np.asarray(model.lost, float), rate.shape)
        # loading scipy's part takes longer than a second of a run
        self._lost = scipy.special.ndtri(lost) if lost.any() else np.full(rate.shape, -np.inf)

    def _wait(self, delay: Array, spread: Array) -> None:
        """Let samples take dead times in s, shape (N,), and a spread of them."""
        self._delay = delay
        # As far back as is kept: a sample may be late by four standard deviations at most.
        self._latest = delay + 4 * spread
        self._own = 2 + np.ceil((self._latest + self._frame) / self._period).astype(int)
        self._length = int(self._own.max())
        whole, self._share = periods(delay, self._period)
        # one dead time for all: their samples lie side by side
        self._whole = int(whole[0]) if len(set(delay.tolist())) == 1 else whole

    def change(self, model: TouchModel) -> None:
        """Have the imperfections of a new model from now on.

        Where samples take longer than before, the oldest that is kept, at most two periods older
        than the one shown, stays until the next one has arrived.
        """
        self._noise.change(model.variance)
        before, self._model = self._model, model
        waits = (before.dead_time, before.spread, before.frame_rate)
        self._spread.change(np.broadcast_to(model.spread, self._offset.shape)[:, None] ** 2)
        self._equip(model)
        if all(map(np.array_equal, (model.dead_time, model.spread, model.frame_rate), waits)):
            return
        delay, spread = np.broadcast_arrays(model.dead_time, model.spread, self._frame)[:2]
        kept, own = self._length, self._own  # each rig has the values it would have alone
        self._wait(np.asarray(delay, float), np.asarray(spread, float))
        ago = np.arange(self._length)
        # which of the rows that were kept stands where in the new ring
        order = np.empty((self._length, len(own)), int)
        order[(self._tick - ago) % self._length] = (
            self._tick - np.minimum(ago[:, None], own - 1)
        ) % kept
        self._past, self._felt = self._past[order, self._rows], self._felt[order, self._rows]

    def adopt(self, rigs: Rigs, other: SimulatedScreen) -> None:
        """Let some rigs go on as others that have just begun and are equipped alike."""
        self._noise.adopt(rigs, other._noise)
        self._spread.adopt(rigs, other._spread)
        self._clock.adopt(rigs, other._clock)
        self._offset = put(self._offset, rigs, other._offset)
        self._phase = self._offset * self._frame
        self._begun[rigs] = self._tick
        self._frame_times[:, rigs] = other._frame_times
        # they have been where they are all the time
        self._past[:, rigs], self._felt[:, rigs] = other._past[0], other._felt[0]
        for mine, theirs in zip(self._held, other._held, strict=True):
            mine[rigs] = theirs

    def see(self, position: Array, touching: Mask) -> None:
        """Take in the true ball positions (N, 2) of a new control period.

        A ball out of sight is where it was seen last, or began.
        """
        if self._hides:
            low, high = self._out_of_sight
            hidden = np.all((position > low) & (position < high), axis=-1)
            touching = touching & ~hidden
            if self._tick >= 0:
                last = self._past[self._tick % self._length]
                position = np.where(hidden[:, None], last, position)
        if self._tick < 0:
            self._past = np.tile(position, (self._length, 1, 1))
            self._felt = np.tile(touching, (self._length, 1))
            self._held = np.array(position), np.array(touching)
        self._tick += 1
        slot = self._tick % self._length
        self._past[slot] = position
        self._felt[slot] = touching

    def forget(self, position: Array) -> None:
        """Take the balls to have been at positions (N, 2) in m all the time."""
        self._past[:] = position
        self._felt[:] = True
        self._held = np.array(position), np.ones(len(position), bool)

    def read(self) -> Touch:
        """The newest sample that has arrived."""
        if self._frames:
            return self._newest_frame()
        if self._spread.silent:
            position, touched = self._look_back(self._whole, self._share)
        else:
            position, touched = self._look_back(*periods(self._drawn_delay(), self._period))
        return Touch(self._imperfect(position), self._fresh, touched)

    def _newest_frame(self) -> Touch:
        """Frames arrive on their clock; how old what they show is may spread from one to next."""
        lag = (self._tick - self._begun) * self._period - self._delay - self._phase
        length = np.where(self._framed, self._frame, self._period)
        newest, due, before, shown = self._frame_times
        frame = np.floor((lag + self._early) / length)
        drawn, first = self._clock.draw().T, np.isnan(newest)
        come = (frame != newest) & (first | (drawn[1] >= self._lost))
        shift = np.clip(self._jitter * drawn[0], -self._early, self._early)
        before = np.where(come, due, before)
        due = np.where(come, frame * length + np.where(first, -self._early, shift), due)
        # of frames that come as they like the newest may be on its way
        last = np.where((due <= lag) | (self._early == 0), due, before)
        age = np.where(self._framed, lag - last, 0.0)
        new = ~self._framed | (last != shown)
        self._frame_times = np.array((frame, due, before, last))
        late = self._delay if self._spread.silent else self._drawn_delay()
        position, touched = self._look_back(*periods(late + age, self._period))
        position = self._imperfect(position)
        before, felt = self._held
        self._held = np.where(new[:, None], position, before), np.where(new, touched, felt)
        return Touch(self._held[0], age, self._held[1])

    def _look_back(self, whole: int | NDArray[np.integer], share: Array) -> tuple[Array, Mask]:
        """Ball so many periods ago, between two samples by a straight line."""
        newer = (self._tick - whole) % self._length
        one_for_all = isinstance(newer, int)
        at: Any = newer if one_for_all else (newer, self._rows)
        after, felt = self._past[at], self._felt[at]
        if not some(share):
            return after.copy(), felt
        older = (newer - 1) % self._length
        before = self._past[older if one_for_all else (older, self._rows)]
        return (1 - share) * after + share * before, felt

    def _drawn_delay(self) -> Array:
        """Each rig's dead time of a new sample, s, shape (N,)."""
        drawn = self._delay + self._spread.draw()[:, 0]
        return np.minimum(np.maximum(drawn, 0.0), self._latest)

    def _imperfect(self, position: Array) -> Array:
        """Positions (N, 2) as the screen reports them: turned, noisy, on its grid."""
        if self._turn is not None:
            (cos, sin), (x, y) = self._turn, position.T
            position = np.stack((x * cos + y * sin, y * cos - x * sin), axis=-1)
        if not self._noise.silent:
            position = position + self._noise.draw()
        if self._gridded:
            on_grid = np.rint(position / self._pitch) * self._pitch
            position = np.where(self._continuous, position, on_grid) if self._mixed else on_grid
        return position
