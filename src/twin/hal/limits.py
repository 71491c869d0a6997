"""What a rig may be told to do, and the clamp that keeps every command within it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controllers.arrays import Array


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What a rig may be told to do, and where and how fast its ball may be; SI units.

    Attributes:
        angle: Plate angle either way, rad; thesis chapter 3: 10 deg.
        rate: Plate rate either way, rad/s; assumed, the thesis limits it without a number.
        acceleration: Plate acceleration either way, rad/s^2; thesis chapter 3: 7.
        area: Operating area |x|, |y| of references, m; thesis chapter 3: 0.25 x 0.15.
        margin: How far the ball may stray beyond the area before the rig stops, m; assumed.
        ball_speed: Speed of the ball along x or y at which the rig stops, m/s; assumed: what it
            gains from 10 deg over the plate's length is 1.3.
    """

    angle: float = np.pi / 18
    rate: float = 0.6
    acceleration: float = 7.0
    area: tuple[float, float] = (0.25, 0.15)
    margin: float = 0.04
    ball_speed: float = 1.5


class Clamp:
    """Keeps plate rates within rate, acceleration and what can be braked before the angle limit.

    Args:
        limits: What may be commanded.
        period: Control period in s.
    """

    def __init__(self, limits: Limits, period: float) -> None:
        self._acceleration = limits.acceleration
        self._period = period
        self._step = limits.acceleration * period
        self._half_step = self._step / 2
        self._whole_way = 2 * limits.acceleration * limits.angle
        self._per_angle = 2 * limits.acceleration * np.array([1.0, -1.0])[:, None, None]
        self._least, self._most = self._half_step**2, (limits.rate + self._half_step) ** 2

    def __call__(self, wish: Array, rate: Array, angle: Array) -> Array:
        """The rates that may be commanded for the wished ones, rad/s, shape (N, 2).

        Args:
            wish: Finite rates wished, rad/s, shape (N, 2).
            rate: Rates commanded last, rad/s, shape (N, 2).
            angle: Plate angles, rad, shape (N, 2).
        """
        # A rate v braked by one step a period covers at most (v + step / 2)^2 / (2 a), so this is
        # the square of v + step / 2 that the way to the angle limit allows, upwards and downwards.
        square = self._whole_way - self._per_angle * angle
        square = np.minimum(np.maximum(square, self._least), self._most)
        up, down = np.sqrt(square) - self._half_step
        wish = np.minimum(np.maximum(wish, -down), up)
        rates: Array = np.minimum(np.maximum(wish, rate - self._step), rate + self._step)
        return rates

    def towards_level(self, angle: Array) -> Array:
        """The rates that bring the plate level, with half of the acceleration allowed."""
        rate: Array = -np.sign(angle) * np.minimum(
            np.sqrt(self._acceleration * np.abs(angle)), np.abs(angle) / (10 * self._period)
        )
        return rate
