"""Linear state feedback u = K (x* - x): pole placement (6.1.1) and LQR (6.1.2).

Feed-forward from the flat model with linear feedback about its trajectory, Figure 6.2.

PID control of the ball in a cascade: the ball asks for an acceleration, the plate follows.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, ClassVar, Literal

import numpy as np
import scipy
from annotated_types import Gt, Le, Len

from controllers.arrays import Array
from controllers.ballplate import SIGN
from controllers.design import Pole, listed, stable_poles
from controllers.interfaces import Law, Reference
from controllers.ranges import NotNegative, Positive


@dataclass(frozen=True, kw_only=True)
class _StateFeedback(Law):
    """u = K (x* - x) (6.8) on the model linearised about the level plate."""

    reference: Literal["position", "velocity"] = "velocity"
    """Whether x* holds the desired position alone (6.9a) or its velocity too (6.9b)."""

    K: Array = field(init=False, repr=False, compare=False)
    """Gain, shape (2, 8), in rad/s^2 per unit of the state."""

    @abstractmethod
    def _gain(self) -> Array:
        """Check the settings; the gain, shape (2, 8)."""

    def __post_init__(self) -> None:
        """Check the settings and compute the gain once."""
        super().__post_init__()
        object.__setattr__(self, "K", self._gain())

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations K (x* - x) (6.8) in rad/s^2, shape (..., 2)."""
        r = reference(t)
        desired = np.zeros((*r.shape[1:-1], 8))
        desired[..., 0::4] = r[0]
        if self.reference == "velocity":
            desired[..., 1::4] = r[1]
        return (desired - x) @ self.K.T


@dataclass(frozen=True, kw_only=True)
class PolePlacement(_StateFeedback):
    """State feedback with chosen closed-loop poles (6.6).

    Raises:
        ValueError: If the poles are not four or eight, not stable or not in conjugate pairs.
    """

    name: ClassVar[str] = "pole_placement"

    poles: tuple[Pole, ...] = (-2, -2.5, -3.5, -4)
    """Closed-loop poles in 1/s: four for each axis alike, or eight, for x and then for y."""

    def _gain(self) -> Array:
        both = self.poles if len(self.poles) == 8 else (*self.poles, *self.poles)
        if len(both) != 8:
            raise ValueError(f"poles must be 4 or 8 numbers, got {len(self.poles)}")
        both = (*stable_poles(both[:4], 4), *stable_poles(both[4:], 4))
        object.__setattr__(self, "poles", both[: len(self.poles)])
        return placed(self.model.linear().A, self.model.linear().B, both)


@dataclass(frozen=True, kw_only=True)
class LQR(_StateFeedback):
    """State feedback that minimises the integral of x'Qx + u'Ru (6.10).

    Raises:
        ValueError: If a weight is not finite or has the wrong sign, or if the weights leave part of
            the motion without control.
    """

    name: ClassVar[str] = "lqr"

    rho: Positive = 300.0
    """Weight of the state against the input (6.11)."""
    kappa: NotNegative = 0.3
    """Weight of the rates against the positions (6.11)."""
    Q: Annotated[tuple[NotNegative, ...], Len(8, 8)] | None = None
    """Diagonal of the state weight, eight numbers; given, it replaces ``rho`` and ``kappa``."""
    R: tuple[Positive, Positive] = (1.0, 1.0)
    """Diagonal of the input weight."""

    def _gain(self) -> Array:
        if self.Q is None:
            Q = weights(self.rho, self.kappa)
        elif (self.rho, self.kappa) != (LQR.rho, LQR.kappa):
            raise ValueError("Q replaces rho and kappa: give either Q or rho and kappa")
        else:
            Q = self.Q
        return optimal(self.model.linear().A, self.model.linear().B, Q, self.R)


def weights(rho: float, kappa: float) -> tuple[float, ...]:
    """Diagonal of Q = rho diag(1, kappa, 1, kappa, ...) (6.11)."""
    return (rho, rho * kappa) * 4


def placed(A: Array, B: Array, poles: Sequence[Pole]) -> Array:
    """Gain K that gives A - B K the poles, axis by axis (6.4), (6.6).

    Args:
        A: State matrix of (5.35), shape (8, 8).
        B: Input matrix of (5.35), shape (8, 2).
        poles: Four poles for x, then four for y; a pole may repeat.

    Returns:
        K, shape (2, 8).
    """
    import control  # noqa: PLC0415  heavy: loaded when needed

    K = np.zeros((2, 8))
    for axis in (0, 1):
        own = slice(4 * axis, 4 * axis + 4)
        K[axis, own] = control.acker(A[own, own], B[own, axis : axis + 1], poles[own])
    return K


def optimal(A: Array, B: Array, Q: Sequence[float], R: Sequence[float]) -> Array:
    """Gain K = R^-1 B'P with A'P + PA - PBR^-1B'P + Q = 0, (6.12) and (6.13).

    Args:
        A: State matrix of (5.35), shape (8, 8).
        B: Input matrix of (5.35), shape (8, 2).
        Q: Diagonal of the state weight, eight numbers, none negative.
        R: Diagonal of the input weight, two positive numbers.

    Returns:
        K, shape (2, 8).

    Raises:
        ValueError: If no gain stabilises the plate with these weights.
    """
    try:
        # what control.lqr does, to the bit, without the second that loading it takes
        P = scipy.linalg.solve_continuous_are(A, B, np.diag(Q), np.diag(R))
        K = np.linalg.solve(np.diag(R), B.T @ P)
    except (ValueError, np.linalg.LinAlgError):
        K = np.zeros((2, 8))
    poles = np.linalg.eigvals(A - B @ K)
    # A mode without weight keeps its pole on the imaginary axis, to the solver's accuracy.
    if not (poles.real < -1e-4).all():
        raise ValueError(
            f"Q {list(Q)} with R {list(R)} leaves a motion without control: poles {listed(poles)}"
        )
    return K


STEEPEST = 0.5
"""Sine of the steepest plate angle fed forward, 30 deg: more than the plate reaches, and far from
90 deg, where the rate would be divided by zero."""


@dataclass(frozen=True, kw_only=True)
class Feedforward(Law):
    """u = u_ff + K (x* - x): the inputs and states that make the flat model follow the reference.

    A reference that accelerates faster than a plate inclined by 30 deg can make the ball do is fed
    forward as if at that angle.

    Raises:
        ValueError: If the poles or weights are not allowed, or both are given.
    """

    name: ClassVar[str] = "feedforward"

    poles: tuple[Pole, ...] | None = None
    """Four closed-loop poles for each axis in 1/s; given, they replace ``rho`` and ``kappa``."""
    rho: Positive = 300.0
    """Weight of the state against the input (6.11)."""
    kappa: NotNegative = 0.3
    """Weight of the rates against the positions (6.11)."""

    K: Array = field(init=False, repr=False, compare=False)
    """Feedback gain, shape (2, 8)."""

    def __post_init__(self) -> None:
        """Check the settings and compute the feedback gain once."""
        super().__post_init__()
        A, B, _ = self.model.linear()
        if self.poles is None:
            K = optimal(A, B, weights(self.rho, self.kappa), (1.0, 1.0))
        elif (self.rho, self.kappa) == (Feedforward.rho, Feedforward.kappa):
            object.__setattr__(self, "poles", stable_poles(self.poles, 4))
            K = placed(A, B, (*self.poles, *self.poles))
        else:
            raise ValueError("poles replace rho and kappa: give either poles or rho and kappa")
        object.__setattr__(self, "K", K)

    def trajectory(self, r: Array) -> tuple[Array, Array]:
        """State and input of the flat model that follows the reference, (6.46) and (6.47).

        Args:
            r: Position and four derivatives of the reference, shape (5, ..., 2).

        Returns:
            x*, shape (..., 8), and u_ff in rad/s^2, shape (..., 2).
        """
        k = self.model.k
        sine = np.minimum(np.maximum(r[2] / k, -STEEPEST), STEEPEST)
        a = k * np.sqrt(1 - sine * sine)
        rate = r[3] / a
        x = np.empty((*r.shape[1:-1], 8))
        x[..., 0::4] = r[0]
        x[..., 1::4] = r[1]
        x[..., 2::4] = np.arcsin(sine)
        x[..., 3::4] = rate
        return x, (r[4] + r[2] * rate * rate) / a

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations u_ff + K (x* - x) in rad/s^2, shape (..., 2)."""
        desired, u = self.trajectory(reference(t))
        return u + (desired - x) @ self.K.T


@dataclass(frozen=True, kw_only=True)
class Pid(Law):
    """PID on each axis of the ball, its derivative filtered, its integral kept from winding up.

    What the controller asks of the ball, an acceleration, becomes the plate angle that rolls it so
    on the model, ``sin(angle) = acceleration / k1``, and a PD brings the plate there. Not in the
    thesis. The memory holds the integral of the error and the filtered error, of x and y.
    """

    name: ClassVar[str] = "pid"
    memory: ClassVar[int] = 4

    kp: NotNegative = 6.0
    """Gain on the error, 1/s^2."""
    ki: NotNegative = 1.0
    """Gain on its integral, 1/s^3."""
    kd: NotNegative = 4.0
    """Gain on its filtered derivative, 1/s."""
    filter: Positive = 0.04
    """Time constant of the derivative, s."""
    angle: Annotated[float, Gt(0), Le(10)] = 8.0
    """Largest plate angle that is asked for, deg; there the integral stops growing."""
    plate: tuple[NotNegative, NotNegative] = (144.0, 24.0)
    """Gains on the plate's angle and rate, 1/s^2 and 1/s."""

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations (phi'', theta'') in rad/s^2, shape (..., 2)."""
        angle, rate = x[..., 2::4], x[..., 3::4]
        wanted = np.clip(self._asked(t, x, reference, q), -self._most, self._most)
        goal = SIGN * np.arcsin(wanted / self.model.k1)
        u: Array = self.plate[0] * (goal - angle) - self.plate[1] * rate
        return u

    def memory_rate(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Rates of the error's integral, shape (..., 2), and of the filtered error, (..., 2)."""
        error = reference(t)[0] - x[..., 0::4]
        asked = self._asked(t, x, reference, q)
        winding = (np.abs(asked) > self._most) & (asked * error > 0)
        return np.concatenate(
            [np.where(winding, 0.0, error), (error - q[..., 2:]) / self.filter], axis=-1
        )

    def _asked(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Acceleration of the ball in m/s^2, before the angle's limit, shape (..., 2)."""
        error = reference(t)[0] - x[..., 0::4]
        derivative = (error - q[..., 2:]) / self.filter
        asked: Array = self.kp * error + self.ki * q[..., :2] + self.kd * derivative
        return asked

    @property
    def _most(self) -> float:
        """Largest acceleration that is asked for, m/s^2."""
        return float(self.model.k1 * np.sin(np.radians(self.angle)))
