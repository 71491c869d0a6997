"""Tests of measured plate angles against commanded ones: opposite direction, wrong scale."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from controllers.arrays import Array


@dataclass(frozen=True, kw_only=True)
class DirectionTest:
    """When a plate counts as turning against its commands.

    Attributes:
        memory: Duration in s of the motion that is looked at.
        delays: How many s later than its command the plate may move.
        commanded: Minimum range of the command in rad.
        slope: Measured angle per commanded one, at most, at every delay.
        every: Number of periods from one look to the next.
    """

    memory: float = 0.6
    delays: tuple[float, ...] = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25)
    commanded: float = math.radians(2.0)
    slope: float = -0.4
    every: int = 8

    def opposite(self, commanded: Array, measured: Array, period: float) -> bool:
        """Whether an axis turned the other way, by its angles in rad period by period, (n,)."""
        slopes = []
        for delay in self.delays:
            lag = round(delay / period)
            asked, seen = commanded[: len(commanded) - lag], measured[lag:]
            if len(asked) < 2 or not np.ptp(asked) >= self.commanded:
                return False
            asked = asked - asked.mean()
            slopes.append(float(asked @ (seen - seen.mean())) / float(asked @ asked))
        return max(slopes) <= self.slope


@dataclass(frozen=True, kw_only=True)
class ScaleTest:
    """When a plate that misses its command counts as moving on a wrong scale.

    The measured angle is explained by the commanded one, delayed and behind a first-order lag:
    measured = gain * lagged(commanded, delay) + constant, by least squares, with an unknown start
    of the lag.

    Attributes:
        delays: How many s later than its command the plate may move.
        lags: Time constants in s with which it may follow.
        commanded: Minimum range of the command in rad.
        unexplained: Share of the motion, as root of the mean square, that may be left.
        too_far: Gain from which no lag and no slow servo explains the motion.
        too_near: Gain below which the plate is reported to turn too little.
    """

    delays: tuple[float, ...] = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25)
    lags: tuple[float, ...] = (0.0, 0.05, 0.1, 0.2)
    commanded: float = math.radians(2.0)
    unexplained: float = 0.1
    too_far: float = 1.3
    too_near: float = 0.75

    def gain(self, commanded: Array, measured: Array, period: float) -> float | None:
        """Measured per commanded angle, both in rad period by period, (n,).

        None where the command moves too little, or where no delay and lag explains the motion.
        """
        best: tuple[float, float] | None = None
        time = period * np.arange(len(commanded))
        for lag in self.lags:
            followed = _follow(commanded, 1 - math.exp(-period / lag)) if lag else commanded
            unknown = np.ones((len(time), 1))  # where the encoder has its zero, and the start
            if lag:
                unknown = np.column_stack((unknown, np.exp(-time / lag)))
            for delay in self.delays:
                late = round(delay / period)
                asked, seen = followed[: max(0, len(followed) - late)], measured[late:]
                if len(asked) < 2 or not np.ptp(asked) >= self.commanded:
                    continue
                known = np.column_stack((asked, unknown[: len(asked)]))
                fitted = np.linalg.lstsq(known, seen, rcond=None)[0]
                left = float(np.square(seen - known @ fitted).sum() / max(np.var(seen), 1e-12))
                if best is None or left / len(seen) < best[0]:
                    best = left / len(seen), float(fitted[0])
        return best[1] if best and best[0] <= self.unexplained**2 else None


def _follow(angle: Array, share: float) -> Array:
    """An angle in rad, (n,), behind a first-order lag that takes in a share each period."""
    followed, now = np.empty_like(angle), angle[0]
    for index, each in enumerate(angle):
        now += share * (each - now)
        followed[index] = now
    return followed


SCALE_TEST = ScaleTest()
DIRECTION_TEST = DirectionTest()
UNDELAYED_DIRECTION_TEST = DirectionTest(delays=(0.0,))
"""The same for a plate that is known not to be where it should be, to tell in which way."""
