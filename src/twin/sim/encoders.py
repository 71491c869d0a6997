"""The plate encoders of simulated rigs: counts and noise."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from controllers.arrays import Array, Number, column, constant
from twin.settings import setting
from twin.sim.noise import HeldPeriods, Noise, Rigs

COUNTS = 245760
"""Of a plate encoder per turn."""


@dataclass(frozen=True, kw_only=True)
class EncoderModel:
    """The plate encoders' imperfections; zero switches each off.

    Fields may be arrays with one entry per rig.

    Attributes:
        counts: Counts per revolution: 4096 pulses, fourfold decoding, and 15 more of each, for
            every plate angle printed in Tables 9.2 to 9.9 is a multiple of 360/245760 deg.
        variance: Noise variance of phi and theta in rad^2; Table B.1.
    """

    counts: Number = setting("sensors.encoders.counts", COUNTS, ge=0)
    variance: tuple[float, float] | Array = setting(
        "sensors.encoders.variance", (1.5433e-10, 1.1580e-10), otherwise=(0.0, 0.0), ge=0
    )


class SimulatedEncoders:
    """Two incremental encoders on N simulated plates.

    Args:
        model: The imperfections.
        seeds: One seed sequence per rig.
        hold: Control periods for which a noise draw is held.
    """

    def __init__(
        self, model: EncoderModel, seeds: Sequence[np.random.SeedSequence], hold: HeldPeriods = 1
    ) -> None:
        self._noise = Noise(model.variance, [s.spawn(1)[0] for s in seeds], hold)
        counts = np.asarray(column(model.counts), float)
        self._exact = counts == 0
        self._counting, self._mixed = bool(counts.any()), bool(self._exact.any())
        self._count = constant(2 * math.pi / np.where(self._exact, 1.0, counts))

    def change(self, model: EncoderModel) -> None:
        """Have the noise of another model from now on."""
        self._noise.change(model.variance)

    def adopt(self, rigs: Rigs, other: SimulatedEncoders) -> None:
        """Let some rigs go on with the noise of others that count alike."""
        self._noise.adopt(rigs, other._noise)

    def read(self, plate: Array) -> Array:
        """Measured plate angles in rad for the true ones, both (N, 2)."""
        if not self._noise.silent:
            plate = plate + self._noise.draw()
        if self._counting:
            counted = np.rint(plate / self._count) * self._count
            plate = np.where(self._exact, plate, counted) if self._mixed else counted
        return plate
