"""A time-varying linear-quadratic regulator about the reference."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
import scipy
from annotated_types import Ge

from controllers.arrays import Array
from controllers.ballplate import TILT_SIGN, BallPlate
from controllers.interfaces import Feedback, Reference
from controllers.stable_inversion import AboutMotion, MotionPlan

GAIN_KNOT_S = 0.02
"""Time in s from one gain to the next."""
GAINS_PER_SWEEP = 25
"""Gains that are laid in one sweep."""


@dataclass(frozen=True, kw_only=True)
class TimeVaryingLQR(AboutMotion):
    """u = u*(t) + K(t) (x*(t) - x) about the motion x* that makes the ball follow the reference.

    With A(t), B(t) of the model (5.9) along the reference, K = R^-1 B'P, R = 1, and P of the
    differential Riccati equation, integrated backward in time (Kalman 1960, "Contributions to the
    theory of optimal control"; Anderson and Moore 1990, "Optimal control", chapter 2),

        -P' = A'P + P A - P B B'P + Q,

    from ``horizon`` after the end of each half second of gains, where it begins with the solution
    about the level plate. The sweep is done tick by tick, half a second before its gains are used.

    Good at fast motion far from the level plate; at the speeds of this rig the plant is so nearly
    linear that it gains nothing over a constant K, and it knows of no friction.

    Raises:
        ValueError: If a setting is not finite or has the wrong sign.
    """

    name: ClassVar[str] = "tvlqr"

    horizon: Annotated[float, Ge(GAIN_KNOT_S)] = 1.5
    """Time in s over which P forgets where it began; the reference is asked a second further."""

    def start(self, x: Array, reference: Reference, period: float) -> VaryingGain:
        """The motion and the gains of the first half second."""
        motion = MotionPlan(self, x, reference, period)
        return VaryingGain(self, motion, reference, period)

    def command(self, now: Feedback) -> Array:
        """Plate accelerations in rad/s^2, shape (..., 2)."""
        K, wanted = now.plan.gain(now.time), now.plan.motion.at(now.time)
        x = now.equivalent.copy()
        x[..., 0::4] -= wanted.position
        x[..., 1::4] -= wanted.velocity
        x[..., 2::4] -= TILT_SIGN * wanted.slope.angle
        x[..., 3::4] -= TILT_SIGN * wanted.slope.rate
        return TILT_SIGN * wanted.slope.acceleration - np.einsum("...ij,...j->...i", K, x)

    def weight(self) -> Array:
        """Q as a weight of the state (5.5), shape (8, 8)."""
        flat = np.zeros((8, 8))
        for axis, sign in enumerate(TILT_SIGN):
            own = slice(4 * axis, 4 * axis + 4)
            flat[own, own] = np.diag((1.0, 1.0, sign, sign))
            flat[own, own] += self.model.c2 * sign * np.eye(4, k=2)
        return flat.T @ np.diag((*self.Q, *self.Q)) @ flat


def along(model: BallPlate, reference: Reference, times: Array) -> tuple[Array, Array]:
    """The model (5.9) linearised along a reference, the plate as the flat model takes it.

    Returns:
        A and B of x' = A x + B u at K times, shapes (K, ..., 8, 8) and (K, ..., 8, 2).
    """
    r = reference(times)
    x = np.zeros((*r.shape[1:-1], 8))
    x[..., 0::4], x[..., 1::4] = r[0], r[1]
    x[..., 2::4], x[..., 3::4] = TILT_SIGN * r[2] / model.k1, TILT_SIGN * r[3] / model.k1
    return model.jacobian(x, TILT_SIGN * r[4] / model.k1), model.g(x)


def slope(P: Array, A: Array, B: Array, Q: Array) -> Array:
    """-P' = A'P + P A - P B B'P + Q, shape (..., 8, 8)."""
    PA, PB = P @ A, P @ B
    return PA + PA.swapaxes(-1, -2) - PB @ PB.swapaxes(-1, -2) + Q


class VaryingGain:
    """K(t) for one run, laid sweep by sweep.

    Args:
        law: The law with the weights of the gains.
        motion: The motion about which the plant is linearised.
        reference: The path along which the plant is linearised.
        period: Control period in s.
    """

    def __init__(
        self, law: TimeVaryingLQR, motion: MotionPlan, reference: Reference, period: float
    ) -> None:
        self.motion = motion
        self._law, self._reference, self._period = law, reference, period
        self._Q = law.weight()
        A, B, _ = law.model.linear()
        self._level = scipy.linalg.solve_continuous_are(A, B, self._Q, np.eye(2))
        self._knots = GAINS_PER_SWEEP + round(law.horizon / GAIN_KNOT_S)
        self._begin = -2 * GAINS_PER_SWEEP
        self._next = self._laid = np.zeros((GAINS_PER_SWEEP, 2, 8))
        self._sweep()
        self._turn()
        self._turn()

    def gain(self, t: float) -> Array:
        """K at a time in s that does not lie before the one asked for last, shape (..., 2, 8)."""
        knot = int(round(t / self._period) * self._period / GAIN_KNOT_S + 1e-9)
        while knot >= self._begin + GAINS_PER_SWEEP:
            self._turn()
        if self._left:
            self._step()
        return self._laid[knot - self._begin]

    def _turn(self) -> None:
        """Take the gains of the finished sweep, and begin the next one."""
        while self._left:
            self._step()
        self._laid = self._next
        self._begin += GAINS_PER_SWEEP
        self._sweep()

    def _sweep(self) -> None:
        """Begin the sweep for the gains after the next ones."""
        first = self._begin + GAINS_PER_SWEEP
        times = (first + np.arange(self._knots + 1)) * GAIN_KNOT_S
        self._A, self._B = along(self._law.model, self._reference, times)
        self._P = np.broadcast_to(self._level, self._A.shape[1:])
        self._left = self._knots
        self._next = np.empty((GAINS_PER_SWEEP, *self._B.shape[1:-2], 2, 8))

    def _step(self) -> None:
        """One step of the sweep backward in time, by the rule of Runge and Kutta."""
        A, B, Q, P, h = self._A, self._B, self._Q, self._P, GAIN_KNOT_S
        late, early = self._left, self._left - 1
        Am, Bm = (A[late] + A[early]) / 2, (B[late] + B[early]) / 2
        k1 = slope(P, A[late], B[late], Q)
        k2 = slope(P + h / 2 * k1, Am, Bm, Q)
        k3 = slope(P + h / 2 * k2, Am, Bm, Q)
        k4 = slope(P + h * k3, A[early], B[early], Q)
        self._P = P + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        self._left = early
        if early < GAINS_PER_SWEEP:
            self._next[early] = B[early].swapaxes(-1, -2) @ self._P
