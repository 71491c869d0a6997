"""What lies between a commanded motor rate and the motor's motion: bandwidth and play."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from controllers.arrays import Array


@dataclass(frozen=True, kw_only=True)
class DriveModel:
    """A drive's imperfections beyond those of the plant's own servos; zero switches each off.

    Attributes:
        bandwidth: Corner frequency in Hz of a first-order lag of the speed loop.
        backlash: Angle in rad that the drive turns without moving the plate, as plate angle.
    """

    bandwidth: float = 0.0
    backlash: float = 0.0


class SimulatedDrives:
    """Two drives of N rigs: commanded motor rates in, rates of the cam shafts out.

    Args:
        model: The imperfections.
        period: Control period in s.
        ratio: Motor angle per plate angle, dimensionless.
    """

    def __init__(self, model: DriveModel, period: float, ratio: float) -> None:
        self.ideal = model == DriveModel()
        """Whether the shafts do at once what they are told."""
        self._period = period
        self._rate: float | Array = 0.0
        # Of the step from old rate to new, what is left at the end of a period and in its mean.
        self._left = self._mean = 0.0
        if model.bandwidth > 0:
            share = 2 * math.pi * model.bandwidth * period
            self._left = math.exp(-share)
            self._mean = -math.expm1(-share) / share
        self._half = model.backlash * ratio / 2
        self._motor: float | Array = 0.0
        self._shaft: float | Array = 0.0

    def follow(self, rate: Array) -> Array:
        """Mean rates over the next period for the commanded ones, both rad/s, shape (N, 2)."""
        lacking = self._rate - rate
        mean = rate + self._mean * lacking
        self._rate = rate + self._left * lacking
        if not self._half:
            return mean
        self._motor = self._motor + self._period * mean
        moved = np.minimum(
            np.maximum(self._shaft, self._motor - self._half), self._motor + self._half
        )
        result: Array = (moved - self._shaft) / self._period
        self._shaft = moved
        return result
