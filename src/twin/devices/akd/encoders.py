"""The plate's encoders, read through the drives' second feedback."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from controllers.arrays import Array
from twin.devices.akd.axis import Axis
from twin.hal.faults import Fault


class DriveEncoders:
    """Plate encoders wired to the drives; a `PlateEncoders`.

    Args:
        axes: Gives the axes as they are now, phi then theta.
        now: Monotonic time in s.
    """

    def __init__(self, axes: Callable[[], tuple[Axis, ...]], now: Callable[[], float]) -> None:
        self._axes = axes
        self._now = now
        self._zero = [0.0, 0.0]

    def plate(self) -> Array:
        """Newest plate angles in rad, shape (1, 2)."""
        return np.array([_angles(self._axes())]) - self._zero

    def age(self) -> Array:
        """Seconds since the SYNC that sampled them, shape (1, 2); inf before the first."""
        return self._now() - np.array([[axis.plate_sampled for axis in self._axes()]])

    def home(self, plate: Array) -> None:
        """Declare the plate's present angles in rad, shape (1, 2)."""
        self._zero = [a - w for a, w in zip(_angles(self._axes()), plate[0].tolist(), strict=True)]

    def faults(self) -> tuple[Fault, ...]:
        """Nothing: what concerns them is found where the drives are watched."""
        return ()


def _angles(axes: tuple[Axis, ...]) -> list[float]:
    counters = [axis.plate for axis in axes]
    return [0.0 if each is None else each.scale.value(each.counts) for each in counters]
