"""A rig with simulated devices: any plant behind imperfect drives and sensors."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from controllers.arrays import Array, Mask, every, put
from twin.hal.interface import Limits, Touch, Transmission
from twin.hal.rig import Rig
from twin.hal.supervisor import Supervisor
from twin.sim import sensors
from twin.sim.drives import DriveModel, SimulatedDrives
from twin.sim.plant.interface import Plant
from twin.sim.sensors import Noise, Rigs

MAX_SWING_RAD = math.radians(5.0)
"""How far a plate on a soft drive train may swing further as it is levelled, rad; no encoder of a
simulated rig counts the wrong way."""


class SimulatedDevices:
    """Servos, touch screen and clock of N simulated rigs, all looking at one plant.

    Args:
        plant: What is simulated, started.
        period: Control period in s, a whole number of physics steps.
        touch: Imperfections of the touch screen.
        encoders: Imperfections of the plate encoders.
        drives: Imperfections of the drives beyond those of the plant, and their disturbance.
        hold: Control periods for which noise and disturbance are held.
        axes: How many axes the rigs have; of 1 nothing turns theta.
        seeds: One seed sequence per rig; it spawns those of screen, frames, encoders,
            disturbance, vibration.
    """

    def __init__(
        self,
        plant: Plant,
        *,
        period: float,
        touch: sensors.TouchModel,
        encoders: sensors.EncoderModel,
        drives: DriveModel,
        hold: sensors.HeldPeriods = 1,
        axes: int = 2,
        seeds: Sequence[np.random.SeedSequence],
    ) -> None:
        self.plant, self._axes = plant, axes
        self._steps = round(period / plant.step)
        self._period = period
        self._screen = sensors.SimulatedScreen(touch, period, seeds, hold)
        self._encoders = sensors.SimulatedEncoders(encoders, seeds, hold)
        shaken = self._shaken(drives)
        self._disturbance = Noise(shaken, [s.spawn(1)[0] for s in seeds], hold)
        self._drives = SimulatedDrives(drives, period, plant.ratio, seeds)
        self._drift: Array = np.zeros((plant.rigs, 2))
        self._rate: Array = np.zeros((plant.rigs, 2))
        self._followed: Array = self._rate
        self._tick = 0
        self._look()

    def _shaken(self, drives: DriveModel) -> Array:
        """Variances of the steps of the motor rates that add up to the plate's accelerations."""
        return (self.plant.ratio * self._period) ** 2 * np.asarray(drives.disturbance)

    def change(self, model: sensors.TouchModel | sensors.EncoderModel | DriveModel) -> None:
        """Have other imperfections from now on; of the plate encoders their counts stay."""
        if isinstance(model, sensors.TouchModel):
            self._screen.change(model)
        elif isinstance(model, sensors.EncoderModel):
            self._encoders.change(model)
        else:
            self._drives.change(model, self._followed)
            self._disturbance.change(self._shaken(model))

    def adopt(self, rigs: Rigs, other: SimulatedDevices) -> None:
        """Let some rigs go on as others that have just begun and are equipped alike.

        Args:
            rigs: Which.
            other: The devices of as many rigs, around those of this plant, which have begun.
        """
        self._screen.adopt(rigs, other._screen)
        self._encoders.adopt(rigs, other._encoders)
        self._disturbance.adopt(rigs, other._disturbance)
        self._drives.adopt(rigs, other._drives)
        self._drift = put(self._drift, rigs, other._drift)
        self._rate = put(self._rate, rigs, other._rate)
        self._followed = put(self._followed, rigs, other._followed)
        self.state, self.on_plate = self.plant.state, self.plant.on_plate

    @property
    def time(self) -> float:
        """Simulated seconds since the start."""
        return self._tick * self._period

    def wait(self) -> None:
        """Simulate one control period."""
        rate = self._rate if self._drives.ideal else self._drives.follow(self._rate)
        self._followed = self._rate
        if not self._disturbance.silent:
            self._drift += self._disturbance.draw()
            rate = rate + self._drift
        if self._axes == 1:
            rate = np.where((True, False), rate, 0.0)
        self.plant.advance(rate, self._steps)
        self._tick += 1
        self._look()

    def begin_at(self, time: float) -> None:
        """Let it be a time in s now."""
        self._tick = round(time / self._period)

    def place(self, ball: Array) -> None:
        """Put the balls at (x, x', y, y') in m and m/s, shape (N, 4), the plates as they are."""
        self.plant.place(ball)
        self.state = self.plant.state
        self.on_plate = self.plant.on_plate

    def forget(self) -> None:
        """Let the screen take the balls to have been where they are all the time."""
        self._screen.forget(self.state[:, 0::4])

    def rest(self) -> None:
        """Forget the disturbance that has added up: drives without torque make none."""
        self._drift[:] = 0.0

    def read(self) -> Touch:
        """The newest touch sample that has arrived."""
        return self._screen.read()

    def plate(self) -> Array:
        """Plate angles (phi, theta) as the encoders count them, rad, shape (N, 2)."""
        return self._encoders.read(self.state[:, 2::4].copy())

    def motor(self) -> Array:
        """Motor angles in rad, before what is lost on the way to the shafts, shape (N, 2)."""
        return self.plant.motor + self._drives.ahead

    def command(self, motor_rate: Array) -> None:
        """Motor rates in rad/s, shape (N, 2), held until the next command."""
        self._rate = motor_rate

    def _look(self) -> None:
        self.state = self.plant.state
        self.on_plate = self.plant.on_plate
        self._screen.see(self.state[:, 0::4], self.on_plate)


class SimulatedRig(Rig):
    """N simulated rigs; hands over only what real ones would, unless it is to be ideal.

    Args:
        devices: The simulated devices, their plant started.
        transmission: Plate angles to motor angles.
        limits: What may be commanded.
        period: Control period in s.
        ideal: Whether measurements carry the full true state, as the thesis's simulations of full
            state feedback assume; no real rig can.
        anchor: Time in s after which the cams are looked up where the plate is measured, again.
    """

    def __init__(
        self,
        devices: SimulatedDevices,
        *,
        transmission: Transmission,
        limits: Limits,
        period: float,
        ideal: bool = False,
        anchor: float = Rig.ANCHOR,
    ) -> None:
        super().__init__(
            servos=devices,
            screen=devices,
            clock=devices,
            transmission=transmission,
            supervisor=Supervisor(limits, period, devices.plant.rigs, grown=MAX_SWING_RAD),
            period=period,
            anchor=anchor,
        )
        self.devices = devices
        self.channels = devices.plant.channels
        self._ideal = ideal

    def truth(self) -> Array | None:
        """The true state for the measurement, shape (N, 8), if the rig is ideal."""
        return self.devices.state if self._ideal else None

    @property
    def fallen(self) -> Mask:
        """Whether a ball has left the plate, shape (N,)."""
        return ~self.devices.on_plate

    @property
    def any_fallen(self) -> bool:
        """Whether any ball has left the plate."""
        return not every(self.devices.on_plate)

    @property
    def diverged(self) -> Mask:
        """Whether a rig's numbers have run away, shape (N,)."""
        return self.devices.plant.diverged

    def telemetry(self) -> dict[str, Array]:
        """True state and the plant's own channels."""
        return {"state": self.devices.state, "plant": self.devices.plant.telemetry()}
