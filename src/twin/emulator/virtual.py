"""The plant behind emulated devices: moved by the drives' shafts, seen by their encoders."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin.emulator.drive import EmulatedDrive
from twin.hal.interface import Touch, Transmission
from twin.run.assemble import build_devices, start_plant
from twin.run.changes import change_devices, changing_devices
from twin.run.plants import build_plant
from twin.scenario.schema import Scenario
from twin.sim.rig import SimulatedDevices
from twin.sim.sensors import EncoderModel, TouchModel

TICK = 0.001
"""Longest step in s of the plant between two looks at the drives."""


class EmulatedPlant:
    """A scenario's plant, with its noise and its drives' imperfections, for emulated devices.

    Dead time, frames and quantisation are those of the emulated devices.

    Args:
        scenario: Whose plant it is.

    Raises:
        ModelError: The mechanism or its cam table cannot be used.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        plant, self.transmission = build_plant([scenario])
        self._tick = plant.step * max(1, int(TICK / plant.step + 1e-9))
        touch, encoders = scenario.sensors.touch, scenario.sensors.encoders
        self.dead_time = touch.dead_time
        """Time in s from a touch to its arrival, now."""
        self.devices: SimulatedDevices = build_devices(
            [scenario],
            plant,
            period=self._tick,
            touch=TouchModel(dead_time=0.0, grid=0, variance=touch.variance),
            encoders=EncoderModel(counts=0, variance=encoders.variance),
        )
        self._changes = changing_devices(self.devices, [scenario], self._change)
        self._begun: float | None = None
        self.present = True
        """Whether there is a ball that the screen can sense."""
        self.shoved = np.zeros(2)
        """Rates in rad/s by which somebody turns the motor shafts besides the drives."""
        self._owed = 0.0
        self._dipped = np.zeros(2)
        self._drives: Sequence[EmulatedDrive] = ()

    transmission: Transmission
    """Plate angles to motor angles, as the scenario's rig knows them."""

    _touch: Touch
    """What the screen is touched by now."""

    def attach(self, drives: Sequence[EmulatedDrive]) -> None:
        """Let the drives, phi then theta, move the plant and read its encoders."""
        self._drives = drives[:2]
        self._sense()

    def begin(self) -> None:
        """The run's time is zero now: what its scenario changes is counted from here."""
        self._begun = self.devices.time

    def _change(self, old: Sequence[Scenario], new: Sequence[Scenario]) -> None:
        self.dead_time = new[0].sensors.touch.dead_time
        change_devices(self.devices, old, new, touch={"dead_time": 0.0})

    def advance(self, seconds: float) -> None:
        """Let time pass in whole ticks; the rest is kept for the next call."""
        self._owed += seconds
        while self._owed > self._tick - 1e-9:
            self._owed -= self._tick
            if not any(drive.enabled for drive in self._drives):
                self.devices.rest()
            if self._begun is not None:
                self._changes(self.devices.time - self._begun)
            self.devices.command(np.array([[drive.rate for drive in self._drives]]) + self.shoved)
            self.devices.wait()
            self._sense()

    def restart(self) -> None:
        """Put the ball back to where the scenario starts, the plate level."""
        start_plant(self.devices.plant, [self._scenario])
        self.devices.command(np.zeros((1, 2)))
        self.devices.wait()
        self._sense()

    def ball(self) -> tuple[tuple[float, float], ...]:
        """Where the ball touches the screen, m in plate axes; empty if it does not."""
        if not self.present or not self.devices.on_plate[0]:
            return ()
        x, y = self._touch.position[0].tolist()
        return ((x, y),)

    def edge(self) -> str:
        """Which edges of the plate dipped most since the last call: ``short`` or ``long``."""
        phi, theta = self._dipped
        self._dipped = np.zeros(2)
        return "short" if phi > theta else "long"

    def _sense(self) -> None:
        # sensors are read once a tick, however seldom a screen looks: their noise is drawn by it
        self._touch, plate = self.devices.read(), self.devices.plate()[0]
        motor = self.devices.motor()[0].tolist()
        for drive, shaft, angle in zip(self._drives, motor, plate.tolist(), strict=True):
            drive.sense(shaft, angle)
        self._dipped = np.maximum(self._dipped, np.abs(plate))
