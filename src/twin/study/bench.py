"""The devices of N simulated rigs that differ from one another, as those of one scenario each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import radians
from typing import cast

import numpy as np

from controllers.arrays import Array, Mask
from twin.scenario import Scenario
from twin.sim.drives import DriveModel, SimulatedDrives
from twin.sim.plant.interface import Plant
from twin.sim.rig import Bench
from twin.sim.sensors import EncoderModel, Noise, SimulatedEncoders, SimulatedScreen, TouchModel


class Rigs(Bench):
    """A bench whose rigs have the seed, dead time and servo bandwidth of a scenario each.

    Noise is that of each scenario run alone.

    Args:
        plant: What is simulated, started.
        scenarios: One a rig, otherwise alike.
    """

    def __init__(self, plant: Plant, scenarios: Sequence[Scenario]) -> None:
        first = scenarios[0]
        period, about = first.rig.period, first.sensors.touch
        hold = round(max(first.sensors.noise_hold, period) / period)
        late = np.array([scenario.sensors.touch.dead_time for scenario in scenarios])
        touch = TouchModel(
            dead_time=float(late.max()),
            spread=about.dead_time_spread,
            frame_rate=about.frame_rate,
            grid=about.grid,
            variance=about.variance,
            rotation=radians(about.rotation_deg),
        )
        encoders = EncoderModel(**dict(first.sensors.encoders))
        super().__init__(plant, period=period, touch=touch, encoders=encoders, hold=hold)
        streams = [np.random.SeedSequence(s.seed, spawn_key=(0,)) for s in scenarios]
        self._screen = Screens(touch, period, streams, hold, late)
        self._encoders = SimulatedEncoders(encoders, streams, hold)
        servo = first.plant.servo
        self._drives = Drives(
            DriveModel(bandwidth=servo.bandwidth_hz, backlash=radians(servo.backlash_deg)),
            period,
            plant.ratio,
            np.array([scenario.plant.servo.bandwidth_hz for scenario in scenarios]),
        )
        step = (plant.ratio * period) ** 2 * np.asarray(first.disturbance.variance)
        self._disturbance = Noise(step, [s.spawn(1)[0] for s in streams], hold)
        self._look()


class Screens(SimulatedScreen):
    """Touch screens with a dead time each.

    Args:
        model: What they have in common; its dead time is the longest.
        period: Control period in s.
        seeds: One seed sequence a rig.
        hold: Control periods for which a noise draw is held.
        late: Dead times in s, shape (N,).
    """

    def __init__(
        self,
        model: TouchModel,
        period: float,
        seeds: Sequence[np.random.SeedSequence],
        hold: int,
        late: Array,
    ) -> None:
        super().__init__(model, period, seeds, hold)
        back = late / period
        self._whole = np.floor(back).astype(int)
        self._share = (back - self._whole)[:, None]
        # as for one rig: a dead time of whole periods needs no older sample
        self._share[self._share < 1e-9] = 0.0
        self._even = not self._share.any()
        self._late = late.copy()
        self._latest = cast("float", late + 4 * model.spread)
        self.model = replace(model, dead_time=cast("float", late))

    def _look_back(self, periods: float) -> tuple[Array, Mask]:
        newer = (self._tick - self._whole) % self._length
        share, rows = self._share, self._rows
        if self._even:
            return self._past[newer, rows], self._felt[newer, rows]
        older = (newer - 1) % self._length
        position = (1 - share) * self._past[newer, rows] + share * self._past[older, rows]
        return position, self._felt[newer, rows]


class Drives(SimulatedDrives):
    """Drives with a bandwidth each; all have one, or none.

    Args:
        model: What they have in common.
        period: Control period in s.
        ratio: Motor angle per plate angle, dimensionless.
        bandwidth: Corner frequencies in Hz, shape (N,).
    """

    def __init__(self, model: DriveModel, period: float, ratio: float, bandwidth: Array) -> None:
        super().__init__(model, period, ratio)
        single = [
            SimulatedDrives(replace(model, bandwidth=each), period, ratio) for each in bandwidth
        ]
        self._left = cast("float", np.array([[each._left] for each in single]))
        self._mean = cast("float", np.array([[each._mean] for each in single]))
