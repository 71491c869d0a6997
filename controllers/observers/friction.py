"""A Kalman filter on the flat output that estimates friction and tilt gain as well."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from controllers.arrays import Array, Positive, State, column, components, together
from controllers.interfaces import Quantity, algorithm_constants, with_entries
from controllers.observers.disturbance import DisturbanceObserver
from controllers.observers.late_ball import LateBall, Tilt
from controllers.observers.plate_estimates import LAG_NAME
from controllers.observers.thesis import NOISE_VARIANCES

KNOWN_QUANTITIES = (
    Quantity("friction", "m/s^2"),
    *DisturbanceObserver.knows,
    *(Quantity(f"tilt_gain_{axis}", "1") for axis in "xy"),
    Quantity("friction_spread", "m/s^2"),
    *(Quantity(f"tilt_gain_{axis}_spread", "1") for axis in "xy"),
    *(Quantity(f"camber_{axis}", "1/s^2") for axis in "xy"),
    *(Quantity(f"plate_bias_{axis}", "rad/s") for axis in "xy"),
    Quantity(LAG_NAME, "s"),
)
"""Quantities of the filter beyond the state: relative errors of the tilt gain, standard deviations
(spreads), the lag of the drives, the plate's rate beyond the commanded one (bias). The camber is
estimated by a filter with a map only."""
FRICTION_INDEX = 8
"""Index of the friction in the filter's state."""
LEARNT_IN_MOTION = slice(6, None)
"""Indices of tilt gain and friction, which are estimated in motion only."""
PENDING_SAMPLES = 16
"""Number of touch samples by which the covariance of a whole map is updated at once; an update for
each of them would pass through all of it."""


@dataclass(frozen=True, kw_only=True)
class RestTest:
    """When a ball counts as resting, and when it has come free.

    Attributes:
        rest_speed_m_s: Speed at which the ball counts as resting by a quarter; noise alone makes
            about as much of a ball at rest.
        free_speed_m_s: Speed at which a ball that rested has come free by a half; more than noise
            makes of a ball at rest.
    """

    rest_speed_m_s: float = 0.004
    free_speed_m_s: float = 0.006


@dataclass(frozen=True, kw_only=True)
class ImpactTest:
    """When an impact on the ball is detected, and what the filter then assumes.

    Two outliers in succession on the same side are an impact. After a single wrong sample the next
    one lies on the other side.

    Attributes:
        outlier_squared_distance: Square of a touch sample's distance from the expected position, in
            standard deviations, above which it is an outlier; noise does so once in 10^8 samples.
        velocity_std_m_s: Standard deviation of the change of the ball's velocity by an impact.
        age_s: Time since the impact when it is detected.
    """

    outlier_squared_distance: float = 36.0
    velocity_std_m_s: float = 0.3
    age_s: float = 0.015


@dataclass(frozen=True, kw_only=True)
class EstimateBounds:
    """Largest magnitudes of estimates.

    Attributes:
        tilt_gain_error: Relative error of the tilt gain.
        camber_per_s2: Camber in 1/s^2, more than any measured plate has. A ball seen later than the
            filter assumes looks like one on a more and more cambered plate.
    """

    tilt_gain_error: float = 0.2
    camber_per_s2: float = 0.8


REST_TEST = RestTest()
IMPACT_TEST = ImpactTest()
ESTIMATE_BOUNDS = EstimateBounds()


@dataclass(kw_only=True)
class FrictionKalman(LateBall):
    """Extended Kalman filter of a ball with rolling friction, driven by the measured plate angle.

    The plate's acceleration drops out of the motion of the flat output eta, so that only the
    measured angle enters, whatever is between command and plate. With b = k1 (sin phi cos theta,
    -sin theta) + n of the exact model (5.9), its integral B over a period T, and the integral C of
    B:

        state      s = (eta, eta', d, kappa, F),  eta = r + c2 q,  r = (x, y),  q = (phi, -theta)
                   v = eta' - c2 q',  h = v / l,  l = sqrt(|v|^2 + vs^2)                     (K1)
        model      eta'' = (1 + kappa) b + d - F h;  eta', d, kappa, F walk randomly         (K2)
        a period   eta  <- eta + T eta' + (1 + kappa) C + T^2 / 2 (d - F h)                  (K3)
                   eta' <- eta' + (1 + kappa) B + T (d - F h)
                   P <- A P A' + Q,  A = d(K3)/ds,  d(F h)/dv = F (1 - h h') / l             (K4)
        a sample   z of age a:  z = r - a v + noise of variance R,  H = (1, -a, 0, 0, 0)     (K5)
                   e = z - (r - a v),  H P H' + R = L L',  W = L^-1 H P                      (K6)
                   s <- s + W' L^-1 e,  P <- P - W' W                                        (K7)
        an impact  P <- P + S^2 M M',  M' = (a, 1, 0, 0, 0)                                  (K8)

    with a disturbance d (level, unevenness), one friction F against the velocity, and a relative
    error kappa of the tilt gain, both d and kappa along either axis. In (K4) eta changes with eta'
    alone: the terms of second order in T are left out. Below ``learning_speed`` (K7) leaves F and
    kappa, with their variances, as they are: estimated while the ball sticks, F diverges. While
    the ball rests, Q and d change by ``resting_walk``, ``keep_at_rest`` and ``forget_rest``. An
    impact is two outliers |L^-1 e|^2 in succession on the same side; S is its standard deviation,
    a in (K8) the time since it (``ImpactTest``).

    ``LateBall`` adds the times. (K3) to (K8) run at the time of the touch sample, t - delay, with
    the plate angles of that time; the estimate is carried to t by (K3) with the angles measured
    since, so no predictor is needed. A frame of the screen is used once, when it is new. A law
    receives the plate's angle and rate as a slow estimate from the commanded rate and the encoders
    (``SlowPlate``): slower than the plate's resonances at 13 and 19 Hz, but fast enough to see a
    plate that rests in the play of its drive. The lag of the drives is estimated, if it is not
    given (``DriveLag``), and counts in the estimate for a law that needs ``plate_lag``. The
    ``equivalent`` angles contain friction and disturbance,

        phi_eq = (1 + kappa) phi + (d - F h) / k1,                                           (K9)

    so that a law made for x'' = k1 sin(phi) meets the plant on which it was designed.

    Raises:
        ValueError: If a setting is not finite or has the wrong sign.
    """

    name: ClassVar[str] = "friction_kalman"
    knows: ClassVar[tuple[Quantity, ...]] = KNOWN_QUANTITIES

    believed_mm: Positive = 0.18
    """Rolling resistance arm in mm that is assumed at the start."""
    plate_pole: Positive = 30.0
    """Both poles of the plate's estimate, as a rate in 1/s."""
    smooth: Positive = 0.005
    """Speed vs in m/s over which the friction changes its sign."""
    learning_speed: Positive = 0.02
    """Speed in m/s above which friction and tilt gain are estimated."""
    walk: tuple[Positive, Positive, Positive, Positive] = (0.01, 0.02, 0.005, 0.0005)
    """Random walks of velocity (m/s), disturbance (m/s^2), friction (m/s^2), and tilt gain, each
    as standard deviation after a second."""
    resting_walk: Positive | None = None
    """Random walk of the disturbance while the ball rests, as a standard deviation after a second:
    its friction may then have any value up to the breakaway. None for the same as in motion."""
    keep_at_rest: bool = False
    """Whether friction and tilt gain keep their variances while the ball rests, when nothing can be
    measured of them, instead of growing by their random walks."""
    forget_rest: Positive | None = None
    """Time constant in s with which the filter, once the ball comes free, removes the part of the
    disturbance that it added while breakaway friction held the ball. None for never."""
    spread: tuple[Positive, Positive, Positive] = (0.03, 0.03, 0.02)
    """Standard deviations at the start of disturbance (m/s^2), friction (m/s^2) and tilt gain."""
    R: tuple[Positive, Positive] = with_entries((NOISE_VARIANCES[0], NOISE_VARIANCES[2]), along_x=1)
    """Variances of a touch sample of x and y in m^2; Table B.1."""
    most_friction: Positive = 3.0
    """Largest estimated friction, as a multiple of the one assumed at the start."""

    rest_test: RestTest = algorithm_constants(REST_TEST)
    """Speeds at which a ball rests and comes free."""
    impact_test: ImpactTest = algorithm_constants(IMPACT_TEST)
    """Limits of the detection of an impact."""
    bounds: EstimateBounds = algorithm_constants(ESTIMATE_BOUNDS)
    """Bounds of tilt gain and camber."""

    def __post_init__(self) -> None:
        """Check the settings."""
        super().__post_init__()
        model, T = self.model, self.period
        self._F = model.c1 * self.believed_mm / 1000 / model.radius * model.gravity
        walks = *self.walk, self.resting_walk or self.walk[1]
        velocity, disturbance, friction, gain, resting = np.square(walks) * T
        self._Q = np.append(np.repeat((0.0, velocity, disturbance, gain), 2), friction)
        self._Q_at_rest = np.append(np.repeat((0.0, 0.0, resting - disturbance, 0.0), 2), 0.0)
        if self.keep_at_rest:
            self._Q_at_rest[LEARNT_IN_MOTION] = -self._Q[LEARNT_IN_MOTION]
        self._at_rest = bool(self._Q_at_rest.any() or self.forget_rest)
        d, F0, kappa = np.square(self.spread)
        self._begin = np.diag([*self.R, 1e-6, 1e-6, d, d, kappa, kappa, F0])

    def start(self, x: State) -> None:
        """Begin at the state x, shape (..., 8), on a plate that has not moved before."""
        self._begin_at(x, self.smooth, self._F)
        self._P = np.tile(self._begin, (self._rigs, 1, 1))
        """Covariance of the nine states with all there are, shape (N, 9, n)."""
        self._A = np.tile(np.eye(4, 9), (self._rigs, 1, 1))
        """Derivatives of eta and eta' after a period by the nine states, shape (N, 4, 9)."""
        for k in range(4):
            self._A[:, k, k + 2] = self.period
        self._far: tuple[Any, Any] = (0.0, 0.0)
        self._rest: Any = 0.0
        """How much the ball rests, from 0 to 1."""
        self._added: Any = components(np.zeros((self._rigs, 2)))
        """Part of the disturbance that was estimated while the ball rested, m/s^2."""

    @property
    def P(self) -> Array:
        """Covariance of eta, eta', d, kappa, F at the touch sample's time, shape (..., 9, 9)."""
        return self._P.reshape(*self._shape, *self._P.shape[1:]).copy()

    @property
    def further(self) -> Array:
        """The ``KNOWN_QUANTITIES``, shape (..., 13)."""
        by, (_, _, _, _, dx, dy, kx, ky, friction) = self._by, self._now.s
        along, across, variance = components(diagonal(self._P)[:, 6:])
        variance = by.most(variance + self._map_variance(), 0.0)  # rounded below 0 by a map
        spreads = map(by.sqrt, (variance, along, across))
        drives = *(plate.bias for plate in self._plates), self._lag + 0.0 * friction
        camber = components(self.camber.reshape(-1, 2))
        found = together((friction, dx, dy, kx, ky, *spreads, *camber, *drives), self._rigs)
        return found.reshape(*self._shape, len(KNOWN_QUANTITIES))

    @property
    def camber(self) -> Array:
        """Acceleration per length off the plate's middle along x and y, 1/s^2, shape (..., 2)."""
        return np.zeros((*self._shape, 2))

    def _map_variance(self) -> Any:
        """Variance of the friction's map at the ball's present place, (m/s^2)^2; 0 without one."""
        return 0.0

    def _advance(self, begin: Tilt, then: Tilt) -> None:
        """One period of the filter, from one touch sample's time to the next: (K3), (K4)."""
        # (K3); a map's friction and camber hold at the ball's place only
        s, step = self._ball.step(self._there.s, begin, then)
        self._s = [*s[:4], *self._s[4:]]
        # the derivatives A of (K4)
        A = self._A
        xx, xy, yy = step.slope
        A[:, 2, 2], A[:, 2, 3], A[:, 3, 2], A[:, 3, 3] = 1 + xx, xy, xy, 1 + yy
        A[:, 2, FRICTION_INDEX], A[:, 3, FRICTION_INDEX] = step.friction
        A[:, 2, 6], A[:, 3, 7] = step.gain
        self._propagate(A)
        # Q of (K4), and d while the ball rests
        Q = self._Q
        if self._at_rest:
            vx, vy = self._ball.velocity(self._s, then)
            square = vx * vx + vy * vy
            rest = 1 / (1 + square / self.rest_test.rest_speed_m_s**2) ** 2
            Q = Q + column(rest) * self._Q_at_rest
            if self.forget_rest:
                self._rest = 1 / (1 + (square / self.rest_test.free_speed_m_s**2) ** 2)
                kept = 1 - self.period / self.forget_rest * (1 - self._rest)
                for axis, added in enumerate(self._added):
                    self._s[4 + axis] = self._s[4 + axis] - (1 - kept) * added
                self._added = [kept * added for added in self._added]
        spread = diagonal(self._P)
        spread += Q

    def _propagate(self, A: Array) -> None:
        """Covariance after a period, in place: A P A' of (K4); its other rows are of 1."""
        P = self._P
        P[:, :4] = A @ P
        P[:, 4:9, :4] = P[:, :4, 4:9].mT
        P[:, :4, :4] = P[:, :4, :9] @ A.mT

    def _take(self, seen: tuple[Any, Any], age: Any, new: Any, then: Tilt) -> None:
        """Correct by a touch sample: (K5) to (K8)."""
        by, P, (x, y) = self._by, self._P, seen
        age = by.where(new, age, 0.0)
        place, v = self._ball.position(self._s, then), self._ball.velocity(self._s, then)
        # (K5): H P, and H P H' + R = (a, b; b, c)
        hP = P[:, :2]
        if by.any(age):
            hP = hP - column(column(age)) * P[:, 2:4]
        xx, _, xv, _, xy, yy, yv, yw = components(hP[:, :, :4].reshape(-1, 8))
        a, b, c = xx - age * xv + self.R[0], xy - age * yv, yy - age * yw + self.R[1]
        # (K6): e; L^-1 = (first, 0; cross, second), 0 where there is no new sample; W; L^-1 e
        ex, ey = x - place[0] + age * v[0], y - place[1] + age * v[1]
        taken = new * 1.0
        first, second = taken / by.sqrt(a), taken / by.sqrt(c - b * b / a)
        cross = -b / a * second
        W = together((first, 0.0 * first, cross, second), self._rigs).reshape(-1, 2, 2) @ hP
        white = first * ex, cross * ex + second * ey
        # (K8): outliers, and those that follow one on the same side
        test, distance = self.impact_test, white[0] * white[0] + white[1] * white[1]
        unlikely = distance > test.outlier_squared_distance
        far = white[0] * unlikely, white[1] * unlikely
        struck = far[0] * self._far[0] + far[1] * self._far[1] > 0.0
        self._far = tuple(by.where(new, *each) for each in zip(far, self._far, strict=True))
        # (K7), without F and kappa at rest
        change = (together(white, self._rigs)[:, None] @ W)[:, 0]
        moving = new & (v[0] * v[0] + v[1] * v[1] > self.learning_speed**2)
        if not by.all(moving):
            learnt = np.where(column(moving), change[:, LEARNT_IN_MOTION], 0.0)
            change[:, LEARNT_IN_MOTION] = learnt
        self._reduce(W, moving)
        self._correct_by(change)
        if self.forget_rest:
            of_disturbance = zip(self._added, components(change[:, 4:6]), strict=True)
            self._added = [a + self._rest * d for a, d in of_disturbance]
        if by.any(struck):
            # (K8): M, the change of eta and eta' by a unit change of the velocity an age ago
            M = np.vstack((test.age_s * np.eye(2), np.eye(2)))
            spread = test.velocity_std_m_s**2 * M @ M.T
            self._P[:, :4, :4] += np.where(column(column(struck)), spread, 0.0)
        least, most, (*_, kx, ky, friction) = by.least, by.most, self._s
        bound = self.bounds.tilt_gain_error
        self._s[6] = least(most(kx, -bound), bound)
        self._s[7] = least(most(ky, -bound), bound)
        self._s[FRICTION_INDEX] = least(most(friction, 0.0), self.most_friction * self._F)

    def _reduce(self, W: Array, moving: Any) -> None:
        """Subtract W' W of (K7) from the covariance; nothing of F and kappa at rest."""
        fall = W[:, :, :9].mT @ W
        if not self._by.all(moving):
            learnt = fall[:, LEARNT_IN_MOTION, LEARNT_IN_MOTION]
            learnt[...] = np.where(column(column(moving)), learnt, 0.0)
        self._P -= fall

    def _correct_by(self, change: Array) -> None:
        """Add W' L^-1 e of (K7) to the estimate, shape (N, 9)."""
        self._s = [a + b for a, b in zip(self._s, components(change), strict=True)]


def diagonal(P: Array) -> Array:
    """The first nine numbers on the diagonal of covariances, shape (N, 9, n), to be changed."""
    step = P.shape[-1] + 1
    return P.reshape(len(P), -1)[:, : 9 * step : step]
