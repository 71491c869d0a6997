"""Transmissions of simulated rigs: one that is wrong, and one per rig."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from controllers.arrays import Array, Number, column
from controllers.per_rig import Groups
from twin.base.settings import Unit, ramp
from twin.hal.interface import Transmission
from twin.sim.drives import SERVO_FOLLOWERS

CAM_FOLLOWERS = replace(SERVO_FOLLOWERS, identify="has the plate's angles from its encoders")


@dataclass(frozen=True, kw_only=True)
class TransmissionError:
    """How wrong what a rig knows of its cams is.

    Fields may be arrays with one entry per rig.

    Attributes:
        slope: How much too far each axis is taken, dimensionless, for (phi, theta), shape (2,) or
            (N, 2).
        coupling: Share of one axis's angle that turns the other, too, dimensionless.
    """

    slope: tuple[float, float] | Array = ramp(
        "rig.cam_error_percent",
        (0.0, 0.0),
        Unit.PERCENT,
        followed_by=CAM_FOLLOWERS.by("cams"),
        ge=-20,
        le=20,
    )
    coupling: Number = ramp(
        "rig.cam_coupling_percent",
        0.0,
        Unit.PERCENT,
        followed_by=CAM_FOLLOWERS.by("cam_coupling"),
        ge=-20,
        le=20,
    )

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
        own, other = np.asarray(self.error.slope), column(self.error.coupling)
        return self.known.motor((1 + own) * plate + other * plate[..., ::-1])


class PerRigTransmission:
    """A transmission per rig.

    Args:
        members: One per rig; those that are one and the same object are looked up together.
    """

    def __init__(self, members: Sequence[Transmission]) -> None:
        self._groups = Groups(members).each

    def motor(self, plate: Array) -> Array:
        """Motor angles in rad for plate angles in rad, both (N, 2)."""
        found = np.empty_like(plate)
        for rigs, member in self._groups:
            found[rigs] = member.motor(plate[rigs])
        return found
