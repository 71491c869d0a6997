"""Laws about a motion of ball and plate that makes the ball follow a reference.

The reference is sampled in advance, slice by slice. Its jumps are spread, and it is replaced by the
nearest path that the plate can produce. The plate's motion is the stable inverse of a plant that
first moves the wrong way; friction is fed forward, and the feedback about the motion is
linear-quadratic.
"""

from __future__ import annotations

import math
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
    NotNegative,
    Positive,
    arithmetic_of,
    components,
    numbers,
    square_of,
    together,
)
from controllers.ballplate import LONGEST_LAG, TILT_SIGN, BallPlate
from controllers.feasible_path import PATH_SHAPING, PathShaping
from controllers.interfaces import Feedback, Law, Reference, algorithm_constants
from controllers.preview import JUMP_SPREADING, SLICING, JumpSpreading, Preview, Slices, Slicing
from controllers.two_sided import Tilts, inverse


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


PUSH_RESPONSE = PushResponse()


class DesiredMotion(NamedTuple):
    """The desired motion of ball and plate at one tick."""

    position: Array
    """Position of the ball in m, shape (..., 2)."""
    velocity: Array
    """Velocity of the ball in m/s, shape (..., 2)."""
    slope: Tilts
    """Tilt of the plate along x and y, (phi, -theta), in rad."""


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
