"""A transmission that the rig knows badly."""

from __future__ import annotations

from dataclasses import dataclass

from controllers.arrays import Array
from twin.hal.rig import Transmission


@dataclass(frozen=True)
class Misjudged:
    """A transmission that takes each plate axis too far by a factor.

    Attributes:
        known: The transmission as it should be.
        factor: Plate angle that comes, over the one wished, for (phi, theta), shape (2,).
    """

    known: Transmission
    factor: Array

    def motor(self, plate: Array) -> Array:
        """Motor angles in rad for the wished plate angles in rad, both (..., 2)."""
        return self.known.motor(self.factor * plate)
