"""A motion of ball and plate that makes the ball follow a reference, laid ahead in slices."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import NamedTuple

from controllers.arrays import Array
from controllers.ballplate import BallPlate
from controllers.interfaces import Reference
from controllers.preview import Preview
from controllers.two_sided import Tilts, TwoSided


class DesiredMotion(NamedTuple):
    """What ball and plate are to do at one tick."""

    position: Array
    """Of the ball, m, shape (..., 2)."""
    velocity: Array
    """Of the ball, m/s, shape (..., 2)."""
    slope: Tilts
    """Of the plate, (phi, -theta), rad."""


class Slices(ABC):
    """What is laid ahead slice by slice and asked for tick by tick, for one run.

    Args:
        preview: Where the path ahead comes from; a slice has as many ticks as it advances.
        period: Control period in s.
    """

    def __init__(self, preview: Preview, period: float) -> None:
        self._preview, self._period = preview, period
        self._first = -preview.count
        self._advance()

    def _tick(self, t: float) -> int:
        """Where in its slice a time in s stands that does not lie before the one asked for last."""
        tick = round(t / self._period) - self._first
        while tick >= self._preview.count:
            self._advance()
            tick -= self._preview.count
        return tick

    def _advance(self) -> None:
        self._lay(*self._preview.advance())
        self._first += self._preview.count

    @abstractmethod
    def _lay(self, position: Array, velocity: Array, acceleration: Array) -> None:
        """Lay the next slice from the path of its ticks and of all that are previewed."""


class MotionPlan(Slices):
    """The motion for one run: the plate's by the stable, two-sided inverse of the ball's.

    Args:
        model: Ball and plate.
        x: State at the start, shape (..., 8).
        reference: Path of the ball.
        period: Control period in s.
        preview: How far the reference is asked ahead, s.
        spread: Time in s over which a jump of 0.15 m is spread; 0 leaves jumps as they are.
    """

    def __init__(
        self,
        model: BallPlate,
        x: Array,
        reference: Reference,
        period: float,
        preview: float,
        spread: float,
    ) -> None:
        self._k1 = model.k1
        ahead = Preview(reference, x[..., 0::4], period, preview, spread)
        self._inverse = inverse(model, ahead, period)
        super().__init__(ahead, period)

    def at(self, t: float) -> DesiredMotion:
        """What is wanted at a time in s that does not lie before the one asked for last."""
        tick = self._tick(t)
        position, velocity, slope = self._laid
        return DesiredMotion(position[tick], velocity[tick], Tilts(*(each[tick] for each in slope)))

    def _lay(self, position: Array, velocity: Array, acceleration: Array) -> None:
        count = self._preview.count
        slope = self._inverse.lay(acceleration / self._k1)
        self._laid = DesiredMotion(position[:count], velocity[:count], slope)


def inverse(model: BallPlate, preview: Preview, period: float) -> TwoSided:
    """The inverse of a plant for the windows of a preview."""
    return TwoSided(math.sqrt(model.k1 / model.c2), period, preview.count, preview.length)
