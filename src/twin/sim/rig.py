"""A rig whose devices are simulated: any plant, seen through the sensors' imperfections."""

from __future__ import annotations

import numpy as np

from controllers.arrays import Array, Mask
from controllers.interfaces import Measurement
from twin.hal.interface import Touch
from twin.hal.limits import Limits
from twin.hal.rig import Rig, Transmission
from twin.hal.supervisor import Supervisor
from twin.sim.drives import DriveModel, SimulatedDrives
from twin.sim.plant.interface import Plant
from twin.sim.sensors import EncoderModel, Noise, SimulatedEncoders, SimulatedScreen, TouchModel


class Bench:
    """Servos, touch screen and clock of N simulated rigs, all looking at one plant.

    Args:
        plant: What is simulated.
        period: Control period in s, a whole number of physics steps.
        touch: Imperfections of the touch screen.
        encoders: Imperfections of the plate encoders.
        drives: Imperfections of the drives; None for those of the plant alone.
        disturbance: Variances of the white plate accelerations added to the commanded ones,
            (rad/s^2)^2, for phi and theta; Table B.1.
        hold: Control periods for which noise and disturbance are held.
        seed: Root of all random streams.
    """

    def __init__(
        self,
        plant: Plant,
        *,
        period: float,
        touch: TouchModel,
        encoders: EncoderModel,
        drives: DriveModel | None = None,
        disturbance: tuple[float, float] = (0.0, 0.0),
        hold: int = 1,
        seed: int = 0,
    ) -> None:
        self.plant = plant
        self._steps = round(period / plant.step)
        self._period = period
        streams = [np.random.SeedSequence(seed, spawn_key=(rig,)) for rig in range(plant.rigs)]
        self._screen = SimulatedScreen(touch, period, streams, hold)
        self._encoders = SimulatedEncoders(encoders, streams, hold)
        self._drives = SimulatedDrives(drives or DriveModel(), period, plant.ratio)
        # Accelerations of the plate, drawn as steps of the motor rates they add up to.
        step = (plant.ratio * period) ** 2 * np.asarray(disturbance)
        self._disturbance = Noise(step, [s.spawn(1)[0] for s in streams], hold)
        self._drift: Array = np.zeros((plant.rigs, 2))
        self._rate: Array = np.zeros((plant.rigs, 2))
        self._tick = 0
        self._look()

    @property
    def time(self) -> float:
        """Simulated seconds since the start."""
        return self._tick * self._period

    def wait(self) -> None:
        """Simulate one control period."""
        rate = self._rate if self._drives.ideal else self._drives.follow(self._rate)
        if not self._disturbance.silent:
            self._drift += self._disturbance.draw()
            rate = rate + self._drift
        self.plant.advance(rate, self._steps)
        self._tick += 1
        self._look()

    def rest(self) -> None:
        """Forget the disturbance that has added up: drives without torque make none."""
        self._drift[:] = 0.0

    def read(self) -> Touch:
        """The newest touch sample that has arrived."""
        return self._screen.read()

    def plate(self) -> Array:
        """Plate angles (phi, theta) as the encoders count them, rad, shape (N, 2)."""
        return self._encoders.read(self.state[:, 2::4])

    def motor(self) -> Array:
        """Motor shaft angles in rad, shape (N, 2)."""
        return self.plant.motor

    def command(self, motor_rate: Array) -> None:
        """Motor rates in rad/s, shape (N, 2), held until the next command."""
        self._rate = motor_rate

    def _look(self) -> None:
        self.state = self.plant.state
        self.on_plate = self.plant.on_plate
        self._screen.see(self.state[:, 0::4], self.on_plate)


class SimulatedRig(Rig):
    """N simulated rigs; hands over only what real ones would, unless told to be ideal.

    Args:
        bench: The simulated devices, their plant started.
        transmission: Plate angles to motor angles.
        limits: What may be commanded.
        period: Control period in s.
        ideal: Whether measurements carry the full true state, as the thesis's simulations of full
            state feedback assume; no real rig can.
    """

    def __init__(
        self,
        bench: Bench,
        *,
        transmission: Transmission,
        limits: Limits,
        period: float,
        ideal: bool = False,
    ) -> None:
        super().__init__(
            servos=bench,
            screen=bench,
            clock=bench,
            transmission=transmission,
            supervisor=Supervisor(limits, period, bench.plant.rigs),
            period=period,
        )
        self.bench = bench
        self.channels = bench.plant.channels
        self._ideal = ideal

    def read(self) -> Measurement:
        """What the sensors say now, with the true state beside it if ideal."""
        measurement = super().read()
        if not self._ideal:
            return measurement
        return Measurement(
            measurement.time, measurement.y, measurement.age, measurement.touched, self.bench.state
        )

    @property
    def fallen(self) -> Mask:
        """Whether a ball has left the plate, shape (N,)."""
        return ~self.bench.on_plate

    @property
    def diverged(self) -> Mask:
        """Whether a rig's numbers have run away, shape (N,)."""
        return self.bench.plant.diverged

    def telemetry(self) -> dict[str, Array]:
        """True state and the plant's own channels."""
        return {"state": self.bench.state, "plant": self.bench.plant.telemetry()}
