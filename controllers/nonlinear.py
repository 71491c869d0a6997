"""Tracking by approximate feedback linearisation (AFL), without and with integral action.

Backstepping on the flat model: (6.64)-(6.91) for x and, with the other sign, (6.92)-(6.95).

Nested fourth-order sliding mode with a sigmoid in place of the sign, (6.97)-(6.103).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Len

from controllers.arrays import Array
from controllers.ballplate import SIGN, desired
from controllers.design import Pole, gains_from, require_stable, stable_poles
from controllers.interfaces import Law, Reference
from controllers.ranges import Positive


@dataclass(frozen=True, kw_only=True)
class AFL(Law):
    """Approximate feedback linearization (AFL), tracking (6.59) on the flat model (6.55c).

    The error obeys e^(4) + p3 e''' + p2 e'' + p1 e' + p0 e = 0.

    Raises:
        ValueError: If the poles or gains are of wrong number, not real (poles: not in conjugate
            pairs) or not stable, or if both are given.
    """

    name: ClassVar[str] = "afl"

    poles: tuple[Pole, ...] = (-2, -2.5, -3.5, -4)
    """Poles of the error dynamics of either axis in 1/s; the default is case 2 of Table 8.4."""
    gains: Annotated[tuple[float, ...], Len(4, 4)] | None = None
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
        v = r[4] - (z - desired(r[:4])).dot(self.p[:4])
        if self.memory:
            v = v - self.p[4] * q
        out: Array = (v + z[..., 2] * rate * rate) / a
        return out


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
    gains: Annotated[tuple[float, ...], Len(5, 5)] | None = None
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

    c: tuple[Positive, Positive, Positive, Positive] = (1.0, 2.0, 2.5, 3.0)
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
        mapped = (z[..., :3] - desired(r[:3])) @ self._map
        e3, bracket, bracket_rate = mapped[..., 0], mapped[..., 1], mapped[..., 2]
        alpha3 = (bracket + r[3]) / a
        e4 = rate - alpha3
        # (6.90): the derivatives of 1 / cos, of e1 to e3, and of what e4 adds to e3'.
        alpha3_rate = np.tan(angle) * rate * alpha3
        alpha3_rate = alpha3_rate + (bracket_rate + r[4]) / a - (c1 + c2 + c3) * e4
        out: Array = alpha3_rate - a * e3 - c4 * e4
        return out


POWERS = np.array((3.0, 4.0, 6.0))
ROOTS = np.array((1 / 4, 1 / 6, 1 / 12))
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
    betas: tuple[Positive, Positive, Positive] = (0.5, 1.0, 3.0)
    """Gains beta1 to beta3; the default is case 1 of Table 8.10."""
    epsilon: Positive = 0.1
    """Width of the sigmoid s / (|s| + epsilon) (2.52)."""

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations in rad/s^2, shape (..., 2)."""
        s = self.model.chain(x).z - desired(reference(t)[:4])
        pull = self.betas * np.add.accumulate(np.abs(s[..., :3]) ** POWERS, axis=-1) ** ROOTS
        psi = self._sigmoid(s[..., 0])
        for i in (1, 2, 3):
            psi = self._sigmoid(s[..., i] + pull[..., i - 1] * psi)
        return -self.alpha * SIGN * psi

    def _sigmoid(self, s: Array) -> Array:
        """Smooth stand-in for the sign (2.52)."""
        return s / (np.abs(s) + self.epsilon)
