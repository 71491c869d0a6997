"""What lies between a commanded motor rate and the plate's: bandwidth, lost motion, vibration."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from controllers.arrays import Array, Number, put
from twin.settings import Unit, setting
from twin.sim.drive_train import Hysteresis, Play, Resonance, TrainPart
from twin.sim.noise import Rigs
from twin.sim.vibration import Vibration


@dataclass(frozen=True, kw_only=True)
class DriveModel:
    """A drive's imperfections beyond those of the plant's own servos; zero switches each off.

    Fields may be arrays with one entry per rig.

    Attributes:
        bandwidth: Corner frequency in Hz of a first-order lag of the speed loop.
        backlash: Angle in rad that the drive turns without moving the plate, as plate angle.
        hysteresis: Angle in rad, as plate angle, by which the plate is left behind after a
            reversal, the more gradually the softer what holds it: elastic parts against friction.
        resonance: Frequency in Hz at which the plate swings on a soft drive train when it is moved.
        resonance_damping: Its damping ratio.
        vibration: Amplitude in rad/s^2 of a vibration of both plate axes, a quarter turn apart.
        vibration_frequency: Its frequency in Hz.
        vibration_wander: Time in s in which it forgets its phase and size, random about its
            frequency and of the same rms; 0 for a steady one.
        disturbance: Variances of white plate accelerations that are added to the commanded ones,
            for phi and theta, (rad/s^2)^2. None by default: what Table B.1 calls so, 1.0816e-4 and
            2.8090e-5, are control efforts recorded at rest (Fig. B.3), in size a controller's own
            answer to the screen's noise, which the twin makes by itself.
    """

    bandwidth: Number = setting("plant.servo.bandwidth_hz", 0.0, ge=0, le=1000)
    backlash: Number = setting("plant.servo.backlash_deg", 0.0, Unit.DEG, ge=0, le=5)
    hysteresis: Number = setting("plant.servo.hysteresis_deg", 0.0, Unit.DEG, ge=0, le=5)
    resonance: Number = setting("plant.servo.resonance_hz", 0.0, ge=0, le=100)
    resonance_damping: Number = setting("plant.servo.resonance_damping", 0.05, ge=0, lt=1)
    vibration: Number = setting("plant.servo.vibration", 0.0, ge=0, le=100)
    vibration_frequency: Number = setting("plant.servo.vibration_hz", 13.0, gt=0, le=250)
    vibration_wander: Number = setting("plant.servo.vibration_wander", 0.0, ge=0, le=1000)
    disturbance: tuple[float, float] | Array = setting("disturbance.variance", (0.0, 0.0), ge=0)


class SimulatedDrives:
    """Two drives of N rigs: commanded motor rates in, rates of the cam shafts out.

    Args:
        model: The imperfections; its disturbance is the rig's to add.
        period: Control period in s.
        ratio: Motor angle per plate angle, dimensionless.
        seeds: One seed sequence per rig.
    """

    def __init__(
        self,
        model: DriveModel,
        period: float,
        ratio: float,
        seeds: Sequence[np.random.SeedSequence],
    ) -> None:
        self._period, self._ratio, self._rigs = period, ratio, len(seeds)
        self._rate: Array = np.zeros((self._rigs, 2))
        self.ahead: Array = np.zeros((self._rigs, 2))
        """By how much the motors have turned further than the shafts, rad, shape (N, 2)."""
        self._every: tuple[TrainPart, ...] = ()
        self._vibration = Vibration(period, seeds)
        self._equip(model)

    def change(self, model: DriveModel, rate: Array) -> None:
        """Have the imperfections of another model from now on.

        Args:
            model: The imperfections.
            rate: Motor rates in rad/s that were commanded for the period that has passed, (N, 2).
        """
        if self.ideal:
            self._rate = rate
        before = self._every
        self._equip(model)
        for old, new in zip(before, self._every, strict=True):
            new.go_on(old, rate)

    def adopt(self, rigs: Rigs, other: SimulatedDrives) -> None:
        """Let some rigs begin at rest, with the noise of others that have not moved."""
        self._rate, self.ahead = put(self._rate, rigs, 0.0), put(self.ahead, rigs, 0.0)
        for part in self._every:
            part.begin(rigs)
        self._vibration.adopt(rigs, other._vibration)

    def _equip(self, model: DriveModel) -> None:
        period, ratio = self._period, self._ratio

        def each(value: Number) -> Array:
            return np.broadcast_to(np.asarray(value, float), (self._rigs,))[:, None]

        shares = (2 * math.pi * each(model.bandwidth) * period)[:, 0].tolist()
        # Of the step from old rate to new, what is left at the end of a period and in its mean.
        left = [math.exp(-share) if share else 0.0 for share in shares]
        mean = [-math.expm1(-share) / share if share else 0.0 for share in shares]
        self._left, self._mean = np.array(left)[:, None], np.array(mean)[:, None]
        omega = 2 * math.pi * each(model.vibration_frequency)
        self._vibration.be(
            ratio * each(model.vibration) / omega,
            each(model.vibration_frequency),
            each(model.vibration_wander),
        )
        self._every = (
            Play(each(model.backlash) * ratio),
            Hysteresis(each(model.hysteresis) * ratio),
            Resonance(each(model.resonance), each(model.resonance_damping), period),
        )
        self._parts = [part for part in self._every if part.acts.any()]
        self.ideal = not (any(shares) or self._parts or self._vibration.acts)
        """Whether the shafts follow every command at once."""

    def follow(self, rate: Array) -> Array:
        """Mean rates over the next period for the commanded ones, both rad/s, shape (N, 2)."""
        lacking = self._rate - rate
        mean: Array = rate + self._mean * lacking
        self._rate = rate + self._left * lacking
        turned = mean
        for part in self._parts:
            # a rig without the part keeps its rate to the last bit
            followed = part.follow(mean * self._period) / self._period
            mean = np.where(part.acts, followed, mean)
        self.ahead = self.ahead + self._period * (turned - mean)
        if self._vibration.acts:
            mean = mean + self._vibration.rate()
        return mean
