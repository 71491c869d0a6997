"""Tracking by approximate feedback linearisation (AFL), without and with integral action."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Len

from controllers.ballplate import desired
from controllers.interfaces import Array, Law, Reference
from controllers.poles import Pole, gains_from, require_stable, stable_poles
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
