"""Kalman filter on the flat output that estimates friction, disturbance and tilt gain as well."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from controllers.arrays import Array, Mask, every, some
from controllers.interfaces import Measurement, Quantity
from controllers.observers.kalman import NOISE
from controllers.observers.late_ball import LateBall
from controllers.observers.rolling_ball import Derivatives, Tilt, components, together
from controllers.ranges import Positive

KNOWN = (
    Quantity("friction", "m/s^2"),
    Quantity("disturbance_x", "m/s^2"),
    Quantity("disturbance_y", "m/s^2"),
    Quantity("tilt_gain_x", "1"),
    Quantity("tilt_gain_y", "1"),
    Quantity("friction_spread", "m/s^2"),
    Quantity("tilt_gain_x_spread", "1"),
    Quantity("tilt_gain_y_spread", "1"),
)
"""What the filter knows beyond the state; tilt gains are errors, spreads standard deviations."""
F = 8
"""Where the friction stands in the filter's state."""
DISTURBANCE = [4, 5]
"""Where the disturbance along x and y stands there."""
LEARNT = slice(6, None)
"""Tilt gain and friction, which are learnt in motion alone."""
RESTING = 0.004
"""Speed in m/s at which a ball counts as resting by a quarter: what noise leaves of rest."""
LARGEST_GAIN = 0.2
"""Bound of the error of the tilt gain."""


@dataclass(kw_only=True)
class FrictionKalman(LateBall):
    """Extended Kalman filter of a ball with rolling friction, driven by the measured plate angle.

    The plate's acceleration drops out of the motion of the flat output eta = (x + c2 phi,
    y - c2 theta), so that only the measured angle enters, whatever lies between command and plate:

        eta'' = (1 + kappa) k1 (sin phi cos theta, -sin theta) + n + d - F v / sqrt(|v|^2 + vs^2)

    with the ball's velocity v, the remaining terms n of the exact model (5.9), a disturbance d
    (level, unevenness), one friction F against the velocity, and an error kappa of the tilt gain
    of either axis. Its nine states are eta, eta', d, kappa and F, the last three as random walks. F
    and kappa are learnt above ``learning_speed`` only: learnt while the ball sticks, F runs away.

    The filter runs at the time of the touch sample, t - delay, with the plate angles of then, and
    its estimate is carried to t with the angles measured since, so it needs no predictor. A frame
    of the screen is taken once, when it is new, and as old as it is.

    A law is given the plate's angle and rate as a slow estimate from the commanded rate and the
    encoders (``SlowPlate``): slower than the plate's resonances at 13 and 19 Hz, but fast enough
    to see a plate that stands still in the play of its drive. The ``equivalent`` angles have
    friction and disturbance in them,

        phi_eq = (1 + kappa) phi + (d - F v / |v|) / k1,

    so that a law made for x'' = k1 sin(phi) meets the plant it was designed on.

    Raises:
        ValueError: If a setting is not finite or has the wrong sign.
    """

    name: ClassVar[str] = "friction_kalman"
    knows: ClassVar[tuple[Quantity, ...]] = KNOWN

    believed_mm: Positive = 0.18
    """Rolling resistance arm in mm that is believed at the start."""
    plate_pole: Positive = 30.0
    """Both poles of the plate's estimate, as a rate in 1/s."""
    smooth: Positive = 0.005
    """Speed vs in m/s over which the friction changes its sign."""
    learning_speed: Positive = 0.02
    """Speed in m/s above which friction and tilt gain are learnt."""
    walk: tuple[Positive, Positive, Positive, Positive] = (0.01, 0.02, 0.005, 0.0005)
    """Random walks of velocity (m/s), disturbance (m/s^2), friction (m/s^2), and tilt gain, each
    as standard deviation after a second."""
    resting_walk: Positive | None = None
    """Random walk of the disturbance while the ball rests, alike: its friction may then be anything
    up to the breakaway. None for the same as in motion."""
    spread: tuple[Positive, Positive, Positive] = (0.03, 0.03, 0.02)
    """Standard deviations at the start of disturbance (m/s^2), friction (m/s^2) and tilt gain."""
    R: tuple[Positive, Positive] = (NOISE[0], NOISE[2])
    """Variances of a touch sample of x and y in m^2; Table B.1."""
    most_friction: Positive = 3.0
    """Largest friction estimated, as a multiple of the one believed at the start."""

    innovation: Array = field(init=False, repr=False)
    """Last innovation in m, shape (..., 2); NaN where no new sample was taken."""
    innovation_variance: Array = field(init=False, repr=False)
    """What the filter takes for its variance, m^2, shape (..., 2)."""

    def __post_init__(self) -> None:
        """Check the settings."""
        super().__post_init__()
        model, T = self.model, self.period
        self._F = model.c1 * self.believed_mm / 1000 / model.radius * model.gravity
        velocity, disturbance, friction, gain = np.square(self.walk) * T
        self._Q = np.append(np.repeat((0.0, velocity, disturbance, gain), 2), friction)
        self._at_rest = 0.0
        if self.resting_walk is not None:
            self._at_rest = self.resting_walk**2 * T - disturbance
        d, F0, kappa = np.square(self.spread)
        self._begin = np.diag([*self.R, 1e-6, 1e-6, d, d, kappa, kappa, F0])
        self._A = np.eye(9)
        self._A[[0, 1], [2, 3]] = self._A[[2, 3], [4, 5]] = T
        self._diagonal = np.arange(9)

    def start(self, x: Array) -> None:
        """Begin at the state x, shape (..., 8), on a plate that has been as it is all the time."""
        self._begin_at(x, self.smooth, self._F)
        self._P = np.tile(self._begin, (self._rigs, 1, 1))
        self.innovation = np.full((self._rigs, 2), np.nan)
        self.innovation_variance = self.innovation.copy()

    @property
    def P(self) -> Array:
        """Covariance of eta, eta', d, kappa, F at the touch sample's time, shape (..., 9, 9)."""
        return self._P.reshape(*self._shape, *self._P.shape[1:]).copy()

    @property
    def further(self) -> Array:
        """Friction, disturbance, tilt gain and their spreads as ``KNOWN``, shape (..., 8)."""
        _, _, _, _, dx, dy, kx, ky, friction = self._s
        sqrt, P = self._by.sqrt, components(self._P[:, (F, 6, 7), (F, 6, 7)])
        found = together((friction, dx, dy, kx, ky, *map(sqrt, P)), self._rigs)
        return found.reshape(*self._shape, len(KNOWN))

    def _advance(self, begin: Tilt, then: Tilt) -> None:
        """One period of the filter, from one touch sample's time to the next."""
        s = self._at(self._ball.position(self._s, begin))
        s, step = self._ball.step(s, begin, then)
        self._s = [*s[:F], self._s[F]]
        A = np.empty((self._rigs, 9, 9))
        A[:] = self._A
        xx, xy, yy = step.slope
        A[:, 2, 2], A[:, 2, 3], A[:, 3, 2], A[:, 3, 3] = 1 + xx, xy, xy, 1 + yy
        A[:, 2, F], A[:, 3, F] = step.friction
        A[:, 2, 6], A[:, 3, 7] = step.gain
        self._P = P = self._propagated(A, step)
        P[:, self._diagonal, self._diagonal] += self._Q
        if self._at_rest:
            vx, vy = self._ball.velocity(self._s, then)
            rest = 1 / (1 + (vx * vx + vy * vy) / RESTING**2) ** 2
            P[:, DISTURBANCE, DISTURBANCE] += np.reshape(rest * self._at_rest, (-1, 1))

    def _propagated(self, A: Array, step: Derivatives) -> Array:
        """Covariance a period on, from what the period does to the nine states."""
        P: Array = A @ self._P @ A.swapaxes(1, 2)
        return P

    def correct(self, measurement: Measurement) -> Array:
        """Take in plate angles of now and a ball position of a dead time ago."""
        self.innovation = np.full((self._rigs, 2), np.nan)
        self.innovation_variance = np.full((self._rigs, 2), np.nan)
        return super().correct(measurement)

    def _take(self, y: Array, age: Array, new: Mask, then: Tilt) -> None:
        """Correct by a touch sample, axis by axis."""
        aged, whole = some(age), every(new)
        vx, vy = self._ball.velocity(self._s, then)
        moving = np.reshape(vx * vx + vy * vy > self.learning_speed**2, -1)
        for axis in range(2):
            h = np.reshape(self._ball.position(self._s, then)[axis], -1)
            P = self._P
            hP = P[:, axis]
            variance = hP[:, axis]
            if aged:
                # the ball was there an age ago: less the way since
                h = h - age * np.reshape(self._ball.velocity(self._s, then)[axis], -1)
                hP = hP - age[:, None] * P[:, 2 + axis]
                variance = hP[:, axis] - age * hP[:, 2 + axis]
            e, S = y[:, 2 * axis] - h, variance + self.R[axis]
            gain = hP / S[:, None]
            if not whole:
                gain = np.where(new[:, None], gain, 0.0)
            self._reduce(gain, hP, moving)
            if not every(moving):
                gain[~moving, LEARNT] = 0.0
            self._correct_by(gain * e[:, None])
            self.innovation[:, axis] = np.where(new, e, np.nan)
            self.innovation_variance[:, axis] = S
        least, most = self._by.least, self._by.most
        *_, kx, ky, friction = self._s
        self._s[6] = least(most(kx, -LARGEST_GAIN), LARGEST_GAIN)
        self._s[7] = least(most(ky, -LARGEST_GAIN), LARGEST_GAIN)
        self._s[F] = least(most(friction, 0.0), self.most_friction * self._F)

    def _reduce(self, gain: Array, hP: Array, moving: Mask) -> None:
        """Take from the covariance what a touch sample tells; nothing of F and kappa at rest."""
        fall = gain[:, :, None] * hP[:, None, :]
        if not every(moving):
            fall[~moving, LEARNT, LEARNT] = 0.0
        self._P = self._P - fall

    def _correct_by(self, change: Array) -> None:
        """Add to the estimate what a touch sample says of it, shape (N, 9)."""
        self._s = [a + b for a, b in zip(self._s, components(change), strict=True)]
