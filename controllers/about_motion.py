"""Linear-quadratic feedback about a motion of ball and plate that is laid ahead."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy

from controllers.arrays import Array
from controllers.ballplate import SIGN, BallPlate
from controllers.interfaces import Feedback, Law, Reference
from controllers.motion import MotionPlan
from controllers.ranges import NotNegative
from controllers.two_sided import Tilts


@dataclass(frozen=True, kw_only=True)
class AboutMotion(Law):
    """What laws that follow a motion (r, a*) of ball and plate have in common.

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
    """How far the reference is asked ahead, s; 0 for not at all."""
    spread: NotNegative = 1.3
    """Time in s over which a jump of 0.15 m is spread, others by the root of their length; 0 leaves
    jumps as they are."""

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
        gain: Array = P[3]
        return gain

    def start(self, x: Array, reference: Reference, period: float) -> Any:
        """The motion of ball and plate, its first slice laid."""
        return MotionPlan(self.model, x, reference, period, self.preview, self.spread)

    def command(self, now: Feedback) -> Array:
        """Plate accelerations in rad/s^2, shape (..., 2), about the motion."""
        return self.about(now.equivalent, *now.plan.at(now.time))

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """The same without a plan: the flat model's slope."""
        r = reference(t)
        k1 = self.model.k1
        return self.about(x, r[0], r[1], Tilts(r[2] / k1, r[3] / k1, r[4] / k1))

    def about(self, x: Array, position: Array, velocity: Array, wanted: Tilts) -> Array:
        """Feedback about a motion, rad/s^2, shape (..., 2)."""
        c2, K = self.model.c2, self.K
        slope, rate = SIGN * x[..., 2::4] - wanted.angle, SIGN * x[..., 3::4] - wanted.rate
        eta = x[..., 0::4] - position + c2 * slope
        eta_rate = x[..., 1::4] - velocity + c2 * rate
        u = wanted.acceleration - K[0] * eta - K[1] * eta_rate - K[2] * slope - K[3] * rate
        out: Array = SIGN * u
        return out


def flat_axis(model: BallPlate) -> tuple[Array, Array]:
    """A, shape (4, 4), and B, shape (4, 1), of (eta, eta', a, a') under a''."""
    A, B = np.eye(4, k=1), np.eye(4)[:, 3:]
    A[1, 2] = model.k1
    return A, B
