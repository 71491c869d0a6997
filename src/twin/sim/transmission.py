"""Transmissions of simulated rigs: wrong ones, and one per rig."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from controllers.arrays import Array, Number, column
from twin.hal.interface import Transmission
from twin.settings import Unit, setting


@dataclass(frozen=True, kw_only=True)
class TransmissionError:
    """How wrong what a rig knows of its cams is.

    Fields may be arrays with one entry per rig.

    Attributes:
        slope: How much too far each axis is taken, dimensionless, for (phi, theta), shape (2,) or
            (N, 2).
        coupling: Share of one axis's angle that turns the other, too, dimensionless.
    """

    slope: tuple[float, float] | Array = setting(
        "rig.cam_error_percent", (0.0, 0.0), Unit.PERCENT, ge=-20, le=20
    )
    coupling: Number = setting("rig.cam_coupling_percent", 0.0, Unit.PERCENT, ge=-20, le=20)

    @property
    def any(self) -> bool:
        """Whether there is an error at all."""
        return bool(np.any(self.slope) or np.any(self.coupling))


@dataclass(frozen=True)
class WrongTransmission:
    """A transmission that takes the plate not quite where it should be.

    Attributes:
        known: The transmission as it should be.
        error: What is wrong with it.
    """

    known: Transmission
    error: TransmissionError

    def motor(self, plate: Array) -> Array:
        """Motor angles in rad for the requested plate angles in rad, both (N, 2)."""
        moved = (1 + np.asarray(self.error.slope)) * plate
        if np.any(self.error.coupling):
            moved = moved + column(self.error.coupling) * plate[..., ::-1]
        return self.known.motor(moved)


class PerRigTransmission:
    """A transmission per rig.

    Args:
        members: One per rig; those that are one and the same object are looked up together.
    """

    def __init__(self, members: Sequence[Transmission]) -> None:
        distinct = list({id(member): member for member in members}.values())
        which = np.array([next(i for i, d in enumerate(distinct) if d is m) for m in members])
        self._groups = [(np.flatnonzero(which == i), each) for i, each in enumerate(distinct)]

    def motor(self, plate: Array) -> Array:
        """Motor angles in rad for plate angles in rad, both (N, 2)."""
        found = np.empty_like(plate)
        for rigs, member in self._groups:
            found[rigs] = member.motor(plate[rigs])
        return found
