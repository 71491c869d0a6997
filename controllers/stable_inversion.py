"""Preview by the stable inverse of the reference, friction fed forward, feedback by LQR."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from controllers.about_motion import AboutMotion
from controllers.arrays import Array
from controllers.interfaces import Feedback, Reference
from controllers.motion import Slices, inverse
from controllers.preview import Preview
from controllers.ranges import NotNegative, Positive
from controllers.two_sided import Tilts


@dataclass(frozen=True, kw_only=True)
class StableInversion(AboutMotion):
    """Follows a motion of ball and plate that makes the ball itself follow the reference.

    With the slopes a = (phi, -theta), either axis is x'' = (1 + kappa) k1 a - c2 a'' + d - F h
    with friction F along the heading h, or eta'' = (1 + kappa) k1 a + d - F h with the flat output
    eta = x + c2 a. The slope that makes x follow r is the bounded solution (``TwoSided``) of

        a* - a*'' / Z^2 = (r'' + F h(r') - d) / k1,    Z^2 = k1 / c2,

    divided by 1 + kappa. It begins before what causes it, so the reference is asked ahead. F, d and
    kappa come from the observer, h(v) = v / sqrt(|v|^2 + vs^2). About it the law is

        a'' = a*'' - K (eta - r - c2 a*, eta' - r' - c2 a*', a - a*, a' - a*')

    with K of the linear-quadratic regulator of eta'' = k1 a. Jumps of the reference are spread.

    Raises:
        ValueError: If a setting is not finite or has the wrong sign.
    """

    name: ClassVar[str] = "stable_inversion"
    needs: ClassVar[tuple[str, ...]] = (
        "friction",
        "disturbance_x",
        "disturbance_y",
        "tilt_gain_x",
        "tilt_gain_y",
    )

    Q: tuple[NotNegative, NotNegative, NotNegative, NotNegative] = (3e5, 3e4, 1e4, 200.0)
    """Weights of eta (m), its rate, slope (rad) and its rate; the slope's acceleration has 1. An
    uneven friction and a ball that sticks ask for a stiff feedback; noise, effort and play of the
    drives for a soft one."""
    smooth: Positive = 0.006
    """Wished speed vs in m/s over which the friction fed forward changes its sign."""
    resting_speed: NotNegative = 0.015
    """Wished speed in m/s, now and a second on, below which the ball is to be held rather than
    moved: friction is then fed forward along the ball's own heading, there being no other. 0 for
    never."""

    def start(self, x: Array, reference: Reference, period: float) -> InversePlan:
        """The motion of ball and plate, its first slice laid."""
        return InversePlan(self, x, reference, period)

    def command(self, now: Feedback) -> Array:
        """Plate accelerations in rad/s^2, shape (..., 2), from plan and observer."""
        wanted = now.plan.at(now.time)
        F, d, gain = now.needed[..., :1], now.needed[..., 1:3], 1 + now.needed[..., 3:]
        free, drag = wanted.free, self._dragged(wanted, now.x)
        slope = Tilts(
            (free.angle + F * drag.angle - d / self.model.k1) / gain,
            (free.rate + F * drag.rate) / gain,
            (free.acceleration + F * drag.acceleration) / gain,
        )
        return self.about(now.x, wanted.position, wanted.velocity, slope)

    def _dragged(self, wanted: InverseMotion, x: Array) -> Tilts:
        """Slopes against a friction of 1 m/s^2: as planned, at rest by the ball's own heading."""
        if not self.resting_speed:
            return wanted.drag
        v = x[..., 1::4]
        share = wanted.pace / self.resting_speed**2
        planned = share * share / (1 + share * share)
        length = np.sqrt((v * v).sum(axis=-1, keepdims=True) + self.smooth**2)
        own = (1 - planned) * v / (length * self.model.k1)
        angle, rate, acceleration = wanted.drag
        return Tilts(planned * angle + own, planned * rate, planned * acceleration)


class InverseMotion(NamedTuple):
    """What the ball is to do at one tick, and the slopes that the inverse says it takes."""

    position: Array
    """Of the ball, m, shape (..., 2)."""
    velocity: Array
    """Of the ball, m/s, shape (..., 2)."""
    pace: Array
    """Square of its speed, and of what its acceleration adds in a second, (m/s)^2, (..., 1)."""
    free: Tilts
    """Slopes that it takes without friction, rad."""
    drag: Tilts
    """Slopes that a friction of 1 m/s^2 takes besides, rad per m/s^2."""


class InversePlan(Slices):
    """The motion for one run, laid slice by slice.

    Args:
        law: Whose plan.
        x: State at the start, shape (..., 8).
        reference: Path of the ball.
        period: Control period in s.
    """

    def __init__(self, law: StableInversion, x: Array, reference: Reference, period: float) -> None:
        self._law = law
        preview = Preview(reference, x[..., 0::4], period, law.preview, law.spread)
        self._free, self._drag = (inverse(law.model, preview, period) for _ in range(2))
        super().__init__(preview, period)

    def at(self, t: float) -> InverseMotion:
        """What is wanted at a time in s that does not lie before the one asked for last."""
        tick = self._tick(t)
        laid = self._laid
        free, drag = (Tilts(*(each[tick] for each in tilts)) for tilts in (laid.free, laid.drag))
        return InverseMotion(laid.position[tick], laid.velocity[tick], laid.pace[tick], free, drag)

    def _lay(self, position: Array, velocity: Array, acceleration: Array) -> None:
        k1, count = self._law.model.k1, self._preview.count
        square = (velocity**2).sum(axis=-1, keepdims=True)
        pace = square + (acceleration**2).sum(axis=-1, keepdims=True)
        speed = np.sqrt(square + self._law.smooth**2)
        self._laid = InverseMotion(
            position[:count],
            velocity[:count],
            pace[:count],
            self._free.lay(acceleration / k1),
            self._drag.lay(velocity / (k1 * speed)),
        )
