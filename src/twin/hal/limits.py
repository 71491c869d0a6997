"""What may be commanded of a rig, and the clamp that keeps every command within it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from controllers.arrays import Arithmetic, Array, Number, column, elementwise
from twin.settings import Unit, setting


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What may be commanded of a rig, and where and how fast its ball may be; SI units.

    Fields are numbers, or arrays with one entry per rig.

    Attributes:
        angle: Plate angle either way, rad; thesis chapter 3: 10 deg.
        rate: Plate rate either way, rad/s; assumed, the thesis limits it without a number.
        acceleration: Plate acceleration either way, rad/s^2; thesis chapter 3: 7.
        area: Operating area |x|, |y| of references, m; thesis chapter 3: 0.25 x 0.15.
        margin: How far the ball may stray beyond the area before the rig stops, m; assumed.
        ball_speed: Speed of the ball along x or y at which the rig stops, m/s; assumed: what it
            gains from 10 deg over the plate's length is 1.3.
    """

    angle: Number = setting("rig.limits.angle_deg", 10.0, Unit.DEG, gt=0, le=10)
    rate: Number = setting("rig.limits.rate_deg", 35.0, Unit.DEG, gt=0)
    acceleration: Number = setting("rig.limits.acceleration", 7.0, gt=0)
    area: tuple[float, float] | Array = setting("rig.limits.area", (0.25, 0.15), gt=0)
    margin: Number = setting("rig.limits.margin", 0.04, ge=0)
    ball_speed: Number = setting("rig.limits.ball_speed", 1.5, gt=0)


class Clamp:
    """Keeps plate rates within rate, acceleration and what can be braked before the angle limit.

    Args:
        limits: What may be commanded.
        period: Control period in s.
    """

    def __init__(self, limits: Limits, period: float) -> None:
        angle, rate, acceleration = map(column, (limits.angle, limits.rate, limits.acceleration))
        self._acceleration = acceleration
        self._period = period
        self._step = acceleration * period
        self._half_step = self._step / 2
        self._whole_way = 2 * acceleration * angle
        self._per_angle = 2 * acceleration
        self._least, self._most = self._half_step**2, (rate + self._half_step) ** 2

    def __call__(self, requested: Array, rate: Array, angle: Array) -> Array:
        """The rates that may be commanded for the requested ones, rad/s, shape (N, 2).

        Args:
            requested: Finite rates, rad/s, shape (N, 2).
            rate: Rates commanded last, rad/s, shape (N, 2).
            angle: Plate angles, rad, shape (N, 2).
        """
        return elementwise(self._allowed, requested, rate, angle)

    def _allowed(self, by: Arithmetic, requested: Any, rate: Any, angle: Any) -> Any:
        """The same for each plate axis."""
        back = requested < 0
        towards = by.where(back, -angle, angle)
        # A rate v braked by one step per period covers at most (v + step / 2)^2 / (2 a), so this
        # is the square of v + step / 2 that the way to the angle limit allows.
        square = self._whole_way - self._per_angle * towards
        largest = by.sqrt(by.least(by.most(square, self._least), self._most)) - self._half_step
        size = by.least(largest, abs(requested))
        requested = by.where(back, -size, size)
        return by.least(by.most(requested, rate - self._step), rate + self._step)

    def towards_level(self, angle: Array) -> Array:
        """The rates that bring the plate level, with half of the acceleration allowed."""
        rate: Array = -np.sign(angle) * np.minimum(
            np.sqrt(self._acceleration * np.abs(angle)), np.abs(angle) / (10 * self._period)
        )
        return rate
