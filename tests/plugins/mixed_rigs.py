"""Rigs of two kinds of devices on one simulated plant, in virtual time."""

import math
from contextlib import nullcontext

import numpy as np

from twin.devices.lumio.config import LumioConfig
from twin.devices.own import OwnServos, SeparateScreen
from twin.devices.own_config import OwnScreenConfig, OwnServosConfig
from twin.devices.own_hardware import Reading, ScreenHardware, ServoHardware
from twin.devices.realtime import RealTimeClock, Scheduling
from twin.devices.rig import HardwareRig
from twin.emulator.lockstep import LockstepRig, LockstepScreen, LockstepScreenPort
from twin.emulator.screen import Protocol
from twin.emulator.serve import EmulatedPlant
from twin.hal.cams import FixedRatio
from twin.run.controller_building import build_limits


class PlantCamera(ScreenHardware):
    """Sees the ball of a plant 60 times a second."""

    FRAME = 1 / 60

    def __init__(self, ball, now):
        self.ball, self.now = ball, now
        self.due = self.calls = self.started = self.stopped = 0
        self.silent, self.frozen, self.words = False, False, ()
        self.error = None

    def start(self):
        self.started += 1
        self.due = self.now()
        self.reading = Reading(math.nan, math.nan, self.now())

    def measure(self):
        self.calls += 1
        if self.error:
            raise self.error.with_traceback(None)
        if self.now() >= self.due and not self.silent:
            self.due = self.now() + self.FRAME
            seen = next(iter(self.ball()), (math.nan, math.nan))
            place = self.reading[:2] if self.frozen else seen
            self.reading = Reading(*place, self.now())
        return self.reading

    def stop(self):
        self.stopped += 1

    def time(self):
        return self.now()

    def faults(self):
        return self.words


class PlantServos(ServoHardware):
    """Turns the plate of a plant, on which encoders are; time passes when the host waits."""

    STEP = 0.0005

    def __init__(self, plant):
        self.plant = plant
        self.now = self.owed = 0.0
        self.rates = np.zeros(2)
        self.commands = self.started = self.stopped = 0
        self.torque, self.silent, self.words = False, False, ()
        self.error = None
        self.slope = np.zeros(2)

    def start(self):
        self.started += 1
        self.torque = True

    def measure(self):
        if not self.silent:
            self.reading = Reading.of_plate(*self.plant.devices.plate()[0].tolist(), self.now)
        return self.reading

    def command(self, rates, angles):
        self.commands += 1
        if self.error:
            raise self.error.with_traceback(None)
        self.rates = np.array(rates)

    def stop(self):
        self.stopped += 1
        self.torque = False
        self.rates = np.zeros(2)

    def time(self):
        return self.now

    def wait(self, seconds):
        self.owed += seconds + 1e-9
        self.now += seconds + 1e-9
        while self.owed >= self.STEP:
            self.owed -= self.STEP
            plate = self.plant.devices.state[:, 2::4]
            turned = plate + self.STEP * self.rates
            motor = self.plant.transmission.motor
            self.plant.shoved = (motor(turned) - motor(plate))[0] / self.STEP
            self.plant.advance(self.STEP)

    def faults(self):
        return self.words


class AkdWithCamera(LockstepRig):
    """Emulated AKD drives on their bus, and a camera of one's own."""

    def __init__(self, scenario, **thresholds):
        def made(plant, now):
            self.camera = PlantCamera(plant.ball, now)
            return SeparateScreen(self.camera, OwnScreenConfig(backend="", **thresholds))

        super().__init__(scenario, other_screen=made)


class OwnWithLumio(HardwareRig):
    """Servos of one's own, and the driver of a Lumio screen on an emulated one."""

    def __init__(self, scenario, protocol=Protocol.MICROTOUCH):
        limits, period = build_limits(scenario), scenario.rig.period
        self.plant = EmulatedPlant(scenario)
        self.plant.attach(())
        self.hardware = PlantServos(self.plant)
        now = self.hardware.time
        self.line = self.plant.screen_line(self.plant.ball, protocol)
        self.port = LockstepScreenPort(self.line, now)
        touch = LumioConfig(port="emulated", protocol=str(protocol))
        servos = OwnServos(self.hardware, OwnServosConfig(backend=""), limits, period)
        super().__init__(
            servos=servos,
            screen=LockstepScreen(touch, now, port=self.port),
            clock=RealTimeClock(period, spin=0.0, now=now, sleep=self.hardware.wait),
            transmission=FixedRatio(),
            limits=limits,
            patience=1.0,
            scheduling=lambda: nullcontext(Scheduling(False, False, ("virtual time",))),
        )
        self.now, self.sleep = now, self.hardware.wait

    def meanwhile(self, work):
        """Do it in no time."""
        work()
