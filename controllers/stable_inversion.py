"""Laws about a motion of ball and plate that makes the ball follow a reference.

The reference is sampled in advance, slice by slice. Its jumps are spread, and it is replaced by the
nearest path that the plate can produce. The plate's motion is the stable inverse of a plant that
first moves the wrong way; friction is fed forward, and the feedback about the motion is
linear-quadratic.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, ClassVar, NamedTuple, Self

import numpy as np
import scipy
from annotated_types import Ge, Gt, Le

from controllers.arrays import (
    ARRAY_ARITHMETIC,
    Arithmetic,
    Array,
    Mask,
    NotNegative,
    Positive,
    arithmetic_of,
    components,
    numbers,
    square_of,
    together,
)
from controllers.ballplate import LONGEST_LAG, TILT_SIGN, BallPlate
from controllers.interfaces import Feedback, Law, Reference, algorithm_constants


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


@dataclass(frozen=True, kw_only=True)
class PathShaping:
    """How a path that the plate cannot produce is replaced by the nearest one that it can.

    Attributes:
        horizon_s: Time in s beyond the window over which the distance is minimised.
        pieces_per_slice: Pieces of constant jerk in a slice.
        iterations: Iterations of the method of multipliers in each slice.
        weight_m2: Weight of the bounds in the method, m^2.
        return_position_m: Distance in m from a path that can be followed, below which the plan
            follows it again, if speed and acceleration are as near.
        return_velocity_m_s: The same of the velocity, m/s.
        return_acceleration_m_s2: The same of the acceleration, m/s^2.
        min_difference_m: Distance in m above which the planned path differs from the desired one.
    """

    horizon_s: float = 1.2
    pieces_per_slice: int = 2
    iterations: int = 20
    weight_m2: float = 3e-3
    return_position_m: float = 1e-4
    return_velocity_m_s: float = 1e-3
    return_acceleration_m_s2: float = 2e-2
    min_difference_m: float = 1e-3

    @property
    def return_tolerances(self) -> tuple[float, float, float]:
        """Tolerances of position, velocity and acceleration, in m and s."""
        return self.return_position_m, self.return_velocity_m_s, self.return_acceleration_m_s2


@dataclass(frozen=True, kw_only=True)
class PushResponse:
    """Bounds of the error of eta that is fed back once the ball was pushed.

    Attributes:
        pushed_error_m: Error of eta in m above which the ball has been pushed: no start on a path
            has as much.
        max_growing_error_m: Largest error of eta in m that is fed back while it grows.
        max_error_m: Largest error of eta in m that is fed back while it shrinks.
    """

    pushed_error_m: float = 0.025
    max_growing_error_m: float = 0.01
    max_error_m: float = 0.05


SLICING = Slicing()
JUMP_SPREADING = JumpSpreading()
PATH_SHAPING = PathShaping()
PUSH_RESPONSE = PushResponse()


class DesiredMotion(NamedTuple):
    """The desired motion of ball and plate at one tick."""

    position: Array
    """Position of the ball in m, shape (..., 2)."""
    velocity: Array
    """Velocity of the ball in m/s, shape (..., 2)."""
    slope: Tilts
    """Tilt of the plate along x and y, (phi, -theta), in rad."""


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


class MotionPlan(Slices):
    """The motion for one run: the plate's by the stable, two-sided inverse of the ball's.

    Args:
        law: The law that plans it.
        x: State at the start, shape (..., 8).
        reference: Path of the ball.
        period: Control period in s.
    """

    def __init__(self, law: AboutMotion, x: Array, reference: Reference, period: float) -> None:
        self._k1 = law.model.k1
        ahead = law.ahead(x, reference, period)
        self._inverse = inverse(law.model, ahead, period)
        super().__init__(ahead, period)

    def at(self, t: float) -> DesiredMotion:
        """The desired motion at a time in s; times of successive calls must not decrease."""
        tick = self._tick(t)
        position, velocity, (angle, rate, acceleration) = self._planned
        slope = Tilts(angle[tick], rate[tick], acceleration[tick])
        return DesiredMotion(position[tick], velocity[tick], slope)

    def _parts(self) -> Sequence[Callable[[], None]]:
        return self._preview.sample, self._preview.advance, self._plan

    def _plan(self) -> None:
        count, (position, velocity, acceleration) = self._preview.count, self._preview.window
        slope = self._inverse.plan(acceleration / self._k1)
        self._next = DesiredMotion(position[:count], velocity[:count], slope)


def inverse(model: BallPlate, preview: Preview, period: float) -> TwoSided:
    """The inverse of a plant for the windows of a preview."""
    return TwoSided(math.sqrt(model.k1 / model.c2), period, preview.count, preview.length)


class Tilts(NamedTuple):
    """Slope of the plate and its two time derivatives, all of one shape."""

    angle: Array
    rate: Array
    acceleration: Array


class TwoSided:
    """The bounded solution a of a - a'' / Z^2 = w for a w that is known some time in advance.

    The ball's x'' = k1 phi - c2 phi'' has a zero in the right half plane at Z = sqrt(k1 / c2), so
    that the slope for a desired x'' = k1 w has a pole there; its bounded response precedes its
    cause:

        a = (p + q) / 2,    p' = Z (w - p) forward in time,    q' = Z (q - w) backward.

    Between two samples w is a straight line; beyond the last one known it stays as it is.

    Args:
        Z: Zero of the plant in rad/s.
        period: Time from one sample to the next, s.
        count: Samples of a slice.
        length: Samples of a window.
    """

    def __init__(self, Z: float, period: float, count: int, length: int) -> None:
        self.Z, self._count, self._period = Z, count, period
        step = Z * period
        decay = math.exp(-step)
        # weights of the two ends of a straight line, the nearer one first
        far = (1 - decay) / step - decay
        near = 1 - decay - far
        self.weights = decay, near, far
        """Weights of p or q one sample before, and of the nearer and farther end of the line."""
        forward, backward = np.zeros((count + 1, count + 1)), np.zeros((count, length))
        reach = length - count
        behind = decay ** np.arange(reach + 1)
        for k in range(count):
            forward[k + 1] = decay * forward[k]
            forward[k + 1, k : k + 2] += far, near
            backward[k, k : k + reach] += near * behind[:-1]
            backward[k, k + 1 : k + reach + 1] += far * behind[:-1]
            backward[k, k + reach] += behind[-1]
        self._forward, self._backward = forward, backward
        self._begun = decay ** np.arange(count + 1)[:, None]
        self._p: Array | None = None
        self.jerk: Array = np.empty(0)
        """Third derivative of a in the slice planned last, shape (count, ...)."""

    def plan(self, w: Array) -> Tilts:
        """Return a, a' and a'' of a slice, each (count, ...), from a window that begins with it.

        Every sample uses the same preview time, the one of the slice's last sample.

        Args:
            w: The window, shape (length, ..., axes).
        """
        count = self._count
        # every rig by itself, so that it gets the same bits in any batch
        rows = w.swapaxes(0, -2)
        here = rows[..., : count + 1, :]
        if len(w) == count:
            here = np.concatenate((here, rows[..., -1:, :]), axis=-2)
        begin = here[..., :1, :] if self._p is None else self._p
        p = self._forward @ here + self._begun * begin
        q = self._backward @ rows
        self._p = p[..., count:, :]
        change = (here[..., 1:, :] - here[..., :count, :]) / self._period
        p, here = p[..., :count, :], here[..., :count, :]
        a = (p + q) / 2
        slopes = a, self.Z * (q - p) / 2, self.Z**2 * (a - here)
        self.jerk = (self.Z**2 * (slopes[1] - change)).swapaxes(-2, 0)
        return Tilts(*(each.swapaxes(-2, 0) for each in slopes))


class FeasiblePath:
    """The path nearest to a desired one within limits of acceleration and jerk, slice by slice.

    The minimum mean square distance over a horizon, among paths with constant jerk over short
    pieces, from the end of the previous slice: a quadratic programme with bounds, by the method of
    multipliers (Boyd et al. 2011, "Distributed optimization and statistical learning via the
    alternating direction method of multipliers", 3.1), started from the previous slice's result.

    Args:
        limits: Limits of acceleration, m/s^2, and jerk, m/s^3, along either axis.
        period: Time from one sample to the next, s.
        count: Samples of a slice.
        shaping: Constants of the method.
    """

    def __init__(
        self,
        limits: tuple[float, float],
        period: float,
        count: int,
        shaping: PathShaping = PATH_SHAPING,
    ) -> None:
        self.count, self._limits, self._period = count, limits, period
        self._shaping, pieces = shaping, shaping.pieces_per_slice
        piece = count * period / pieces
        self.length = n = pieces * math.ceil(shaping.horizon_s / (count * period))
        """Number of pieces in the horizon."""
        self._places = np.arange(1, n + 1) * piece / period
        """Places of the ends of pieces among the samples; the last of the slice before is 0."""
        on, by = _integration_matrices(piece)
        state, push = np.eye(3), np.zeros((3, n))
        states, pushes = np.empty((n, 3, 3)), np.empty((n, 3, n))
        for k in range(n):
            state, push = on @ state, on @ push
            push[:, k] += by
            states[k], pushes[k] = state, push
        A, J = limits
        self._free, self._moved = states[:, 0], pushes[:, 0]
        self._tilted, self._bounded = states[:, 2] / A, np.vstack((pushes[:, 2] / A, np.eye(n) / J))
        H = self._moved.T @ self._moved + shaping.weight_m2 * self._bounded.T @ self._bounded
        self._solved = np.linalg.inv(H + 1e-9 * np.eye(n))
        self._pull = shaping.weight_m2 * self._bounded.T
        times = np.arange(1, count + 1) * period
        within = np.minimum(np.floor((times - 1e-9) / piece).astype(int), pieces - 1)
        self._samples = np.empty((count, 3, 3 + pieces))
        for row, time, k in zip(self._samples, times, within.tolist(), strict=True):
            on, by = _integration_matrices(time - k * piece)
            begin = np.hstack((np.eye(3), np.zeros((3, pieces))))
            if k:
                begin = np.hstack((states[k - 1], pushes[k - 1][:, :pieces]))
            row[:] = on @ begin
            row[:, 3 + k] += by
        self._warm: tuple[Array, Array] | None = None
        self._astray: Mask = np.zeros((), bool)

    def restart(self) -> None:
        """Expect a new path, which may not continue the previous slice."""
        self._warm, self._astray = None, np.ones((), bool)

    def within(self, path: Array) -> Mask:
        """Whether acceleration and jerk of a path keep to the limits, shape (...,).

        Args:
            path: Position, velocity, acceleration, shape (3, K, ..., 2).
        """
        begins: Mask = (np.abs(path[2, 0]) <= self._limits[0]).all(axis=-1)
        return np.asarray(begins & self.within_each(path).all(axis=0))

    def within_each(self, path: Array) -> Mask:
        """Whether each sample but the first, and the step to it, keep to them, (K - 1, ...).

        Args:
            path: Position, velocity, acceleration, shape (3, K, ..., 2).
        """
        A, J = self._limits
        kept: Mask = np.abs(path[2, 1:]) <= A
        for limit, each in ((A, path[1]), (J, path[2])):  # a corner has no acceleration
            kept &= np.abs(each[1:] - each[:-1]) <= limit * self._period
        return kept[..., 0] & kept[..., 1]

    def follow(self, state: Array, path: Array, kept: Mask) -> Array:
        """The next slice, shape (3, count, ..., 2).

        Args:
            state: Position, velocity, acceleration at the end of the previous slice, (3, ..., 2).
            path: The desired path from there, shape (3, K, ..., 2), at least the horizon long.
            kept: Which of its samples, and steps to them, keep to the limits, shape (K, ...).
        """
        joins = self.within(np.stack((state, path[:, 0]), axis=1))
        able = np.asarray(joins & kept[1:].all(axis=0))
        slice_: Array = path[:, : self.count]
        if able.all() and not self._astray.any():
            return slice_
        arrived = np.tensordot(_integration_matrices(self._period)[0], state, axes=1)
        tolerances = np.array(self._shaping.return_tolerances).reshape(3, *[1] * (state.ndim - 1))
        near = np.abs(arrived - path[:, 0]) < tolerances
        self._astray = astray = ~able | (self._astray & ~near.all(axis=(0, -1)))
        if not astray.any():
            self._warm = None
            return slice_
        return np.where(astray[..., None], self._nearest(state, path), slice_)

    def _nearest(self, state: Array, path: Array) -> Array:
        """The slice of the nearest path within the limits."""
        (A, J), pieces = self._limits, self._shaping.pieces_per_slice
        x = np.moveaxis(state, 0, -2)  # every rig by itself, so that it gets the same bits alone
        place = np.minimum(self._places, path.shape[1]) - 1
        low = np.floor(place).astype(int)
        high = np.minimum(low + 1, path.shape[1] - 1)
        share = (place - low).reshape(-1, *[1] * (path.ndim - 2))
        desired = np.moveaxis(path[0][low] + share * (path[0][high] - path[0][low]), 0, -2)
        base = self._moved.T @ (desired - self._free @ x)
        tilted = self._tilted @ x
        room = np.concatenate((tilted, np.zeros_like(tilted)), axis=-2)
        z, price = self._warm or (np.zeros_like(room), np.zeros_like(room))
        least, most = -1 - room, 1 - room
        for _ in range(self._shaping.iterations):
            jerk = self._solved @ (base + self._pull @ (z - price))
            done = self._bounded @ jerk
            z = np.minimum(np.maximum(done + price, least), most)
            price = price + done - z
        kept = self._astray[..., None, None]
        self._warm = kept * _shift_multipliers(z, pieces), kept * _shift_multipliers(price, pieces)
        piece, now, pushes = self.count * self._period / pieces, x[..., 2, :], []
        for k in range(pieces):  # the method may leave a little beyond the limits
            push = np.clip(jerk[..., k, :], -J, J)
            end = np.clip(now + piece * push, -A, A)
            pushes.append((end - now) / piece)
            now = end
        begin = np.concatenate((x, np.stack(pushes, axis=-2)), axis=-2)
        made = self._samples.reshape(3 * self.count, -1) @ begin
        made = made.reshape(*made.shape[:-2], self.count, 3, 2)
        return np.moveaxis(made, (-3, -2), (1, 0))


def _integration_matrices(time: float) -> tuple[Array, Array]:
    """Matrices of position, velocity and acceleration after a time in s, for a constant jerk.

    Returns:
        Derivatives by their initial values, shape (3, 3), and by the jerk, shape (3,).
    """
    on = np.array([[1, time, time**2 / 2], [0, 1, time], [0, 0, 1]])
    return on, np.array([time**3 / 6, time**2 / 2, time])


def _shift_multipliers(bounds: Array, pieces: int) -> Array:
    """Multipliers of acceleration and jerk of each piece, shifted by one slice.

    Args:
        bounds: The multipliers, shape (..., 2 n, 2): n of the acceleration, n of the jerk.
        pieces: Pieces in a slice.
    """
    n = bounds.shape[-2] // 2
    order = np.minimum(np.arange(n) + pieces, n - 1)
    return np.take(bounds, np.concatenate((order, n + order)), axis=-2)


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


@dataclass(frozen=True, kw_only=True)
class AboutMotion(Law):
    """The common part of laws that follow a motion (r, a*) of ball and plate.

    With the slopes a = (phi, -theta) the flat output eta = x + c2 a of the linear model (5.35)
    obeys eta'' = k1 a, and the law is

        a'' = a*'' - K (eta - r - c2 a*, eta' - r' - c2 a*', a - a*, a' - a*')

    with K of the linear-quadratic regulator. Jumps of the reference are spread.

    Raises:
        ValueError: If a setting is not finite or has the wrong sign.
    """

    Q: tuple[NotNegative, NotNegative, NotNegative, NotNegative] = (20000.0, 2000.0, 100.0, 10.0)
    """Weights of eta (m), its rate, slope (rad) and its rate; the slope's acceleration has 1."""
    preview: NotNegative = 1.4
    """Time in s by which the reference is sampled in advance; 0 for none. For a path that the plate
    can produce it is sampled 1.2 s further."""
    spread: NotNegative = 1.3
    """Time in s over which a jump of 0.15 m is spread, others by the root of their length; 0 leaves
    jumps as they are."""
    slope: NotNegative = 0.12
    """Largest slope of the plate in rad that the path may need, less than a rig allows: friction
    and feedback need the rest. 0 for no limit."""
    slope_rate: NotNegative = 0.8
    """Largest rate of that slope in rad/s; 0 for no limit."""

    slicing: Slicing = algorithm_constants(SLICING)
    """How the path is planned slice by slice."""
    jumps: JumpSpreading = algorithm_constants(JUMP_SPREADING)
    """Criterion of a jump of the reference."""
    shaping: PathShaping = algorithm_constants(PATH_SHAPING)
    """How a path that the plate cannot produce is replaced."""

    K: Array = field(init=False, repr=False, compare=False)
    """Gain from eta, its rate, slope and its rate to the slope's acceleration, shape (4,)."""

    def __post_init__(self) -> None:
        """Check the settings and compute the gain once."""
        super().__post_init__()
        if not self.Q[0] > 0:
            raise ValueError(f"Q must have a positive weight of eta, got {list(self.Q)}")
        object.__setattr__(self, "K", self._gain())

    def _gain(self) -> Array:
        """K, shape (4,)."""
        A, B = flat_axis(self.model)
        P = scipy.linalg.solve_continuous_are(A, B, np.diag(self.Q), np.eye(1))
        return P[3]

    def ahead(
        self,
        x: Array,
        reference: Reference,
        period: float,
        *,
        feasible: bool = True,
        time: float = 0.0,
    ) -> Preview:
        """The path ahead of a state at the start, shape (..., 8).

        Args:
            x: The state.
            reference: Path of the ball.
            period: Control period in s.
            feasible: Whether it keeps to what the plate can produce.
            time: Time of the start in s.
        """
        limits = self.model.k1 * self.slope, self.model.k1 * self.slope_rate
        return Preview(
            reference=reference,
            start=x[..., 0::4],
            period=period,
            horizon=self.preview,
            spread=self.spread,
            limits=limits if feasible and all(limits) else None,
            moving=np.stack((x[..., 1::4], self.model.k1 * TILT_SIGN * x[..., 2::4])),
            first=round(time / period),
            slicing=self.slicing,
            jumps=self.jumps,
            shaping=self.shaping,
        )

    def planned_path(
        self, x: Array, reference: Reference, period: float, count: int, time: float = 0.0
    ) -> Array:
        """The planned path where it differs from the desired one, m, (count, 2); NaN elsewhere.

        Args:
            x: State at the start, shape (8,).
            reference: Path of the ball.
            period: Control period in s.
            count: Number of control periods from the start.
            time: Time of the start in s.
        """
        ahead = self.ahead(x, reference, period, time=time)
        further = math.ceil((self.preview + self.shaping.horizon_s) / period)
        desired = self.ahead(x, reference, period, feasible=False, time=time).along(count + further)
        if ahead.able(desired):
            return np.full((count, 2), np.nan)
        planned = ahead.along(count)[0]
        distance = np.hypot(*(planned - desired[0, :count]).T)
        return np.where(distance[:, None] > self.shaping.min_difference_m, planned, np.nan)

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations without a plan, rad/s^2, shape (..., 2): the flat model's slope."""
        r = reference(t)
        k1 = self.model.k1
        return self.about(x, r[0], r[1], Tilts(r[2] / k1, r[3] / k1, r[4] / k1))

    def about(self, x: Array, position: Array, velocity: Array, desired: Tilts) -> Array:
        """Feedback about a motion, rad/s^2, shape (..., 2)."""
        axis = x[..., 0::4], x[..., 1::4], TILT_SIGN * x[..., 2::4], TILT_SIGN * x[..., 3::4]
        K = (*self.K[:3], self.K[3:].sum())  # for a plate that follows its command at once
        return TILT_SIGN * self._about(K, axis, (position, velocity), desired)

    def _about(
        self,
        K: Sequence[float] | Array,
        axis: Sequence[Any],
        path: Sequence[Any],
        desired: Tilts,
        by: Arithmetic = ARRAY_ARITHMETIC,
    ) -> Any:
        """Acceleration of the slope, rad/s^2, about a motion.

        Args:
            K: The gain.
            axis: Position and velocity of the ball, slope and its rate.
            path: Desired position and velocity.
            desired: Desired slope.
            by: Arithmetic of them.
        """
        (x, v, angle, angle_rate), (position, velocity), c2 = axis, path, self.model.c2
        slope, rate = angle - desired.angle, angle_rate - desired.rate
        eta, eta_rate = x - position + c2 * slope, v - velocity + c2 * rate
        bounded = self._bound_error(eta, eta_rate, by)
        return desired.acceleration - K[0] * bounded - K[1] * eta_rate - K[2] * slope - K[3] * rate

    def _bound_error(self, eta: Any, rate: Any, by: Arithmetic) -> Any:
        """The error of eta in m that is fed back, from it and its rate in m/s; all by default."""
        return eta


def flat_axis(model: BallPlate) -> tuple[Array, Array]:
    """A, shape (4, 4), and B, shape (4, 1), of (eta, eta', a, a') under a''."""
    A, B = np.eye(4, k=1), np.eye(4)[:, 3:]
    A[1, 2] = model.k1
    return A, B


def beyond(square: Any, speed: float) -> Any:
    """From 0 at rest to 1 where the square of a speed, in (m/s)^2, is far above a speed in m/s."""
    share = square / speed**2
    return share * share / (1 + share * share)


@dataclass(frozen=True, kw_only=True)
class StableInversion(AboutMotion):
    """Follows a motion of ball and plate that makes the ball itself follow the reference.

    With the slopes a = (phi, -theta), either axis is x'' = (1 + kappa) k1 a - c2 a'' + d - F h
    with friction F along the heading h, or eta'' = (1 + kappa) k1 a + d - F h with the flat output
    eta = x + c2 a. The slope that makes x follow r is the bounded solution (``TwoSided``) of

        a* - a*'' / Z^2 = (r'' + F h(r') - d) / k1,    Z^2 = k1 / c2,

    divided by 1 + kappa. It begins before its cause, so the reference is sampled in advance. F, d
    and kappa come from the observer, h(v) = v / sqrt(|v|^2 + vs^2). On a plate with a camber c, d
    changes by c r' as the ball moves, and so do rate and acceleration of the slope. About it the
    law is

        a'' = a*'' - K (eta - r - c2 a*, eta' - r' - c2 a*', a - a*, a' - a*')

    with K of the linear-quadratic regulator of eta'' = k1 a. Jumps of the reference are spread.

    Drives with a lag T, given (``BallPlate.lag``) or estimated by the observer, turn the plate at a
    rate a' that follows the commanded rate w, a'' = (w - a') / T. The regulator then acts on
    (eta, eta', a, a', w) with the input w', about w* = a*' + T a*''. An estimated lag counts while
    the ball is to move: where it is to rest it may stick, and comes free sooner on a plate that
    swings in the play of its drives, as it does where the lag is left out.

    A ball that was pushed is first braked and then brought back. While its error of eta is above
    ``PushResponse.pushed_error_m`` and grows, ``max_growing_error_m`` of it is fed back at most:
    the slope for the rest would be too late to stop the ball, and would move it outwards as it
    tilts. While the error shrinks, ``max_error_m`` is fed back at most: a ball that is pulled back
    harder is too fast for a plate that turns at a limited rate, and leaves on the other side.

    Raises:
        ValueError: If a setting is not finite or has the wrong sign.
    """

    name: ClassVar[str] = "stable_inversion"
    replans: ClassVar[bool] = True
    needs: ClassVar[tuple[str, ...]] = (
        "friction",
        "plate_lag",
        *(f"{each}_{axis}" for each in ("disturbance", "tilt_gain", "plate_bias") for axis in "xy"),
    )

    counts: ClassVar[tuple[str, ...]] = ("camber_x", "camber_y")

    Q: tuple[NotNegative, NotNegative, NotNegative, NotNegative] = (3e5, 3e4, 1e4, 200.0)
    """Weights of eta (m), its rate, slope (rad) and its rate; the slope's acceleration has 1. An
    uneven friction and a ball that sticks need a stiff feedback; noise, effort and play of the
    drives a soft one."""
    Q_slow: tuple[NotNegative, NotNegative, NotNegative, NotNegative] | None = None
    """Those weights where the ball is to be slower than about ``slow_speed`` within the preview: at
    rest, before it, and where it turns back; None for the same. There it may stick, and friction
    changes its sign, which needs a stiff feedback; a ball that keeps moving needs a heavier rate of
    the slope, which lets less noise through."""
    slow_speed: Positive = 0.05
    """Smallest desired speed in m/s about which the weights change."""
    smooth: Positive = 0.006
    """Desired speed vs in m/s over which the friction fed forward changes its sign."""
    resting_speed: NotNegative = 0.015
    """Desired speed in m/s, now and a second later, below which the ball is to be held rather than
    moved: friction is then fed forward along the ball's own heading, as there is no other. 0 for
    never."""

    dither_deg: Annotated[float, Ge(0), Le(2)] = 0.0
    """Amplitude in deg of a circle that the plate's tilt goes round in addition to the motion; 0
    for none. More than half the play of the drives crosses the play twice in each round, so that
    the mean tilt follows the command without a measurement of it; likewise a dead band."""
    dither_hz: Annotated[float, Gt(0), Le(20)] = 5.0
    """Rounds of that circle in Hz."""
    rate_bias: bool = False
    """Whether a law about drives with a lag counts the plate's estimated rate beyond the commanded
    one: play changes the plate's rate all the time. With ``Q_slow`` only while the ball is to keep
    moving; where it turns back the estimate is late."""

    push_response: PushResponse = algorithm_constants(PUSH_RESPONSE)
    """Bounds of the error that is fed back once the ball was pushed."""

    _slow: StableInversion | None = field(init=False, repr=False, compare=False, default=None)
    """The same with those weights."""
    _cubic: Sequence[tuple[float, ...]] = field(init=False, repr=False, compare=False, default=())
    """Coefficients of the gain as a cubic of the lag in s, constant first, if no lag is given."""

    def _gain(self) -> Array:
        """K, shape (4,); for drives with a lag (5,)."""
        if self.Q_slow:
            object.__setattr__(self, "_slow", replace(self, Q=self.Q_slow, Q_slow=None))
        if self.model.lag:
            return self._gain_at(self.model.lag)
        K = super()._gain()
        lags = np.linspace(0.0, LONGEST_LAG, 4)
        none = np.array((*K[:3], 0.0, K[3]))  # the limit without a lag
        gains = np.stack((none, *map(self._gain_at, lags[1:])))
        cubic = np.linalg.solve(np.vander(lags, increasing=True), gains)
        object.__setattr__(self, "_cubic", tuple(map(tuple, cubic.tolist())))
        return K

    def _gain_at(self, lag: float) -> Array:
        """K for drives with a lag in s, shape (5,)."""
        A, B = np.eye(5, k=1), np.eye(5)[:, 4:]
        A[1, 2], A[3, 3:] = self.model.k1, (-1 / lag, 1 / lag)
        P = scipy.linalg.solve_continuous_are(A, B, np.diag((*self.Q, 0.0)), np.eye(1))
        return P[4]

    def start(self, x: Array, reference: Reference, period: float) -> InversePlan:
        """The motion of ball and plate, its first slice planned."""
        return InversePlan(self, x, reference, period)

    def replanned(
        self, plan: InversePlan, t: float, x: Array, reference: Reference, period: float
    ) -> InversePlan:
        """The motion from the ball's state at a time in s."""
        return InversePlan(self, x, reference, period, t)

    def command(self, now: Feedback) -> Array:
        """Plate accelerations in rad/s^2, shape (..., 2), from plan and observer."""
        rows, k1 = now.x.reshape(-1, 8), self.model.k1
        x, (F, lag, *known) = components(rows), components(now.needed.reshape(len(rows), -1))
        camber = known[6:] or (0.0, 0.0)
        motion, planned, fast = now.plan.at(now.time, now.reference), 1.0, 1.0
        if self.resting_speed:
            planned = beyond(motion[0].pace, self.resting_speed)
        by = arithmetic_of(rows)
        K = self._gains_for(lag, planned, by)
        if self._slow is not None:
            fast = beyond(motion[0].going, self.slow_speed)
            slow = self._slow._gains_for(lag, planned, by)
            K = [k + fast * (full - k) for k, full in zip(slow, K, strict=True)]
        # a ball at rest comes free sooner on a plate that swings in the play of its drives
        lag = self.model.lag or planned * lag
        vx, vy, u = x[1], x[5], []
        length = by.sqrt(vx * vx + vy * vy + self.smooth**2)
        for axis, desired in enumerate(motion):
            d, gain, sign = known[axis], 1 + known[2 + axis], (1.0, -1.0)[axis]
            ball, v, angle, rate = x[4 * axis : 4 * axis + 4]
            free, drag = desired.free, desired.drag
            if self.resting_speed:  # as planned; at rest along the ball's own heading
                own = (1 - planned) * v / (length * k1)
                drag = Tilts(planned * drag[0] + own, planned * drag[1], planned * drag[2])
            c = camber[axis]  # d changes as the ball moves
            slope = Tilts(
                (free.angle + F * drag.angle - d / k1) / gain,
                (free.rate + F * drag.rate - c * desired.velocity / k1) / gain,
                (free.acceleration + F * drag.acceleration - c * free.angle) / gain,
            )
            seen = ball, v, sign * angle, sign * rate
            requested = self._about(K, seen, (desired.position, desired.velocity), slope, by)
            if len(K) > 4:
                counted = self.rate_bias * fast * known[4 + axis]
                commanded = sign * (numbers(now.rate[..., axis]) + counted)
                jerk = desired.jerk[0] + F * planned * desired.jerk[1] - c * free.rate
                jerk = jerk / gain
                ahead = commanded - slope.rate - lag * slope.acceleration
                requested = requested + lag * jerk - K[4] * ahead
            u.append(sign * requested)
        return together(u, len(rows)).reshape(now.rate.shape)

    def _gains_for(self, lag: Any, planned: Any, by: Arithmetic) -> Sequence[Any]:
        """K for drives with a lag in s.

        Args:
            lag: The lag; 0 for none.
            planned: From 0, where the ball is to rest, to 1, where it is to move.
            by: Arithmetic of both.
        """
        K: Sequence[Any] = self.K.tolist()
        if self.model.lag or not by.any(lag):
            return K
        planned, cubic = planned * (lag > 0), zip(*self._cubic, strict=True)
        return [
            k + planned * (a + lag * (b + lag * (c + lag * d)) - k)
            for k, (a, b, c, d) in zip((*K, 0.0), cubic, strict=True)
        ]

    def _bound_error(self, eta: Any, rate: Any, by: Arithmetic) -> Any:
        """The error of eta within bounds; the same bits where it does not reach them."""
        bounds = self.push_response
        far = abs(eta) > bounds.pushed_error_m
        if not by.any(far):
            return eta
        most = by.where(far & (eta * rate > 0), bounds.max_growing_error_m, bounds.max_error_m)
        return by.least(by.most(eta, -most), most)


FREE_SLOPES = (4, 5, 6, 10)
"""Components of an ``InverseMotion`` that are the slope without friction and its derivatives."""


class InverseMotion(NamedTuple):
    """The desired motion of the ball along one axis, and the slopes for it by the inverse.

    Components: numbers for one rig, else arrays (N,).
    """

    position: Any
    """Position of the ball in m."""
    velocity: Any
    """Velocity of the ball in m/s."""
    pace: Any
    """Sum of the squares of its speed along both axes and of its acceleration's gain in 1 s,
    (m/s)^2."""
    going: Any
    """Square of its smallest speed along both axes from now to the horizon, (m/s)^2."""
    free: Tilts
    """Slopes for the motion without friction, rad."""
    drag: Tilts
    """Further slopes for a friction of 1 m/s^2, rad per m/s^2."""
    jerk: tuple[Any, Any]
    """Third derivatives of both."""

    @classmethod
    def of(cls, row: Sequence[Any]) -> Self:
        """The motion from its twelve components in their order."""
        x, v, pace, going, *slopes, free, drag = row
        return cls(x, v, pace, going, Tilts(*slopes[:3]), Tilts(*slopes[3:]), (free, drag))


class InversePlan(Slices):
    """The motion for one run, planned slice by slice.

    Args:
        law: The law that plans it.
        x: State at the start, shape (..., 8).
        reference: Path of the ball.
        period: Control period in s.
        time: Time of the start in s.
    """

    def __init__(
        self,
        law: StableInversion,
        x: Array,
        reference: Reference,
        period: float,
        time: float = 0.0,
    ) -> None:
        self._law = law
        preview = law.ahead(x, reference, period, time=time)
        self._free, self._drag = (inverse(law.model, preview, period) for _ in range(2))
        super().__init__(preview, period)

    def at(self, t: float, reference: Reference | None = None) -> list[InverseMotion]:
        """The desired motion along x and y at a time in s; successive times must not decrease.

        Args:
            t: The time.
            reference: The path from now on; as before by default.
        """
        tick = self._tick(t, reference)
        rows = self._planned[tick].reshape(12, -1, 2).transpose(2, 0, 1)
        axes = rows[..., 0].tolist() if rows.shape[2] == 1 else rows.copy()
        return [InverseMotion.of(row) for row in axes]

    def _parts(self) -> Sequence[Callable[[], None]]:
        return self._preview.sample, self._preview.advance, self._plan_free, self._plan

    def _plan_free(self) -> None:
        self._free_planned = self._free.plan(self._preview.window[2] / self._law.model.k1)

    def _plan(self) -> None:
        k1, count = self._law.model.k1, self._preview.count
        position, velocity, acceleration = self._preview.window
        square = square_of(velocity)
        pace = square[:count] + square_of(acceleration[:count])
        going = np.broadcast_to(square.min(axis=0), pace.shape)
        speed = np.sqrt(square + self._law.smooth**2)
        drag = self._drag.plan(velocity / (k1 * speed))
        self._next = np.empty((count, 12, *position.shape[1:]))
        jerks = self._free.jerk, self._drag.jerk
        parts = position[:count], velocity[:count], pace, going, *self._free_planned, *drag, *jerks
        for number, each in enumerate(parts):
            self._next[:, number] = each
        if self._law.dither_deg:
            self._next[:, FREE_SLOPES] += self._dithered(count)

    def _dithered(self, count: int) -> Array:
        """Slope of the dither and its three derivatives in the next slice, (count, 4, ..., 2)."""
        law, ticks = self._law, self._first + count + np.arange(count)
        w = 2 * math.pi * law.dither_hz
        phase = w * self._period * ticks[:, None]
        circle = np.stack((np.sin(phase), np.cos(phase)), axis=-1)
        turned = np.stack((circle[..., 1], -circle[..., 0]), axis=-1)
        swing = np.concatenate((circle, w * turned, -(w**2) * circle, -(w**3) * turned), axis=1)
        rigs = (1,) * (self._next.ndim - 3)
        return math.radians(law.dither_deg) * swing.reshape(count, 4, *rigs, 2)
