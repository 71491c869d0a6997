"""Laws of chapter 6 of the thesis, and PID.

Linear state feedback u = K (x* - x): pole placement (6.1.1) and LQR (6.1.2); feed-forward from the
flat model with linear feedback about its trajectory, Figure 6.2; PID of the ball in a cascade.
Tracking by approximate feedback linearisation (AFL), without and with integral action; backstepping
on the flat model, (6.64)-(6.91) for x and, with the other sign, (6.92)-(6.95); nested fourth-order
sliding mode with a sigmoid in place of the sign, (6.97)-(6.103).
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import Annotated, ClassVar, Literal

import numpy as np
import scipy
from annotated_types import Gt, Le, Len

from controllers.arrays import Array, NotNegative, Positive, multiply_rows
from controllers.ballplate import TILT_SIGN, stack_reference
from controllers.design import Pole, format_numbers, gains_from, require_stable, stable_poles
from controllers.interfaces import Law, Reference, with_entries

__all__ = [
    "AFL",
    "LQR",
    "AFLIntegral",
    "Backstepping",
    "Feedforward",
    "Pid",
    "PolePlacement",
    "SlidingMode",
]


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
        desired = np.zeros((*r.shape[1:-1], 8), np.result_type(r, float))
        desired[..., 0::4] = r[0]
        if self.reference == "velocity":
            desired[..., 1::4] = r[1]
        return multiply_rows(desired - x, self.K.T)


@dataclass(frozen=True, kw_only=True)
class PolePlacement(_StateFeedback):
    """State feedback with chosen closed-loop poles (6.6).

    Raises:
        ValueError: If the poles are not four or eight, not stable or not in conjugate pairs.
    """

    name: ClassVar[str] = "pole_placement"

    poles: tuple[Pole, ...] = with_entries((-2, -2.5, -3.5, -4), along_x=4)
    """Closed-loop poles in 1/s: four for each axis alike, or eight, for x and then for y."""

    def _gain(self) -> Array:
        both = self.poles if len(self.poles) == 8 else (*self.poles, *self.poles)
        if len(both) != 8:
            raise ValueError(f"poles must be 4 or 8 numbers, got {len(self.poles)}")
        both = (*stable_poles(both[:4], 4), *stable_poles(both[4:], 4))
        object.__setattr__(self, "poles", both[: len(self.poles)])
        return place_axis_poles(self.model.linear().A, self.model.linear().B, both)


@dataclass(frozen=True, kw_only=True)
class LQR(_StateFeedback):
    """State feedback that minimises the integral of x'Qx + u'Ru (6.10).

    Raises:
        ValueError: If a weight is not finite or has the wrong sign, or if the weights leave part of
            the motion without control.
    """

    name: ClassVar[str] = "lqr"
    replaces: ClassVar[Mapping[str, tuple[str, ...]]] = MappingProxyType({"Q": ("rho", "kappa")})

    rho: Positive = 300.0
    """Weight of the state against the input (6.11)."""
    kappa: NotNegative = 0.3
    """Weight of the rates against the positions (6.11)."""
    Q: Annotated[tuple[NotNegative, ...], Len(8, 8)] | None = with_entries(None, along_x=4)
    """Diagonal of the state weight, eight numbers; given, it replaces ``rho`` and ``kappa``."""
    R: tuple[Positive, Positive] = with_entries((1.0, 1.0), along_x=1)
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


def place_axis_poles(A: Array, B: Array, poles: Sequence[Pole]) -> Array:
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
            f"Q {list(Q)} with R {list(R)} leaves a motion without control: "
            f"poles {format_numbers(poles)}"
        )
    return K


MAX_FEEDFORWARD_SINE = 0.5
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
    replaces: ClassVar[Mapping[str, tuple[str, ...]]] = MappingProxyType(
        {"poles": ("rho", "kappa")}
    )

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
            K = place_axis_poles(A, B, (*self.poles, *self.poles))
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
        sine = np.minimum(np.maximum(r[2] / k, -MAX_FEEDFORWARD_SINE), MAX_FEEDFORWARD_SINE)
        a = k * np.sqrt(1 - sine * sine)
        rate = r[3] / a
        x = np.empty((*r.shape[1:-1], 8), np.result_type(r, float))
        x[..., 0::4] = r[0]
        x[..., 1::4] = r[1]
        x[..., 2::4] = np.arcsin(sine)
        x[..., 3::4] = rate
        return x, (r[4] + r[2] * rate * rate) / a

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations u_ff + K (x* - x) in rad/s^2, shape (..., 2)."""
        desired, u = self.trajectory(reference(t))
        return u + multiply_rows(desired - x, self.K.T)


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
        goal = TILT_SIGN * np.arcsin(wanted / self.model.k1)
        return self.plate[0] * (goal - angle) - self.plate[1] * rate

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
        return self.kp * error + self.ki * q[..., :2] + self.kd * derivative

    @property
    def _most(self) -> float:
        """Largest acceleration that is asked for, m/s^2."""
        most: float = self.model.k1 * np.sin(np.radians(self.angle))
        return most


@dataclass(frozen=True, kw_only=True)
class AFL(Law):
    """Approximate feedback linearization (AFL), tracking (6.59) on the flat model (6.55c).

    The error obeys e^(4) + p3 e''' + p2 e'' + p1 e' + p0 e = 0.

    Raises:
        ValueError: If the poles or gains are of wrong number, not real (poles: not in conjugate
            pairs) or not stable, or if both are given.
    """

    name: ClassVar[str] = "afl"
    replaces: ClassVar[Mapping[str, tuple[str, ...]]] = MappingProxyType({"gains": ("poles",)})

    poles: tuple[Pole, ...] = (-2, -2.5, -3.5, -4)
    """Poles of the error dynamics of either axis in 1/s; the default is case 2 of Table 8.4."""
    gains: Annotated[tuple[float, ...], Len(4, 4)] | None = with_entries(
        None, "p0", "p1", "p2", "p3"
    )
    """The gains (p0, p1, p2, p3) themselves; given, they replace the poles."""

    powers: ClassVar[tuple[int, ...]] = (0, 1, 2, 3)
    """Power of s before which each gain stands in the polynomial s^4 + p3 s^3 + ... + p0 (6.56)."""

    p: Array = field(init=False, repr=False, compare=False)
    """The gains, from the poles or as given."""

    def __post_init__(self) -> None:
        """Check the settings and turn the poles into gains."""
        super().__post_init__()
        powers = list(self.powers)
        if self.gains is None:
            p = gains_from(stable_poles(self.poles, len(powers)))[powers]
        elif self.poles == type(self).poles:
            p = np.array(self.gains)
            require_stable(p[np.argsort(powers)], self.gains)
        else:
            raise ValueError("gains replace poles: give either gains or poles")
        object.__setattr__(self, "p", p)

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations (6.59) in rad/s^2, shape (..., 2)."""
        z, _, rate, a = self.model.chain(x)
        r = reference(t)
        if r.size == 5 * rate.size:
            r = r.reshape(5, *rate.shape)
        v = r[4] - (z - stack_reference(r[:4])).dot(self.p[:4])
        if self.memory:
            v = v - self.p[4] * q
        return (v + z[..., 2].copy() * rate * rate) / a


@dataclass(frozen=True, kw_only=True)
class AFLIntegral(AFL):
    """Approximate feedback linearization (AFL) with integral action (6.62).

    The error obeys e^(5) + p3 e^(4) + ... + p0 e' + p_I e = 0 (6.61).

    The memory q is the integral of the error for x and y in m s.

    Raises:
        ValueError: As for ``AFL``, or if the limit is not positive.
    """

    name: ClassVar[str] = "afl_integral"
    memory: ClassVar[int] = 2

    poles: tuple[Pole, ...] = (-1, -1.5, -2, -2.5, -3)
    """Poles of the error dynamics of either axis in 1/s; the default is case 2 of Table 8.6."""
    gains: Annotated[tuple[float, ...], Len(5, 5)] | None = with_entries(
        None, "p0", "p1", "p2", "p3", "p_I"
    )
    """The gains (p0, p1, p2, p3, p_I) themselves; given, they replace the poles."""
    powers: ClassVar[tuple[int, ...]] = (1, 2, 3, 4, 0)
    """As of AFL, in the polynomial s^5 + p3 s^4 + ... + p0 s + p_I (6.61)."""
    integral_limit: Positive | None = None
    """Anti-windup: q grows no further than this in m s. None, as in the thesis: no limit."""

    def memory_rate(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Error e of x and y in m, or zero where q is at its limit and e points beyond it."""
        e: Array = x[..., 0::4] - reference(t)[0]
        if self.integral_limit is None:
            return e
        return np.where((np.abs(q) < self.integral_limit) | (q * e < 0), e, 0.0)


@dataclass(frozen=True, kw_only=True)
class Backstepping(Law):
    """Four errors, each steered to zero by the next, so that V' = -sum c_i e_i^2 (6.91).

    For either axis, with z = (y, y', y'', y''') of the flat model, a = +-k1 cos(angle) and the
    reference r:

        e1 = z1 - r,  e2 = z2 - alpha1,  e3 = z3 - alpha2,  e4 = rate - alpha3
        alpha1 = -c1 e1 + r'
        alpha2 = (c1^2 - 1) e1 - (c1 + c2) e2 + r''
        alpha3 = [(2 c1 - c1^3 + c2) e1 + (c1^2 + c1 c2 + c2^2 - 2) e2
                  - (c1 + c2 + c3) e3 + r'''] / a
        u = alpha3' - a e3 - c4 e4

    Raises:
        ValueError: If the gains are not four positive numbers.
    """

    name: ClassVar[str] = "backstepping"

    c: tuple[Positive, Positive, Positive, Positive] = with_entries(
        (1.0, 2.0, 2.5, 3.0), "c1", "c2", "c3", "c4"
    )
    """Gains c1 to c4 in 1/s; the default is case 2 of Table 8.8."""

    @cached_property
    def _map(self) -> Array:
        """To e3, the bracket of alpha3 and its rate from the error and two derivatives, (3, 3)."""
        c1, c2, c3, _ = self.c
        # Rows: e1, e2, e3 (6.64a), (6.69a), (6.76a) from the tracking error and two derivatives.
        e1, e2, e3 = np.eye(3)
        e2 = e2 + c1 * e1
        e3 = e3 - (c1**2 - 1) * e1 + (c1 + c2) * e2
        # e1', e2' and e3' without its part a e4: (6.69b), (6.76b), (6.85).
        e1_rate, e2_rate, e3_rate = e2 - c1 * e1, e3 - c2 * e2 - e1, -c3 * e3 - e2
        bracket = np.array((2 * c1 - c1**3 + c2, c1**2 + c1 * c2 + c2**2 - 2, -(c1 + c2 + c3)))
        rows = (e3, bracket @ (e1, e2, e3), bracket @ (e1_rate, e2_rate, e3_rate))
        return np.array(rows).T

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations (6.89), (6.95) in rad/s^2, shape (..., 2)."""
        c1, c2, c3, c4 = self.c
        z, angle, rate, a = self.model.chain(x)
        r = reference(t)
        mapped = (z[..., :3] - stack_reference(r[:3])) @ self._map
        e3, bracket, bracket_rate = mapped[..., 0], mapped[..., 1], mapped[..., 2]
        alpha3 = (bracket + r[3]) / a
        e4 = rate - alpha3
        # (6.90): the derivatives of 1 / cos, of e1 to e3, and of what e4 adds to e3'.
        alpha3_rate = np.tan(angle) * rate * alpha3
        alpha3_rate = alpha3_rate + (bracket_rate + r[4]) / a - (c1 + c2 + c3) * e4
        return alpha3_rate - a * e3 - c4 * e4


SLIDING_POWERS = np.array((3.0, 4.0, 6.0))
SLIDING_ROOTS = np.array((1 / 4, 1 / 6, 1 / 12))
"""N_i of (2.55), r = 4, q = 12: root of the sum of the first i of |s|^3, |s'|^4, |s''|^6."""


@dataclass(frozen=True, kw_only=True)
class SlidingMode(Law):
    """u = -alpha Psi for x (6.101e) and, corrected, u = +alpha Psi for y (6.102e).

    Psi is nested: Psi_0 = sigmoid(s), Psi_i = sigmoid(s^(i) + beta_i N_i Psi_(i-1)), with s the
    tracking error of the axis and s^(i) its derivatives on the flat model.

    Raises:
        ValueError: If a setting is not a positive number, or the betas are not three.
    """

    name: ClassVar[str] = "sliding_mode"

    alpha: Positive = 1.5
    """Largest plate acceleration in rad/s^2. The thesis prints alpha = -1.5 and one sign for both
    axes, with which one of them runs away; here alpha is the amplitude and positive."""
    betas: tuple[Positive, Positive, Positive] = with_entries(
        (0.5, 1.0, 3.0), "beta1", "beta2", "beta3"
    )
    """Gains beta1 to beta3; the default is case 1 of Table 8.10."""
    epsilon: Positive = 0.1
    """Width of the sigmoid s / (|s| + epsilon) (2.52)."""

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations in rad/s^2, shape (..., 2)."""
        s = self.model.chain(x).z - stack_reference(reference(t)[:4])
        pull = (
            self.betas
            * np.add.accumulate(np.abs(s[..., :3]) ** SLIDING_POWERS, axis=-1) ** SLIDING_ROOTS
        )
        psi = self._sigmoid(s[..., 0])
        for i in (1, 2, 3):
            psi = self._sigmoid(s[..., i] + pull[..., i - 1] * psi)
        return -self.alpha * TILT_SIGN * psi

    def _sigmoid(self, s: Array) -> Array:
        """Smooth stand-in for the sign (2.52)."""
        return s / (np.abs(s) + self.epsilon)
