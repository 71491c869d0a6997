"""Backstepping on the flat model: (6.64)-(6.91) for x and, with the other sign, (6.92)-(6.95)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from controllers.ballplate import desired
from controllers.interfaces import Array, Law, Reference
from controllers.ranges import Positive


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
