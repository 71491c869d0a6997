"""Laws about a motion of ball and plate that makes the ball follow a reference.

The reference is asked some time ahead slice by slice, its jumps spread, and made one that the plate
can give. The plate's motion is the stable inverse of a plant that first moves the wrong way;
friction is fed forward, and the feedback about it is linear-quadratic.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np
import scipy

from controllers.arrays import (
    ARRAY_ARITHMETIC,
    NUMBER_ARITHMETIC,
    Array,
    Mask,
    NotNegative,
    Positive,
    components,
    numbers,
    some,
    square_of,
    together,
)
from controllers.ballplate import LONGEST_LAG, TILT_SIGN, BallPlate
from controllers.interfaces import Feedback, Law, Reference


class DesiredMotion(NamedTuple):
    """What ball and plate are to do at one tick."""

    position: Array
    """Position of the ball in m, shape (..., 2)."""
    velocity: Array
    """Velocity of the ball in m/s, shape (..., 2)."""
    slope: Tilts
    """Tilt of the plate along x and y, (phi, -theta), in rad."""


class Slices(ABC):
    """What is laid ahead slice by slice and asked for tick by tick, for one run.

    The next slice is made in parts, one in each of the last ticks before it is due, so that none of
    them takes long; where little is known ahead, at once when it is due.

    Args:
        preview: Where the path ahead comes from; a slice has as many ticks as it advances.
        period: Control period in s.
    """

    _next: Any
    """The next slice, once its last part is made."""

    def __init__(self, preview: Preview, period: float) -> None:
        self._preview, self._period = preview, period
        self._first, self._made = preview.first - preview.count, 0
        self._turn()

    def _tick(self, t: float, reference: Reference | None = None) -> int:
        """Where in its slice a time in s stands that does not lie before the one asked for last."""
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
        """Go over to the next slice."""
        self._make(self._parts())
        self._laid, self._made = self._next, 0
        self._first += self._preview.count

    def _make(self, parts: Sequence[Callable[[], None]]) -> None:
        for part in parts[self._made :]:
            part()
            self._made += 1

    @abstractmethod
    def _parts(self) -> Sequence[Callable[[], None]]:
        """What makes the next slice, in this order."""


class MotionPlan(Slices):
    """The motion for one run: the plate's by the stable, two-sided inverse of the ball's.

    Args:
        law: Whose.
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
        """What is wanted at a time in s that does not lie before the one asked for last."""
        tick = self._tick(t)
        position, velocity, (angle, rate, acceleration) = self._laid
        slope = Tilts(angle[tick], rate[tick], acceleration[tick])
        return DesiredMotion(position[tick], velocity[tick], slope)

    def _parts(self) -> Sequence[Callable[[], None]]:
        return self._preview.ask, self._preview.go_on, self._lay

    def _lay(self) -> None:
        count, (position, velocity, acceleration) = self._preview.count, self._preview.window
        slope = self._inverse.lay(acceleration / self._k1)
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
    """The bounded solution a of a - a'' / Z^2 = w for a w that is known some time ahead.

    The ball's x'' = k1 phi - c2 phi'' has a zero in the right half plane at Z = sqrt(k1 / c2), so
    that the slope for a wished x'' = k1 w has a pole there, whose bounded answer comes before its
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
        self._Z, self._count, self._period = Z, count, period
        step = Z * period
        decay = math.exp(-step)
        # weights of the two ends of a straight line, the nearer one first
        far = (1 - decay) / step - decay
        near = 1 - decay - far
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
        """Third derivative of a in the slice laid last, shape (count, ...)."""

    def lay(self, w: Array) -> Tilts:
        """Return a, a' and a'' of a slice, each (count, ...), from a window that begins with it.

        Every sample makes use of the same time ahead, that of the slice's last one.

        Args:
            w: The window, shape (length, ..., axes).
        """
        count = self._count
        # every rig by itself, so that it gets the same bits beside others
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
        slopes = a, self._Z * (q - p) / 2, self._Z**2 * (a - here)
        self.jerk = (self._Z**2 * (slopes[1] - change)).swapaxes(-2, 0)
        return Tilts(*(each.swapaxes(-2, 0) for each in slopes))


SLICE_PERIODS = 25
"""Control periods that are laid at once: few, so that none of them takes long."""
MAX_EARLY_TICKS = 4
"""Ticks before a slice is due at which the first of its parts, at most as many, is made."""
MIN_JUMP_M = 2e-3
"""Distance in m from one period to the next, beyond what the speed covers, that is a jump."""
REFERENCE_JUMP_M = 0.15
"""Length of a jump in m to which its time refers."""


SHAPING_HORIZON_S = 1.2
"""Time in s beyond the window over which a path that the plate cannot give is made one it can."""
PIECES_PER_SLICE = 2
"""Pieces of constant jerk in a slice of such a path."""


class FeasiblePath:
    """The path nearest to another one whose acceleration and jerk keep to limits, slice by slice.

    The least mean square distance over some time ahead, of paths whose jerk is constant over short
    pieces, from the end of the slice before: a quadratic programme with bounds, by the method of
    multipliers (Boyd et al. 2011, "Distributed optimization and statistical learning via the
    alternating direction method of multipliers", 3.1), which goes on from the slice before.

    Args:
        limits: Of acceleration, m/s^2, and jerk, m/s^3, along either axis.
        period: Time from one sample to the next, s.
        count: Samples of a slice.
    """

    STEPS = 20
    """Iterations of the method in each slice."""
    WEIGHT = 3e-3
    """Weight of the bounds in the method, m^2."""

    def __init__(self, limits: tuple[float, float], period: float, count: int) -> None:
        self.count, self._limits, self._period = count, limits, period
        piece = count * period / PIECES_PER_SLICE
        self.length = n = PIECES_PER_SLICE * math.ceil(SHAPING_HORIZON_S / (count * period))
        """Pieces that are looked ahead."""
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
        H = self._moved.T @ self._moved + self.WEIGHT * self._bounded.T @ self._bounded
        self._solved = np.linalg.inv(H + 1e-9 * np.eye(n))
        self._pull = self.WEIGHT * self._bounded.T
        times = np.arange(1, count + 1) * period
        within = np.minimum(np.floor((times - 1e-9) / piece).astype(int), PIECES_PER_SLICE - 1)
        self._samples = np.empty((count, 3, 3 + PIECES_PER_SLICE))
        for row, time, k in zip(self._samples, times, within.tolist(), strict=True):
            on, by = _integration_matrices(time - k * piece)
            begin = np.hstack((np.eye(3), np.zeros((3, PIECES_PER_SLICE))))
            if k:
                begin = np.hstack((states[k - 1], pushes[k - 1][:, :PIECES_PER_SLICE]))
            row[:] = on @ begin
            row[:, 3 + k] += by
        self._warm: tuple[Array, Array] | None = None
        self._astray: Mask = np.zeros((), bool)

    def begin_anew(self) -> None:
        """Expect another path: whether it goes on from the slice before is to be seen."""
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
            state: Position, velocity and acceleration at the end of the slice before, (3, ..., 2).
            path: What is wished from there on, shape (3, K, ..., 2), at least the time ahead.
            kept: Which of its samples, and steps to them, keep to the limits, shape (K, ...).
        """
        joins = self.within(np.stack((state, path[:, 0]), axis=1))
        able = np.asarray(joins & kept[1:].all(axis=0))
        slice_: Array = path[:, : self.count]
        if able.all() and not self._astray.any():
            return slice_
        arrived = np.tensordot(_integration_matrices(self._period)[0], state, axes=1)
        near = np.abs(arrived - path[:, 0]) < np.array(PATH_RETURN_TOLERANCES).reshape(
            3, *[1] * (state.ndim - 1)
        )
        self._astray = astray = ~able | (self._astray & ~near.all(axis=(0, -1)))
        if not astray.any():
            self._warm = None
            return slice_
        return np.where(astray[..., None], self._nearest(state, path), slice_)

    def _nearest(self, state: Array, path: Array) -> Array:
        """The slice of the nearest path within the limits."""
        A, J = self._limits
        x = np.moveaxis(state, 0, -2)  # every rig by itself, so that it gets the same bits alone
        place = np.minimum(self._places, path.shape[1]) - 1
        low = np.floor(place).astype(int)
        high = np.minimum(low + 1, path.shape[1] - 1)
        share = (place - low).reshape(-1, *[1] * (path.ndim - 2))
        wished = np.moveaxis(path[0][low] + share * (path[0][high] - path[0][low]), 0, -2)
        base = self._moved.T @ (wished - self._free @ x)
        tilted = self._tilted @ x
        room = np.concatenate((tilted, np.zeros_like(tilted)), axis=-2)
        z, price = self._warm or (np.zeros_like(room), np.zeros_like(room))
        least, most = -1 - room, 1 - room
        for _ in range(self.STEPS):
            jerk = self._solved @ (base + self._pull @ (z - price))
            done = self._bounded @ jerk
            z = np.minimum(np.maximum(done + price, least), most)
            price = price + done - z
        kept = self._astray[..., None, None]
        self._warm = kept * _shift_multipliers(z), kept * _shift_multipliers(price)
        piece, now, pushes = self.count * self._period / PIECES_PER_SLICE, x[..., 2, :], []
        for k in range(PIECES_PER_SLICE):  # what the method leaves beyond the limits
            push = np.clip(jerk[..., k, :], -J, J)
            end = np.clip(now + piece * push, -A, A)
            pushes.append((end - now) / piece)
            now = end
        begin = np.concatenate((x, np.stack(pushes, axis=-2)), axis=-2)
        made = self._samples.reshape(3 * self.count, -1) @ begin
        made = made.reshape(*made.shape[:-2], self.count, 3, 2)
        return np.moveaxis(made, (-3, -2), (1, 0))


MIN_PATH_DIFFERENCE_M = 1e-3
"""Distance in m from which on a path is another than what is wished."""
PATH_RETURN_TOLERANCES = (1e-4, 1e-3, 2e-2)
"""Distances in m, m/s and m/s^2 from a path that can be followed below which it is."""


def _integration_matrices(time: float) -> tuple[Array, Array]:
    """Position, velocity, acceleration after a time in s: by those at first, and by the jerk."""
    on = np.array([[1, time, time**2 / 2], [0, 1, time], [0, 0, 1]])
    return on, np.array([time**3 / 6, time**2 / 2, time])


def _shift_multipliers(bounds: Array) -> Array:
    """What belongs to acceleration and jerk of each piece, a slice on."""
    n = bounds.shape[-2] // 2
    order = np.minimum(np.arange(n) + PIECES_PER_SLICE, n - 1)
    return np.take(bounds, np.concatenate((order, n + order)), axis=-2)


class _Jump(NamedTuple):
    """A jump that is spread: when it comes in s, what it is in m, and over how long in s."""

    time: float
    way: Array
    duration: Array


class Preview:
    """Position, velocity and acceleration of a reference over a window that moves with time.

    A jump of the reference is taken in smoothly after it, over a time that grows with the root of
    its length; so is the way from where the ball is at the start.

    Args:
        reference: The path.
        start: Where the ball is at the start, m, shape (..., 2).
        period: Control period in s.
        horizon: How far the reference is asked ahead, s; 0 for not at all.
        spread: Time in s over which a jump of 0.15 m is spread; 0 leaves jumps as they are.
        limits: Of acceleration, m/s^2, and jerk, m/s^3, along either axis; None for none.
        moving: Velocity, m/s, and acceleration, m/s^2, of the ball at the start, (2, ..., 2); at
            rest by default. A path that keeps to limits goes on from there.
        first: Control periods from time 0 to the start.
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
    ) -> None:
        self._period, self._spread = period, spread
        self.first = first
        """Control periods from time 0 to the start."""
        self.reference = reference
        """The path; another one is asked from the next slice on."""
        self._asked_of: Any = None
        ahead = math.floor(horizon / period + 1e-9)
        self.early = MAX_EARLY_TICKS if ahead >= SLICE_PERIODS + MAX_EARLY_TICKS else 0
        """Ticks before a slice begins at which it is asked for, so that the window is shorter."""
        self.length = ahead + 1 - self.early
        """Ticks of the window."""
        self.count = min(SLICE_PERIODS, self.length)
        """Ticks of a slice."""
        self._known = self._begun = first
        able = limits is not None and self.early > 0
        self._feasible = FeasiblePath(limits, period, self.count) if able and limits else None
        self._further = math.ceil(SHAPING_HORIZON_S / period) if able else 0
        self._asked: Array = np.empty((3, 0, *start.shape))
        self._kept: Mask = np.empty((0, *start.shape[:-1]), bool)
        """Which samples of what was asked for, and steps to them, keep to the limits."""
        self._made = self._asked
        self.window: Array = self._asked
        """Position, velocity, acceleration, in m and s, shape (3, length, ..., 2), of a slice that
        begins with it and ends the horizon after it is asked for."""
        self._jumps: list[_Jump] = []
        self._last = np.stack((start, 0 * start))
        velocity, acceleration = np.zeros((2, *start.shape)) if moving is None else moving
        self._before = np.stack((start - period * velocity, velocity, acceleration))
        """Position, velocity, acceleration of the ball a period before the start, (3, ..., 2)."""

    def ask(self) -> None:
        """Ask for a slice more of the reference, its jumps spread; of another one for all of it."""
        count = self.count
        original = getattr(self.reference, "original", self.reference)
        if self._known > self.first and original != self._asked_of:
            self._forget()
        self._asked_of = original
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
            before = self._asked[:, -1:] if self._asked.shape[1] else r[:, :1]
            kept = self._feasible.within_each(np.concatenate((before, r), axis=1))
            self._kept = np.concatenate((self._kept, kept))
        self._asked = np.concatenate((self._asked, r), axis=1)
        self._known += count

    def _forget(self) -> None:
        """Of what was asked for and made keep the slice that is under way."""
        self._known = self._begun
        self._asked, self._made = self._asked[:, :0], self._made[:, : self.count]
        self._kept = self._kept[:0]
        self._last, self._jumps = self._made[:2, -1], []
        if self._feasible is not None:
            self._feasible.begin_anew()

    def able(self, path: Array) -> bool:
        """Whether a path from the start on keeps to the limits, in all rigs.

        Args:
            path: Position, velocity, acceleration, shape (3, K, ..., 2).
        """
        if self._feasible is None:
            return True
        return bool(self._feasible.within(np.concatenate((self._before[:, None], path), 1)).all())

    def along(self, count: int) -> Array:
        """The path so many control periods on from the start, shape (3, count, ..., 2)."""
        path = []
        for _ in range(0, count, self.count):
            self.ask()
            self.go_on()
            path.append(self.window[:, : self.count])
        return np.concatenate(path, axis=1)[:, :count]

    def go_on(self) -> None:
        """Go on by a slice, along what plate and ball can do of what was asked for."""
        passed, made = self._made[:, : self.count], self._made[:, self.count :]
        while made.shape[1] < self.length:
            slice_ = self._asked[:, : self.count]
            if self._feasible is not None:
                last = made if made.shape[1] else passed
                before = last[:, -1] if last.shape[1] else self._before
                slice_ = self._feasible.follow(before, self._asked, self._kept)
                self._kept = self._kept[self.count :]
            made = np.concatenate((made, slice_), axis=1)
            self._asked = self._asked[:, self.count :]
        self._made, self.window = made, made[:, : self.length]
        self._begun += self.count

    def _spread_jumps(self, r: Array, times: Array) -> None:
        """Spread the jumps of what was asked for last, shape (3, K, ..., 2), in place."""
        T, count, begin = self._period, len(times), int(self._known == self.first)
        position, velocity = np.concatenate((self._last[:, None], r[:2]), axis=1)
        self._last = r[:2, -1].copy()
        way = position[1:] - position[:-1]
        way[begin:] -= T / 2 * (velocity[begin + 1 :] + velocity[begin:-1])
        far = (np.abs(way) > MIN_JUMP_M).any(axis=-1, keepdims=True)
        if far.any():
            way = np.where(far, way, 0.0)  # what is no jump of this rig's is none beside another's
            for i in np.flatnonzero(far.reshape(count, -1).any(axis=1)).tolist():
                length = np.hypot(way[i, ..., :1], way[i, ..., 1:])
                duration = np.maximum(self._spread * np.sqrt(length / REFERENCE_JUMP_M), T)
                self._jumps.append(_Jump(float(times[i]), way[i], duration))
        for jump in self._jumps:
            r += _remaining_jump(times - jump.time, jump)
        ended = times[-1]
        self._jumps = [each for each in self._jumps if each.time + each.duration.max() > ended]


def _remaining_jump(time: Array, jump: _Jump) -> Array:
    """What is left of a spread jump some time after it: 0 before, then from the whole to nothing.

    Args:
        time: Since the jump, s, shape (K,).
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
    """What laws that follow a motion (r, a*) of ball and plate have in common.

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
    """How far the reference is asked ahead, s; 0 for not at all. To see what the plate can give it
    is asked 1.2 s further."""
    spread: NotNegative = 1.3
    """Time in s over which a jump of 0.15 m is spread, others by the root of their length; 0 leaves
    jumps as they are."""
    slope: NotNegative = 0.12
    """Slope of the plate in rad that the path may ask for, less than a rig allows: friction and
    feedback need the rest. 0 for whatever it takes."""
    slope_rate: NotNegative = 0.8
    """Rate of that slope in rad/s; 0 for whatever it takes."""

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
            feasible: Whether it keeps to what the plate can give.
            time: Of the start in s.
        """
        limits = self.model.k1 * self.slope, self.model.k1 * self.slope_rate
        bounds = limits if feasible and all(limits) else None
        start, moving = (
            x[..., 0::4],
            np.stack((x[..., 1::4], self.model.k1 * TILT_SIGN * x[..., 2::4])),
        )
        first = round(time / period)
        return Preview(reference, start, period, self.preview, self.spread, bounds, moving, first)

    def laid(
        self, x: Array, reference: Reference, period: float, count: int, time: float = 0.0
    ) -> Array:
        """The path laid where the plate cannot give what is wished, m, (count, 2); NaN elsewhere.

        Args:
            x: State at the start, shape (8,).
            reference: Path of the ball.
            period: Control period in s.
            count: Control periods from the start on.
            time: Of the start in s.
        """
        ahead = self.ahead(x, reference, period, time=time)
        further = math.ceil((self.preview + SHAPING_HORIZON_S) / period)
        wished = self.ahead(x, reference, period, feasible=False, time=time).along(count + further)
        if ahead.able(wished):
            return np.full((count, 2), np.nan)
        laid = ahead.along(count)[0]
        away = np.hypot(*(laid - wished[0, :count]).T)
        return np.where(away[:, None] > MIN_PATH_DIFFERENCE_M, laid, np.nan)

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """The same without a plan: the flat model's slope."""
        r = reference(t)
        k1 = self.model.k1
        return self.about(x, r[0], r[1], Tilts(r[2] / k1, r[3] / k1, r[4] / k1))

    def about(self, x: Array, position: Array, velocity: Array, wanted: Tilts) -> Array:
        """Feedback about a motion, rad/s^2, shape (..., 2)."""
        axis = x[..., 0::4], x[..., 1::4], TILT_SIGN * x[..., 2::4], TILT_SIGN * x[..., 3::4]
        K = (*self.K[:3], self.K[3:].sum())  # of a plate that is as fast as it is told
        return TILT_SIGN * self._about(K, axis, (position, velocity), wanted)

    def _about(
        self, K: Sequence[float] | Array, axis: Sequence[Any], path: Sequence[Any], wanted: Tilts
    ) -> Any:
        """Acceleration of the slope, rad/s^2, about a motion.

        Args:
            K: The gain.
            axis: Position and velocity of the ball, slope and its rate.
            path: Position and velocity that are wished.
            wanted: The slope that is wished.
        """
        (x, v, angle, angle_rate), (position, velocity), c2 = axis, path, self.model.c2
        slope, rate = angle - wanted.angle, angle_rate - wanted.rate
        eta, eta_rate = x - position + c2 * slope, v - velocity + c2 * rate
        pull = self._pull(eta, eta_rate)
        return wanted.acceleration - K[0] * pull - K[1] * eta_rate - K[2] * slope - K[3] * rate

    def _pull(self, eta: Any, rate: Any) -> Any:
        """What of the error of eta in m is fed back, from it and its rate in m/s."""
        return eta


def flat_axis(model: BallPlate) -> tuple[Array, Array]:
    """A, shape (4, 4), and B, shape (4, 1), of (eta, eta', a, a') under a''."""
    A, B = np.eye(4, k=1), np.eye(4)[:, 3:]
    A[1, 2] = model.k1
    return A, B


PUSHED_ERROR_M = 0.025
"""Error of eta in m from which on a ball has been pushed: no start on a path has as much."""
MAX_GROWING_ERROR_M, MAX_FED_BACK_ERROR_M = 0.01, 0.05
"""Errors of eta in m that are fed back at most: of a larger one than ``FAR`` that grows, of any."""


def beyond(square: Any, speed: float) -> Any:
    """From 0 at rest to 1 where the square of a speed, in (m/s)^2, is far beyond another one."""
    share = square / speed**2
    return share * share / (1 + share * share)


@dataclass(frozen=True, kw_only=True)
class StableInversion(AboutMotion):
    """Follows a motion of ball and plate that makes the ball itself follow the reference.

    With the slopes a = (phi, -theta), either axis is x'' = (1 + kappa) k1 a - c2 a'' + d - F h
    with friction F along the heading h, or eta'' = (1 + kappa) k1 a + d - F h with the flat output
    eta = x + c2 a. The slope that makes x follow r is the bounded solution (``TwoSided``) of

        a* - a*'' / Z^2 = (r'' + F h(r') - d) / k1,    Z^2 = k1 / c2,

    divided by 1 + kappa. It begins before what causes it, so the reference is asked ahead. F, d and
    kappa come from the observer, h(v) = v / sqrt(|v|^2 + vs^2). On a plate with a camber c, d
    changes by c r' as the ball goes on, and so do rate and acceleration of the slope. About it the
    law is

        a'' = a*'' - K (eta - r - c2 a*, eta' - r' - c2 a*', a - a*, a' - a*')

    with K of the linear-quadratic regulator of eta'' = k1 a. Jumps of the reference are spread.

    Drives with a lag T, told (``BallPlate.lag``) or found by the observer, turn the plate at a rate
    a' that follows the commanded one w, a'' = (w - a') / T. The regulator is then that of
    (eta, eta', a, a', w) under w', about w* = a*' + T a*''. A lag that is found counts while the
    ball is to move: where it is to rest it may stick, and comes free sooner on a plate that swings
    in the play of its drives, as it does where the lag is left out.

    A ball that was pushed is braked first and brought back then. Of an error of eta that grows
    beyond ``FAR`` no more than ``LEAVING`` is fed back: the slope that the rest would ask for comes
    too late to stop the ball, and moves it outwards as it comes. Of one that shrinks it is
    ``RETURNING`` at most: a ball that is drawn back harder is too fast for a plate that turns at
    a limited rate, and leaves on the other side.

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
    uneven friction and a ball that sticks ask for a stiff feedback; noise, effort and play of the
    drives for a soft one."""
    Q_slow: tuple[NotNegative, NotNegative, NotNegative, NotNegative] | None = None
    """Those weights where the ball is to be slower than about ``slow_speed`` within the preview: at
    rest, before it, and where it turns back; None for the same. There it may stick, and friction
    changes its sign, which asks for a stiff feedback; a ball that goes on and on asks for a
    heavier rate of the slope, which lets less noise through."""
    slow_speed: Positive = 0.05
    """Least wished speed in m/s about which the weights change."""
    smooth: Positive = 0.006
    """Wished speed vs in m/s over which the friction fed forward changes its sign."""
    resting_speed: NotNegative = 0.015
    """Wished speed in m/s, now and a second on, below which the ball is to be held rather than
    moved: friction is then fed forward along the ball's own heading, there being no other. 0 for
    never."""

    rate_bias: bool = False
    """Whether a law about drives with a lag counts what the observer finds that the plate turns
    faster than they were told: play changes the plate's rate all the time. With ``Q_slow`` only
    while the ball is to go on and on; where it turns back the bias comes late."""

    _slow: StableInversion | None = field(init=False, repr=False, compare=False, default=None)
    """The same with those weights."""
    _cubic: Sequence[tuple[float, ...]] = field(init=False, repr=False, compare=False, default=())
    """Coefficients of the gain as a cubic of the lag in s, constant first, if none is told."""

    def _gain(self) -> Array:
        """K, shape (4,); for drives with a lag (5,)."""
        if self.Q_slow:
            object.__setattr__(self, "_slow", replace(self, Q=self.Q_slow, Q_slow=None))
        if self.model.lag:
            return self._gain_at(self.model.lag)
        K = super()._gain()
        lags = np.linspace(0.0, LONGEST_LAG, 4)
        none = np.array((*K[:3], 0.0, K[3]))  # what it goes to with the lag
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
        """The motion of ball and plate, its first slice laid."""
        return InversePlan(self, x, reference, period)

    def replanned(
        self, plan: InversePlan, t: float, x: Array, reference: Reference, period: float
    ) -> InversePlan:
        """The motion from where the ball is at a time in s."""
        return InversePlan(self, x, reference, period, t)

    def command(self, now: Feedback) -> Array:
        """Plate accelerations in rad/s^2, shape (..., 2), from plan and observer."""
        rows, k1 = now.x.reshape(-1, 8), self.model.k1
        x, (F, lag, *known) = components(rows), components(now.needed.reshape(len(rows), -1))
        camber = known[6:] or (0.0, 0.0)
        motion, planned, fast = now.plan.at(now.time, now.reference), 1.0, 1.0
        if self.resting_speed:
            planned = beyond(motion[0].pace, self.resting_speed)
        K = self._gains_for(lag, planned)
        if self._slow is not None:
            fast = beyond(motion[0].going, self.slow_speed)
            slow = self._slow._gains_for(lag, planned)
            K = [k + fast * (full - k) for k, full in zip(slow, K, strict=True)]
        # a resting ball is better off with a plate that swings in the play of its drives
        lag = self.model.lag or planned * lag
        sqrt, vx, vy, u = (
            (NUMBER_ARITHMETIC if len(rows) == 1 else ARRAY_ARITHMETIC).sqrt,
            x[1],
            x[5],
            [],
        )
        length = sqrt(vx * vx + vy * vy + self.smooth**2)
        for axis, wanted in enumerate(motion):
            d, gain, sign = known[axis], 1 + known[2 + axis], (1.0, -1.0)[axis]
            ball, v, angle, rate = x[4 * axis : 4 * axis + 4]
            free, drag = wanted.free, wanted.drag
            if self.resting_speed:  # as planned, at rest by the ball's own heading
                own = (1 - planned) * v / (length * k1)
                drag = Tilts(planned * drag[0] + own, planned * drag[1], planned * drag[2])
            c = camber[axis]  # d changes as the ball goes on
            slope = Tilts(
                (free.angle + F * drag.angle - d / k1) / gain,
                (free.rate + F * drag.rate - c * wanted.velocity / k1) / gain,
                (free.acceleration + F * drag.acceleration - c * free.angle) / gain,
            )
            seen = ball, v, sign * angle, sign * rate
            asked = self._about(K, seen, (wanted.position, wanted.velocity), slope)
            if len(K) > 4:
                counted = self.rate_bias * fast * known[4 + axis]
                commanded = sign * (numbers(now.rate[..., axis]) + counted)
                jerk = wanted.jerk[0] + F * planned * wanted.jerk[1] - c * free.rate
                jerk = jerk / gain
                ahead = commanded - slope.rate - lag * slope.acceleration
                asked = asked + lag * jerk - K[4] * ahead
            u.append(sign * asked)
        return together(u, len(rows)).reshape(now.rate.shape)

    def _gains_for(self, lag: Any, planned: Any) -> Sequence[Any]:
        """K for drives with a lag in s while the ball is to move, by how much it is planned to."""
        K: Sequence[Any] = self.K.tolist()
        if self.model.lag or not (lag if isinstance(lag, float) else some(lag)):
            return K
        planned, cubic = planned * (lag > 0), zip(*self._cubic, strict=True)
        return [
            k + planned * (a + lag * (b + lag * (c + lag * d)) - k)
            for k, (a, b, c, d) in zip((*K, 0.0), cubic, strict=True)
        ]

    def _pull(self, eta: Any, rate: Any) -> Any:
        """The error of eta within bounds; the same bits where it does not reach them."""
        far = abs(eta) > PUSHED_ERROR_M
        if far is False or not (far is True or some(far)):
            return eta
        most = np.where(far & (eta * rate > 0), MAX_GROWING_ERROR_M, MAX_FED_BACK_ERROR_M)
        return np.minimum(np.maximum(eta, -most), most)


class InverseMotion(NamedTuple):
    """What the ball is to do along one axis, and the slopes that the inverse says it takes.

    Components: numbers for one rig, else arrays (N,).
    """

    position: Any
    """Position of the ball in m."""
    velocity: Any
    """Velocity of the ball in m/s."""
    pace: Any
    """Square of its speed along both, and of what its acceleration adds in a second, (m/s)^2."""
    going: Any
    """Square of its least speed along both from now to the horizon, (m/s)^2."""
    free: Tilts
    """Slopes that it takes without friction, rad."""
    drag: Tilts
    """Slopes that a friction of 1 m/s^2 takes besides, rad per m/s^2."""
    jerk: tuple[Any, Any]
    """Third derivatives of both."""


class InversePlan(Slices):
    """The motion for one run, laid slice by slice.

    Args:
        law: Whose plan.
        x: State at the start, shape (..., 8).
        reference: Path of the ball.
        period: Control period in s.
        time: Of the start in s.
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
        """What is wanted along x and y at a time in s not before the one asked for last.

        Args:
            t: The time.
            reference: The path from now on; as before by default.
        """
        tick = self._tick(t, reference)
        rows = self._laid[tick].reshape(12, -1, 2).transpose(2, 0, 1)
        axes = rows[..., 0].tolist() if rows.shape[2] == 1 else rows.copy()
        return [
            InverseMotion(x, v, pace, going, Tilts(*slopes[:3]), Tilts(*slopes[3:6]), (free, drag))
            for x, v, pace, going, *slopes, free, drag in axes
        ]

    def _parts(self) -> Sequence[Callable[[], None]]:
        return self._preview.ask, self._preview.go_on, self._lay_free, self._lay

    def _lay_free(self) -> None:
        self._free_laid = self._free.lay(self._preview.window[2] / self._law.model.k1)

    def _lay(self) -> None:
        k1, count = self._law.model.k1, self._preview.count
        position, velocity, acceleration = self._preview.window
        square = square_of(velocity)
        pace = square[:count] + square_of(acceleration[:count])
        going = np.broadcast_to(square.min(axis=0), pace.shape)
        speed = np.sqrt(square + self._law.smooth**2)
        drag = self._drag.lay(velocity / (k1 * speed))
        self._next = np.empty((count, 12, *position.shape[1:]))
        jerks = self._free.jerk, self._drag.jerk
        parts = position[:count], velocity[:count], pace, going, *self._free_laid, *drag, *jerks
        for number, each in enumerate(parts):
            self._next[:, number] = each
