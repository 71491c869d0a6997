"""A reference sampled in advance, slice by slice, with its jumps spread."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from controllers.arrays import Array, Mask
from controllers.feasible_path import PATH_SHAPING, FeasiblePath, PathShaping
from controllers.interfaces import Reference


@dataclass(frozen=True, kw_only=True)
class Slicing:
    """How a trajectory is planned slice by slice.

    Attributes:
        periods: Control periods of a slice: few, so that planning one takes little time.
        early_periods: Control periods before a slice begins in which its parts, at most as many,
            are computed, one in each.
    """

    periods: int = 25
    early_periods: int = 4


@dataclass(frozen=True, kw_only=True)
class JumpSpreading:
    """Criterion of a jump of a reference, and the length to which its time refers.

    Attributes:
        min_jump_m: Distance in m from one period to the next, beyond what the speed covers, above
            which it is a jump.
        reference_jump_m: Length in m of a jump that is spread over the law's time ``spread``.
    """

    min_jump_m: float = 2e-3
    reference_jump_m: float = 0.15


SLICING = Slicing()
JUMP_SPREADING = JumpSpreading()


class Slices(ABC):
    """Trajectory buffer of one run: planned in slices, sampled per tick.

    The next slice is computed in parts, one in each of the last ticks before it is due, so that no
    tick takes long; where the preview is short, all at once when it is due.

    Args:
        preview: The path ahead; a slice has as many ticks as the preview advances.
        period: Control period in s.
    """

    _next: Any
    """The next slice, once its last part is computed."""

    def __init__(self, preview: Preview, period: float) -> None:
        self._preview, self._period = preview, period
        self._first, self._made = preview.first - preview.count, 0
        self._turn()

    def _tick(self, t: float, reference: Reference | None = None) -> int:
        """Index of a time in s within its slice; times of successive calls must not decrease."""
        count = self._preview.count
        self._preview.reference = reference or self._preview.reference
        tick = round(t / self._period) - self._first
        while tick >= count:
            self._turn()
            tick -= count
        due = tick - count + self._preview.early + 1
        if self._preview.early and due > 0:
            self._make(self._parts()[:due])
        return tick

    def _turn(self) -> None:
        """Make the next slice the present one."""
        self._make(self._parts())
        self._planned, self._made = self._next, 0
        self._first += self._preview.count

    def _make(self, parts: Sequence[Callable[[], None]]) -> None:
        for part in parts[self._made :]:
            part()
            self._made += 1

    @abstractmethod
    def _parts(self) -> Sequence[Callable[[], None]]:
        """The computations of the next slice, in their order."""


class _Jump(NamedTuple):
    """A jump that is spread.

    Attributes:
        time: Time of the jump in s.
        way: Displacement in m, shape (..., 2).
        duration: Time in s over which it is spread, shape (..., 1).
    """

    time: float
    way: Array
    duration: Array


class Preview:
    """Position, velocity and acceleration of a reference over a window that moves with time.

    A jump of the reference is replaced by a smooth motion after it; its duration grows with the
    root of its length. The distance of the ball from the reference at the start is treated alike.

    Args:
        reference: The path.
        start: Position of the ball at the start, m, shape (..., 2).
        period: Control period in s.
        horizon: Time in s by which the reference is sampled in advance; 0 for none.
        spread: Time in s over which a jump of ``jumps.reference_jump_m`` is spread; 0 leaves jumps
            as they are.
        limits: Limits of acceleration, m/s^2, and jerk, m/s^3, along either axis; None for none.
        moving: Velocity, m/s, and acceleration, m/s^2, of the ball at the start, (2, ..., 2); at
            rest by default. A path that keeps to limits begins with them.
        first: Control periods from time 0 to the start.
        slicing: Length of a slice, and when it is computed.
        jumps: What counts as a jump.
        shaping: How a path is made one within the limits.
    """

    def __init__(
        self,
        reference: Reference,
        start: Array,
        period: float,
        horizon: float,
        spread: float,
        limits: tuple[float, float] | None = None,
        moving: Array | None = None,
        first: int = 0,
        slicing: Slicing = SLICING,
        jumps: JumpSpreading = JUMP_SPREADING,
        shaping: PathShaping = PATH_SHAPING,
    ) -> None:
        self._period, self._spread, self._spreading = period, spread, jumps
        self.first = first
        """Control periods from time 0 to the start."""
        self.reference = reference
        """The path; a new one is sampled from the next slice on."""
        self._sampled_reference: Any = None
        ahead = math.floor(horizon / period + 1e-9)
        early = slicing.early_periods
        self.early = early if ahead >= slicing.periods + early else 0
        """Ticks before a slice begins at which it is computed; the window is shorter by them."""
        self.length = ahead + 1 - self.early
        """Ticks of the window."""
        self.count = min(slicing.periods, self.length)
        """Ticks of a slice."""
        self._known = self._begun = first
        self._feasible: FeasiblePath | None = None
        self._further = 0
        if limits is not None and self.early > 0:
            self._feasible = FeasiblePath(limits, period, self.count, shaping)
            self._further = math.ceil(shaping.horizon_s / period)
        self._sampled: Array = np.empty((3, 0, *start.shape))
        self._kept: Mask = np.empty((0, *start.shape[:-1]), bool)
        """True where a sampled point, and the step to it, keep to the limits."""
        self._made = self._sampled
        self.window: Array = self._sampled
        """Position, velocity, acceleration, in m and s, shape (3, length, ..., 2): the window that
        begins with the present slice and ends the horizon after its computation."""
        self._jumps: list[_Jump] = []
        self._last = np.stack((start, 0 * start))
        velocity, acceleration = np.zeros((2, *start.shape)) if moving is None else moving
        self._before = np.stack((start - period * velocity, velocity, acceleration))
        """Position, velocity, acceleration of the ball a period before the start, (3, ..., 2)."""

    def sample(self) -> None:
        """Sample one more slice of the reference, its jumps spread; all of a new reference."""
        count = self.count
        original = getattr(self.reference, "original", self.reference)
        if self._known > self.first and original != self._sampled_reference:
            self._forget()
        self._sampled_reference = original
        if self._known == self._begun:
            whole = -(-self.length // count) * count + self._further
            count = whole if self._feasible is not None else self.length
        times = (self._known + np.arange(count)) * self._period
        given = self.reference(times)[:3]
        rigs = self.window.shape[2:-1]
        r = np.empty((3, count, *rigs, 2))
        r[...] = given.reshape(3, count, *given.shape[2:-1] or [1] * len(rigs), 2)
        if self._spread:
            self._spread_jumps(r, times)
        if self._feasible is not None:
            before = self._sampled[:, -1:] if self._sampled.shape[1] else r[:, :1]
            kept = self._feasible.within_each(np.concatenate((before, r), axis=1))
            self._kept = np.concatenate((self._kept, kept))
        self._sampled = np.concatenate((self._sampled, r), axis=1)
        self._known += count

    def _forget(self) -> None:
        """Drop all that was sampled and planned but the present slice."""
        self._known = self._begun
        self._sampled, self._made = self._sampled[:, :0], self._made[:, : self.count]
        self._kept = self._kept[:0]
        self._last, self._jumps = self._made[:2, -1], []
        if self._feasible is not None:
            self._feasible.restart()

    def able(self, path: Array) -> bool:
        """Whether a path from the start on keeps to the limits, in all rigs.

        Args:
            path: Position, velocity, acceleration, shape (3, K, ..., 2).
        """
        if self._feasible is None:
            return True
        return bool(self._feasible.within(np.concatenate((self._before[:, None], path), 1)).all())

    def along(self, count: int) -> Array:
        """The path of the first control periods after the start, shape (3, count, ..., 2)."""
        path = []
        for _ in range(0, count, self.count):
            self.sample()
            self.advance()
            path.append(self.window[:, : self.count])
        return np.concatenate(path, axis=1)[:, :count]

    def advance(self) -> None:
        """Move the window by a slice, along a path that plate and ball can follow."""
        previous, made = self._made[:, : self.count], self._made[:, self.count :]
        while made.shape[1] < self.length:
            slice_ = self._sampled[:, : self.count]
            if self._feasible is not None:
                last = made if made.shape[1] else previous
                before = last[:, -1] if last.shape[1] else self._before
                slice_ = self._feasible.follow(before, self._sampled, self._kept)
                self._kept = self._kept[self.count :]
            made = np.concatenate((made, slice_), axis=1)
            self._sampled = self._sampled[:, self.count :]
        self._made, self.window = made, made[:, : self.length]
        self._begun += self.count

    def _spread_jumps(self, r: Array, times: Array) -> None:
        """Spread the jumps of the samples taken last, shape (3, K, ..., 2), in place."""
        T, count, begin = self._period, len(times), int(self._known == self.first)
        position, velocity = np.concatenate((self._last[:, None], r[:2]), axis=1)
        self._last = r[:2, -1].copy()
        way = position[1:] - position[:-1]
        way[begin:] -= T / 2 * (velocity[begin + 1 :] + velocity[begin:-1])
        spreading = self._spreading
        far = (np.abs(way) > spreading.min_jump_m).any(axis=-1, keepdims=True)
        if far.any():
            way = np.where(far, way, 0.0)  # a rig without a jump has none in any batch
            for i in np.flatnonzero(far.reshape(count, -1).any(axis=1)).tolist():
                length = np.hypot(way[i, ..., :1], way[i, ..., 1:])
                share = np.sqrt(length / spreading.reference_jump_m)
                duration = np.maximum(self._spread * share, T)
                self._jumps.append(_Jump(float(times[i]), way[i], duration))
        for jump in self._jumps:
            r += _remaining_jump(times - jump.time, jump)
        ended = times[-1]
        self._jumps = [each for each in self._jumps if each.time + each.duration.max() > ended]


def _remaining_jump(time: Array, jump: _Jump) -> Array:
    """The remaining part of a spread jump: 0 before it, then from the whole jump to 0.

    Args:
        time: Time since the jump, s, shape (K,).
        jump: The jump.

    Returns:
        Position, velocity, acceleration, shape (3, K, ..., 2).
    """
    time = time.reshape(-1, *[1] * jump.way.ndim)
    t = np.minimum(np.maximum(time / jump.duration, 0.0), 1.0)
    share = np.stack(
        (
            1 - t**3 * (10 - 15 * t + 6 * t * t),
            -30 * t * t * (1 - t) ** 2 / jump.duration,
            -60 * t * (1 - t) * (1 - 2 * t) / jump.duration**2,
        )
    )
    return np.where(time >= 0, -share * jump.way, 0.0)
