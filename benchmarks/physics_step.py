"""What a physics step of 2 ms gets wrong beside one of 1 ms.

Errors are those to a step of 0.25 ms: of the ball's path over 10 s in closed loop, with the same
noise, and of numbers about ball, plate and wheels.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from benchmarks.truths import RUNS, SECONDS, TRUTHS, path
from controllers.arrays import Array

FINE, STEPS = 0.00025, (0.001, 0.002)


class Deviation(NamedTuple):
    """What differs at 1 ms and at 2 ms from the fine step, with the value at that."""

    name: str
    fine: str
    at_1_ms: str
    at_2_ms: str

    @classmethod
    def of(cls, name: str, unit: str, number: Callable[[float], float]) -> Deviation:
        """Of a number that a step gives."""
        fine = number(FINE)
        coarse = [number(step) - fine for step in STEPS]
        digits = 4 if abs(fine) > 1e-6 else 2
        return cls(name, f"{fine:.{digits}g} {unit}", *(f"{each:+.2g}" for each in coarse))


def paths(seconds: float = SECONDS, names: tuple[str, ...] = tuple(RUNS)) -> Iterator[Deviation]:
    """Of the ball's path: rms and largest, um, and of the rms tracking error, %."""
    for name in names:
        ball, desired = path(FINE, name, seconds)

        def missed(ball: Array, desired: Array = desired) -> float:
            late = len(desired) // 2
            return float(np.sqrt(np.mean((ball - desired)[late:] ** 2) * 2))

        found = []
        for step in STEPS:
            coarse = path(step, name, seconds)[0]
            if len(coarse) != len(ball):
                found.append("ends at another time")
                continue
            off = 1e6 * np.hypot(*(coarse - ball).T)
            share = 100 * (missed(coarse) / missed(ball) - 1)
            found.append(f"{np.sqrt(np.mean(off**2)):.0f}, {off.max():.0f} um; {share:+.2f} %")
        yield Deviation(name, f"{1e3 * missed(ball):.2f} mm", *found)


def numbers() -> Iterator[Deviation]:
    """Of what is known of ball, plate and wheels."""
    for name, (unit, number) in TRUTHS.items():
        yield Deviation.of(name, unit, number)
