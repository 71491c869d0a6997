"""The common part of observers of a rolling ball that compensate the dead time.

The ball moves with friction on a plate with measured angles. Plate angle and rate for
feedback are the commanded ones, corrected slowly by the measured angle. All calculations are by
components: plain numbers for one rig, which is several times faster, and arrays with one entry per
rig for several. Equations (K1) to (K9) are those of ``FrictionKalman``. What the plate and its
drives do is estimated by ``plate_estimates``.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from controllers.arrays import (
    Array,
    Input,
    NotNegative,
    Positive,
    State,
    arithmetic_of,
    components,
    numbers,
    together,
)
from controllers.ballplate import TILT_SIGN, BallPlate
from controllers.interfaces import DelayedObserver, Measurement, algorithm_constants
from controllers.observers.plate_estimates import (
    LAG_NAME,
    LAG_SEARCH,
    SWING_TEST,
    DriveLag,
    LagSearch,
    SlowPlate,
    SwingingPlate,
    SwingTest,
)

MAX_SUBSTEP_S = 0.011
"""Longest time in s over which the friction's heading is constant while a state is carried."""


class Tilt(NamedTuple):
    """The plate at one time, and the motion that it gave to a ball without friction until then."""

    phi: Any
    theta: Any
    phi_rate: Any
    """Commanded rate, rad/s."""
    theta_rate: Any
    """Commanded rate, rad/s."""
    speed_x: Any
    """Integral of b along x since the start, m/s."""
    speed_y: Any
    """Integral of b along y since the start, m/s."""
    way_x: Any
    """Integral of ``speed_x`` since the start, m."""
    way_y: Any
    """Integral of ``speed_y`` since the start, m."""

    def towards(self, other: Tilt, share: float) -> Tilt:
        """Linear interpolation to the plate at a second time."""
        return Tilt(*[a + share * (b - a) for a, b in zip(self, other, strict=True)])


THERE, NOW = 0, 1
"""Indices: the ball at the time of the touch sample, and now."""


class LocalState(NamedTuple):
    """The filter's state with the friction at one place."""

    s: Any
    """Components of s of (K1)."""
    cell: Any = None
    """Cell of that place in a map of the friction, if there is one."""


class Derivatives(NamedTuple):
    """Derivatives of the velocity (eta_x', eta_y') after a period, for A of (K4)."""

    slope: tuple[Any, Any, Any]
    """Derivatives by the velocity, less the identity: xx, xy = yx, yy."""
    friction: tuple[Any, Any]
    """Derivatives by the friction, s."""
    gain: tuple[Any, Any]
    """Derivatives by the tilt gain, m/s."""


class RollingBall:
    """The plate's motion over a dead time, and the ball's motion by it.

    States are (eta_x, eta_y, eta_x', eta_y', d_x, d_y, kappa_x, kappa_y, F) as components, s of
    (K1).

    Args:
        model: The ball.
        smooth: Speed vs over which friction changes its sign, m/s.
        period: Control period in s.
        delay: Dead time in s.
        x: Initial ``State``, shape (N, 8).
    """

    def __init__(
        self, model: BallPlate, smooth: float, period: float, delay: float, x: State
    ) -> None:
        self._model, self._smooth, self._period = model, smooth * smooth, period
        by = arithmetic_of(x)
        self._sqrt, self._sin, self._cos = by.sqrt, by.sin, by.cos
        self._back = math.floor(delay / period + 1e-9)
        self._share = delay / period - self._back
        if self._share < 1e-9:
            self._share = 0.0
        count = math.ceil(delay / MAX_SUBSTEP_S)
        self._marks = [round(self._back * (count - 1 - i) / count) for i in range(count)]
        ends = [self._back + self._share, *self._marks]
        self._steps = [period * (a - b) for a, b in zip(ends, self._marks, strict=False)]
        state = components(x)
        _, _, phi, phi_rate, _, _, theta, theta_rate = state
        none = 0.0 * phi
        self._free = self._accelerated((phi, theta), (phi_rate, theta_rate), none, state)
        now = Tilt(phi, theta, phi_rate, theta_rate, none, none, none, none)
        # before the start the plate has not moved, and the ball was at rest
        self._past = deque([now] * (self._back + 2), maxlen=self._back + 2)
        self.then = now
        """The plate a dead time ago."""

    def measured(self, angle: Any, rate: Any, state: Any) -> tuple[Tilt, Tilt]:
        """Store the present plate; the plate a period before a dead time ago, and a dead time ago.

        Args:
            angle: Measured angles (phi, theta), rad.
            rate: Commanded rates (phi', theta'), rad/s.
            state: Components of the previous estimate of the ``State``, for terms of second order.
        """
        T, (ax, ay), last = self._period, self._free, self._past[-1]
        u2 = (rate[1] - last.theta_rate) / T
        free = bx, by = self._accelerated(angle, rate, u2, state)
        half, sixth = T / 2, T * T / 6
        self._free = free
        self._past.append(
            Tilt(
                angle[0],
                angle[1],
                rate[0],
                rate[1],
                last.speed_x + half * (ax + bx),
                last.speed_y + half * (ay + by),
                last.way_x + T * last.speed_x + sixth * (2 * ax + bx),
                last.way_y + T * last.speed_y + sixth * (2 * ay + by),
            )
        )
        begin, then = self.then, self._past[-1 - self._back]
        if self._share:
            then = then.towards(self._past[-2 - self._back], self._share)
        self.then = then
        return begin, then

    def _accelerated(self, angle: Any, rate: Any, u2: Any, state: Any) -> tuple[Any, Any]:
        """Acceleration b of eta without friction and disturbance, m/s^2, (5.9)."""
        model, (phi, theta), (wy, w8) = self._model, angle, rate
        x1, x2, _, _, x5, x6, _, _ = state
        s3, c3 = self._sin(phi), self._cos(phi)
        wx, wz = w8 * c3, w8 * s3
        along = x1 * (wz * wz + wy * wy) - model.d * wx * wz + 2 * x6 * wz + x5 * s3 * u2
        across = x5 * w8 * w8 - wy * (model.c3 * wz + 2 * x1 * wx) - 2 * x2 * wz - x1 * s3 * u2
        return (
            model.c1 * along + model.k1 * s3 * self._cos(theta),
            model.c1 * across - model.k1 * self._sin(theta) + model.c2 * (c3 - 1) * u2,
        )

    def velocity(self, s: Any, tilt: Tilt) -> tuple[Any, Any]:
        """Velocity v of the ball on the plate, m/s, (K1)."""
        c2 = self._model.c2
        return s[2] - c2 * tilt.phi_rate, s[3] + c2 * tilt.theta_rate

    def position(self, s: Any, tilt: Tilt) -> tuple[Any, Any]:
        """Position r of the ball on the plate, m, (K1)."""
        c2 = self._model.c2
        return s[0] - c2 * tilt.phi, s[1] + c2 * tilt.theta

    def _heading(self, vx: Any, vy: Any) -> tuple[Any, Any, Any]:
        """Heading h of (K1) along x and y, and the length l in m/s."""
        length = self._sqrt(vx * vx + vy * vy + self._smooth)
        return vx / length, vy / length, length

    def step(self, s: Any, begin: Tilt, then: Tilt) -> tuple[list[Any], Derivatives]:
        """The state after a period by (K3), and derivatives of it.

        Args:
            s: Components of the state.
            begin: The plate at the time of the state.
            then: The plate a period later.
        """
        T = self._period
        ex, ey, vx, vy, dx, dy, kx, ky, F = s
        hx, hy, length = self._heading(*self.velocity(s, begin))
        ax, ay = dx - F * hx, dy - F * hy
        sx, sy = then.speed_x - begin.speed_x, then.speed_y - begin.speed_y
        wx = then.way_x - begin.way_x - T * begin.speed_x
        wy = then.way_y - begin.way_y - T * begin.speed_y
        half = T * T / 2
        # the next state by (K3)
        after = [
            ex + T * vx + (1 + kx) * wx + half * ax,
            ey + T * vy + (1 + ky) * wy + half * ay,
            vx + (1 + kx) * sx + T * ax,
            vy + (1 + ky) * sy + T * ay,
            *s[4:],
        ]
        # (K4): -T d(F h)/dv, and the derivatives by F and kappa
        stiff = T * F / length
        slope = stiff * (hx * hx - 1), stiff * hx * hy, stiff * (hy * hy - 1)
        return after, Derivatives(slope, (-T * hx, -T * hy), (sx, sy))

    def carry(self, s: Any) -> tuple[Any, Any, Any, Any]:
        """Present eta and eta' from the filter's state a dead time ago, by (K3) in a few steps."""
        ex, ey, vx, vy, dx, dy, kx, ky, F = s
        kx, ky, c2, heading = 1 + kx, 1 + ky, self._model.c2, self._heading
        _, _, wy, w8, begun_x, begun_y, gone_x, gone_y = self.then
        for mark, h in zip(self._marks, self._steps, strict=True):
            hx, hy, _ = heading(vx - c2 * wy, vy + c2 * w8)
            _, _, wy, w8, speed_x, speed_y, way_x, way_y = self._past[-1 - mark]
            sx, sy = kx * (speed_x - begun_x), ky * (speed_y - begun_y)
            # friction along the heading in the middle of the step
            mx = vx + (sx + h * (dx - F * hx)) / 2
            my = vy + (sy + h * (dy - F * hy)) / 2
            hx, hy, _ = heading(mx - c2 * wy, my + c2 * w8)
            ax, ay = dx - F * hx, dy - F * hy
            ex = ex + h * vx + kx * (way_x - gone_x - h * begun_x) + h * h / 2 * ax
            ey = ey + h * vy + ky * (way_y - gone_y - h * begun_y) + h * h / 2 * ay
            vx, vy = vx + sx + h * ax, vy + sy + h * ay
            begun_x, begun_y, gone_x, gone_y = speed_x, speed_y, way_x, way_y
        return ex, ey, vx, vy

    def equivalent(self, s: Any, state: Any) -> tuple[Any, Any, Any, Any]:
        """(phi, phi', theta, theta') that give a ball without friction the same motion, (K9).

        Args:
            s: The filter's state.
            state: Components of the present ``State``.
        """
        _, vx, phi, phi_rate, _, vy, theta, theta_rate = state
        _, _, _, _, dx, dy, kx, ky, F = s
        k1 = self._model.k1
        hx, hy, length = self._heading(vx, vy)
        phi = (1 + kx) * phi + (dx - F * hx) / k1
        theta = (1 + ky) * theta - (dy - F * hy) / k1
        along = hx * phi - hy * theta
        turn = F / length
        return (
            phi,
            phi_rate - turn * (phi - hx * along),
            theta,
            theta_rate - turn * (theta + hy * along),
        )


@dataclass(kw_only=True)
class LateBall(DelayedObserver):
    """A filter of the flat output that runs at the time of the touch sample, t - delay.

    Its states are those of ``RollingBall``. It is driven by the plate angles of that time, and its
    estimate is carried to t with the angles measured since. A frame of the screen is used once,
    when it is new, with its age. A law receives the plate's angle and rate as a slow estimate from
    the commanded rate and the encoders. An estimated lag of the drives is part of it only for a law
    that needs the lag: the others, made for drives that follow at once, lose more by it on a line
    and at rest than they gain on a circle.

    Raises:
        ValueError: If a setting is not finite or has the wrong sign.
    """

    plate_pole: Positive = 10.0
    """Both poles of the plate's estimate, as a rate in 1/s."""
    swinging_pole: NotNegative = 0.0
    """The same poles, as a rate in 1/s, once the plate swings on a soft drive train; 0 for no
    change."""
    screen_deg: float = 0.0
    """Measured angle in deg by which the screen is turned on the plate: samples are turned back by
    it. It cannot be estimated while the ball goes round at one speed."""
    plate: Literal["measured", "modelled"] = "measured"
    """Whether its angles are measured; modelled ones, for a rig without encoders, are the commanded
    ones, followed by drives with the known lag."""

    swing_test: SwingTest = algorithm_constants(SWING_TEST)
    """Limits of the detection of a plate that swings."""
    lag_search: LagSearch = algorithm_constants(LAG_SEARCH)
    """Constants of the estimate of the drives' lag."""

    def _begin_at(self, x: State, smooth: float, friction: float) -> None:
        """Begin at the state x, shape (..., 8), on a plate that has not moved before.

        Args:
            x: The state.
            smooth: Speed vs over which friction changes its sign, m/s.
            friction: Initial friction F, m/s^2.
        """
        super().start(x)
        self._shape = self.x.shape[:-1]
        rows = self.x.reshape(-1, 8)
        self._rigs = len(rows)
        self._by = arithmetic_of(rows)
        self._ball = RollingBall(self.model, smooth, self.period, self.delay, rows)
        self._state = state = components(rows)
        about = self.plate_pole, self.period, self.model.lag
        self._plates = [SlowPlate(*about, *state[k : k + 2]) for k in (2, 6)]
        known = self.model.lag or self.plate == "modelled" or LAG_NAME not in dict(self.knows)
        turn = math.radians(self.screen_deg)
        self._turned = math.cos(turn), math.sin(turn)
        self._drives = None if known else DriveLag(self.period, state, self._by, self.lag_search)
        self._swing = SwingingPlate(self.period, 0.0 * state[2], self._by, self.swing_test)
        c2 = self.model.c2
        s = np.zeros_like(rows, shape=(self._rigs, 9))
        s[:, 0:2] = rows[:, 0::4] + c2 * TILT_SIGN * rows[:, 2::4]
        s[:, 2:4] = rows[:, 1::4] + c2 * TILT_SIGN * rows[:, 3::4]
        s[:, 8] = friction
        self._s: Any = components(s)
        self._age: Any = numbers(np.full(self._rigs, np.inf))
        self._there = self._now = LocalState(self._s)

    def correct(self, measurement: Measurement) -> State:
        """The estimate from present plate angles and a ball position of a dead time ago."""
        x, phi, y, theta = components(measurement.y.reshape(-1, 4))
        if self.screen_deg:
            cos, sin = self._turned
            x, y = cos * x - sin * y, cos * y + sin * x
        along, across = self._plates
        if self.plate == "modelled":
            phi, theta = along.angle, across.angle
        measured = phi, theta
        phi, phi_rate = along.correct(phi)
        theta, theta_rate = across.correct(theta)
        if self.swinging_pole and self._swing.correct((along.error, across.error)):
            pole = self._by.where(self._swing.found, self.swinging_pole, self.plate_pole)
            along.set_pole(pole)
            across.set_pole(pole)
            if self._drives is not None:
                self._drives.give_up(self._swing.found)
        commanded = along.commanded, across.commanded
        if self._drives is not None:
            self._drives.correct(measured)
            along.left = across.left = self._drives.left if LAG_NAME in self.needed else 0.0
        begin, then = self._ball.measured(measured, commanded, self._state)
        self._advance(begin, then)
        age, touched = numbers(measurement.age), numbers(measurement.touched)
        new = touched & (age < self._age + self.period / 2)
        self._age = age
        if self._by.any(new):
            self._take((x, y), age, new, then)
        self._there = self._at(self._ball.position(self._s, then), THERE)
        ex, ey, vx, vy = self._ball.carry(self._there.s)
        c2 = self.model.c2
        self._state = (
            ex - c2 * phi,
            vx - c2 * phi_rate,
            phi,
            phi_rate,
            ey + c2 * theta,
            vy + c2 * theta_rate,
            theta,
            theta_rate,
        )
        self._now = self._at(self._state[0::4], NOW)
        self.x = together(self._state, self._rigs).reshape(*self._shape, 8)
        return self.x

    def predict(self, u: Input) -> None:
        """Predict the plate by one period; the ball follows when the plate is measured."""
        for plate, acceleration in zip(self._plates, components(u.reshape(-1, 2)), strict=True):
            plate.predict(acceleration)
        if self._drives is not None:
            self._drives.predict([plate.requested for plate in self._plates])

    @property
    def _lag(self) -> Any:
        """Lag of the drives in s, given or estimated."""
        return self.model.lag if self._drives is None else self._drives.lag

    def _at(self, place: Sequence[Any], which: int) -> LocalState:
        """The filter's state with the friction at a place (x, y) in m: the same by default.

        Args:
            place: Position of the ball at the time of the touch sample, or now.
            which: ``THERE`` or ``NOW``.
        """
        return LocalState(self._s)

    @abstractmethod
    def _advance(self, begin: Tilt, then: Tilt) -> None:
        """One period of the filter, from one touch sample's time to the next."""

    @abstractmethod
    def _take(self, seen: tuple[Any, Any], age: Any, new: Any, then: Tilt) -> None:
        """Correct by a touch sample that is new in some rig.

        Args:
            seen: Measured position (x, y) of the ball, m.
            age: Time in s since its arrival.
            new: Whether it is new, for each rig.
            then: The plate a dead time ago.
        """

    @property
    def s(self) -> Array:
        """The filter's state at the touch sample's time, shape (..., 9)."""
        return together(self._s, self._rigs).reshape(*self._shape, 9)

    @property
    def equivalent(self) -> State:
        """The estimate with friction and disturbance in the plate's angles, shape (..., 8)."""
        x, vx, *_, y, vy, _, _ = self._state
        phi, phi_rate, theta, theta_rate = self._ball.equivalent(self._now.s, self._state)
        found = (x, vx, phi, phi_rate, y, vy, theta, theta_rate)
        return together(found, self._rigs).reshape(self.x.shape)
