"""Drives of N simulated rigs: what lies between a commanded motor rate and the rate of the shaft.

A servo that goes to a position, a lag of the speed loop, a drive train with play, hysteresis and a
soft part, and vibration.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array, Number, column, put
from twin.base.followers import FREE, GIVEN, SHAPE, Followers
from twin.base.settings import Unit, ramp, setting
from twin.sim import sensors
from twin.sim.sensors import Noise, Rigs

SERVO_FOLLOWERS = Followers(
    mechanism=GIVEN,
    equations=GIVEN,
    source=FREE,
    identify="takes the plate's angles from the encoders and fits only the lag of the drives",
    symbols="have the plate's acceleration as their input",
)
POSITION_FOLLOWERS = SERVO_FOLLOWERS.by("position_servo")
LAG_FOLLOWERS = replace(SERVO_FOLLOWERS, identify=FREE)
LOST_MOTION = replace(SERVO_FOLLOWERS, identify="leaves it to ballplate calibrate lost-motion")


class Vibration:
    """Rates of both axes of N plates that swing by themselves, a quarter turn apart.

    A steady one is a sine. A random one is a sum of sine and cosine with random amplitudes: white
    noise through a first-order lag each (Ornstein-Uhlenbeck), so narrow-band noise of the same rms.

    Args:
        period: Control period in s.
        seeds: One seed sequence per rig.
    """

    def __init__(self, period: float, seeds: Sequence[np.random.SeedSequence]) -> None:
        self._period = period
        self._tick = 0
        self._begun = np.zeros((len(seeds), 1), int)
        self._noise = Noise(np.full(4, 0.5), [s.spawn(1)[0] for s in seeds])
        self._sizes: Array = np.zeros((len(seeds), 4))
        self.set_parameters(*np.zeros((3, len(seeds), 1)))

    def set_parameters(self, amplitude: Array, frequency: Array, wander: Array) -> None:
        """Set amplitude, frequency and wandering of the swinging from now on.

        Args:
            amplitude: Of the steady rates in rad/s, shape (N, 1); the rms of both kinds is this by
                the root of two.
            frequency: In Hz, shape (N, 1).
            wander: Time in s in which a random one forgets its phase, shape (N, 1); 0 for a steady
                one.
        """
        self.acts = bool(amplitude.any())
        self._amplitude = amplitude
        self._turn = 2 * np.pi * frequency * self._period
        self._random = wander > 0
        self._kept = np.exp(-self._period / np.where(self._random, wander, 1.0))

    def adopt(self, rigs: Rigs, other: Vibration) -> None:
        """Let some rigs begin to swing now, with the noise of others that have not begun."""
        self._begun[rigs] = self._tick
        self._noise.adopt(rigs, other._noise)

    def rate(self) -> Array:
        """Rates of the next period in rad/s, shape (N, 2)."""
        self._tick += 1
        age = self._tick - self._begun
        phase = self._turn * age
        sine, cosine = np.sin(phase), np.cos(phase)
        steady = np.concatenate((sine, cosine), axis=1)
        if self._random.any():
            drawn = self._noise.draw()
            # begun as it goes on: there is no instant at which it is known to be still
            fresh = np.where(age == 1, 1.0, np.sqrt(1 - self._kept**2))
            self._sizes = np.where(age == 1, 0.0, self._kept * self._sizes) + fresh * drawn
            wandering = self._sizes[:, :2] * sine + self._sizes[:, 2:] * cosine
            steady = np.where(self._random, wandering, steady)
        return self._amplitude * steady


class TrainPart(ABC):
    """A part of the drives of N rigs.

    Attributes:
        states: Names of the arrays, shape (N, ..., 2), that have a past; 0 at the beginning, and
            where a rig gets the part while it runs.
        acts: Which rigs have the part, shape (N, 1).
    """

    states: ClassVar[tuple[str, ...]]
    acts: NDArray[np.bool_]

    def go_on(self, before: Any, rate: Array) -> None:
        """Begin in the state of an earlier part of the same kind.

        Args:
            before: The earlier part.
            rate: Rates of the input in rad/s now, shape (N, 2).
        """
        del rate
        for name in self.states:
            setattr(self, name, (getattr(before, name).T * before.acts[:, 0]).T)

    def begin(self, rigs: Rigs) -> None:
        """Let some rigs begin as they were when they were made."""
        for name in self.states:
            setattr(self, name, put(getattr(self, name), rigs, 0.0))

    @abstractmethod
    def follow(self, turn: Array) -> Array:
        """Turn of the output in rad for one of the input, both (N, 2)."""


class PositionServo(TrainPart):
    """A servo that goes to a position: to the sum of the turns that it was commanded, if it can.

    It gets that angle late, interpolated between two periods, and rounds it to its steps. It stands
    until the angle is further away than its dead band. Then it follows the angle as fast as it can,
    and keeps the turn that is still due. With limited acceleration it brakes in time to stop there,
    so that a step is followed in the shortest time (bang-bang, in whole periods).

    Args:
        about: Largest rate in rad/s and acceleration in rad/s^2, 0 for any; dead band and steps in
            rad, 0 for none; shape (N, 1) each.
        dead_time: Time from a command to the beginning of its motion, s, shape (N, 1).
        period: Control period in s.
    """

    states = ("_commanded", "_angle", "_goes", "_turn")

    def __init__(self, about: Sequence[Array], dead_time: Array, period: float) -> None:
        slew, acceleration, deadband, resolution = about
        self._brakes = acceleration > 0
        self.acts = (slew > 0) | self._brakes | (deadband > 0) | (resolution > 0) | (dead_time > 0)
        self._period = period
        self._most = np.where(slew > 0, slew * period, np.inf)
        self._more = np.where(self._brakes, acceleration * period**2, 1.0)
        self._deadband = deadband
        self._rounds = resolution > 0
        self._step = np.where(self._rounds, resolution, 1.0)
        late, self._share = sensors.periods(dead_time[:, 0], period)
        self._late = np.arange(len(slew)), late
        self._commanded = np.zeros((len(slew), int(late.max()) + 2, 2))  # of now and before
        self._angle, self._turn = np.zeros((2, len(slew), 2))
        self._goes = np.zeros((len(slew), 2), bool)

    def go_on(self, before: PositionServo, rate: Array) -> None:
        """Begin in the state of ``before``, at commanded rates in rad/s, shape (N, 2)."""
        known = before._late[1][:, None] + (before._share > 0)
        order = np.minimum(np.arange(self._commanded.shape[1]), known)
        super().go_on(before, rate)
        self._commanded = np.take_along_axis(self._commanded, order[..., None], axis=1)
        self._turn = np.where(before.acts, before._turn, rate * self._period)

    def follow(self, turn: Array) -> Array:
        """Turn of the servo in rad for a commanded one."""
        past = self._commanded
        past = np.concatenate((past[:, :1] + turn[:, None], past[:, :-1]), axis=1)
        self._commanded, goal = past, past[self._late]
        goal = goal + self._share * (past[:, 1:][self._late] - goal)
        goal = np.where(self._rounds, np.round(goal / self._step) * self._step, goal)
        before = self._angle
        goes = self._goes | (np.abs(goal - before) > self._deadband)
        goes |= self._brakes & (np.abs(self._turn) > self._more)
        there = np.minimum(np.maximum(goal, before - self._most), before + self._most)
        if self._brakes.any():
            braked = self._braked(goal - before)
            there = np.where(self._brakes & (braked != goal - before), before + braked, there)
        self._angle = np.where(goes, there, before)
        self._goes = goes & (there != goal)
        self._turn = self._angle - before
        return self._turn

    def _braked(self, way: Array) -> Array:
        """Turn in rad towards a goal that is a way in rad off, (N, 2), within the acceleration.

        The largest turn after which ever smaller ones, by the most that the acceleration allows,
        end at the goal: with n of them after it, (n + 1) turn - more n (n + 1) / 2 is the way.
        """
        more, far = self._more, np.abs(way)
        n = np.floor((np.sqrt(1 + 8 * far / more) - 1) / 2)
        wanted = np.copysign(np.minimum(far / (n + 1) + more * n / 2, self._most), way)
        return np.minimum(np.maximum(wanted, self._turn - more), self._turn + more)


class Play(TrainPart):
    """A gap: the output stands until the input has crossed it.

    Args:
        width: Of the gap in rad, shape (N, 1); 0 for none.
    """

    states = ("_input", "_output")

    def __init__(self, width: Array) -> None:
        self._half = width / 2
        self.acts = width > 0
        self._input, self._output = np.zeros((2, len(width), 2))

    def follow(self, turn: Array) -> Array:
        """Turn of the output in rad for one of the input."""
        self._input = self._input + turn
        moved = np.minimum(
            np.maximum(self._output, self._input - self._half), self._input + self._half
        )
        followed = moved - self._output
        self._output = moved
        return followed


class Hysteresis(TrainPart):
    """An elastic part that works against dry friction after Dahl: lost motion without a gap.

    With h the angle that is lost and s the input's, dh/ds = (1 - h sgn(s') / h_max) / 2: right
    after a reversal the output stands, then follows more and more; h_max is half the width of the
    loop of output over input, and the width is the way on which it changes over.

    Args:
        width: Of the loop in rad, shape (N, 1); 0 for none.
    """

    states = ("_lost",)

    def __init__(self, width: Array) -> None:
        self.acts = width > 0
        self._width = width
        self._way = np.where(width > 0, width, 1.0)
        self._lost: Array = np.zeros((len(width), 2))

    def follow(self, turn: Array) -> Array:
        """Turn of the output in rad for one of the input."""
        end = np.copysign(self._width / 2, turn)
        lost = end + (self._lost - end) * np.exp(-np.abs(turn) / self._way)
        followed: Array = turn - (lost - self._lost)
        self._lost = lost
        return followed


class Resonance(TrainPart):
    """A soft drive train: the plate swings about where the motor is, excited by the motor's motion.

    With d the plate's angle less the motor's, d'' + 2 zeta w d' + w^2 d = -(acceleration of the
    motor), solved exactly for motor rates that are constant over a period.

    Args:
        frequency: Of the undamped swing in Hz, shape (N, 1); 0 for a stiff train.
        damping: Ratio zeta below 1, shape (N, 1).
        period: Control period in s.
    """

    states = ("_d", "_d_rate", "_motor_rate")

    def __init__(self, frequency: Array, damping: Array, period: float) -> None:
        self.acts = frequency > 0
        w = 2 * math.pi * frequency
        decay, swing = damping * w, w * np.sqrt(1 - damping**2)
        fade = np.exp(-decay * period)
        cos = fade * np.cos(swing * period)
        # sin(swing t) / swing, which at 0 is t
        sine = fade * period * np.sinc(swing * period / math.pi)
        self._period = period
        self._angle = cos + decay * sine, sine
        self._rate = -(w**2) * sine, cos - decay * sine
        still: Array = np.zeros((3, len(frequency), 2))
        self._d, self._d_rate, self._motor_rate = still

    def go_on(self, before: Resonance, rate: Array) -> None:
        """Begin in the state of ``before``, at input rates in rad/s, shape (N, 2)."""
        super().go_on(before, rate)
        self._motor_rate = np.where(before.acts, before._motor_rate, rate)

    def follow(self, turn: Array) -> Array:
        """Turn of the plate in rad for one of the motor."""
        motor_rate = turn / self._period
        d, d_rate = self._d, self._d_rate - (motor_rate - self._motor_rate)
        self._motor_rate = motor_rate
        (a, b), (c, e) = self._angle, self._rate
        self._d, self._d_rate = a * d + b * d_rate, c * d + e * d_rate
        return turn + (self._d - d)


@dataclass(frozen=True, kw_only=True)
class DriveModel:
    """A drive's imperfections beyond those of the plant's own servos; zero switches each off.

    Fields may be arrays with one entry per rig.

    A servo that goes to a position has the effects in this order: its command, the integral of the
    commanded rate, is late, rounded, held back by the dead band, followed within slew and
    acceleration, then with the lag. Where it stands off its command it is the measured angle that
    tells the rig.

    Attributes:
        slew: Largest plate rate in rad/s at which a servo can go to a commanded position.
        acceleration: Largest plate acceleration in rad/s^2 of such a servo, which brakes in time
            to stop at the commanded position.
        deadband: Angle in rad, as plate angle, by which the commanded one must be away from where
            such a servo stands until it goes; then it goes all the way.
        resolution: Steps in rad, as plate angle, to which such a servo rounds the commanded angle.
        dead_time: Time in s after which such a servo acts on a command.
        bandwidth: Corner frequency in Hz of a first-order lag of the speed loop.
        backlash: Angle in rad that the drive turns without moving the plate, as plate angle.
        hysteresis: Angle in rad, as plate angle, by which the plate is left behind after a
            reversal, the more gradually the softer what holds it: elastic parts against friction.
        resonance: Frequency in Hz at which the plate swings on a soft drive train when it is moved.
        resonance_damping: Its damping ratio.
        vibration: Amplitude in rad/s^2 of a vibration of both plate axes, a quarter turn apart.
        vibration_frequency: Its frequency in Hz.
        vibration_wander: Correlation time in s of its phase and size, which vary at random at
            the same rms; 0 for a steady vibration.
        disturbance: Variances of white plate accelerations that are added to the commanded ones,
            for phi and theta, (rad/s^2)^2. None by default: what Table B.1 calls so, 1.0816e-4 and
            2.8090e-5, are control efforts recorded at rest (Fig. B.3), in size a controller's own
            answer to the screen's noise, which the twin makes by itself.
    """

    slew: Number = ramp(
        "plant.servo.slew_deg", 0.0, Unit.DEG, followed_by=POSITION_FOLLOWERS, ge=0, le=3600
    )
    acceleration: Number = ramp(
        "plant.servo.acceleration_deg",
        0.0,
        Unit.DEG,
        followed_by=POSITION_FOLLOWERS,
        ge=0,
        le=1e6,
    )
    deadband: Number = ramp(
        "plant.servo.deadband_deg",
        0.0,
        Unit.DEG,
        followed_by=POSITION_FOLLOWERS,
        ge=0,
        le=5,
    )
    resolution: Number = ramp(
        "plant.servo.resolution_deg",
        0.0,
        Unit.DEG,
        followed_by=POSITION_FOLLOWERS,
        ge=0,
        le=5,
    )
    dead_time: Number = ramp(
        "plant.servo.dead_time", 0.0, followed_by=POSITION_FOLLOWERS, ge=0, le=0.1
    )
    bandwidth: Number = ramp(
        "plant.servo.bandwidth_hz", 0.0, followed_by=LAG_FOLLOWERS.by("bandwidth"), ge=0, le=1000
    )
    backlash: Number = ramp(
        "plant.servo.backlash_deg",
        0.0,
        Unit.DEG,
        followed_by=LOST_MOTION.by("backlash"),
        ge=0,
        le=5,
    )
    hysteresis: Number = ramp(
        "plant.servo.hysteresis_deg",
        0.0,
        Unit.DEG,
        followed_by=LOST_MOTION.by("hysteresis"),
        ge=0,
        le=5,
    )
    resonance: Number = ramp(
        "plant.servo.resonance_hz", 0.0, followed_by=SERVO_FOLLOWERS.by("resonance"), ge=0, le=100
    )
    resonance_damping: Number = ramp(
        "plant.servo.resonance_damping",
        0.05,
        followed_by=SERVO_FOLLOWERS.by("resonance", SHAPE),
        ge=0,
        lt=1,
    )
    vibration: Number = ramp(
        "plant.servo.vibration", 0.0, followed_by=SERVO_FOLLOWERS.by("shaking"), ge=0, le=100
    )
    vibration_frequency: Number = setting(
        "plant.servo.vibration_hz",
        13.0,
        followed_by=SERVO_FOLLOWERS.by("shaking", SHAPE),
        gt=0,
        le=250,
    )
    vibration_wander: Number = setting(
        "plant.servo.vibration_wander",
        0.0,
        followed_by=SERVO_FOLLOWERS.by("shaking", SHAPE),
        ge=0,
        le=1000,
    )
    disturbance: tuple[float, float] | Array = ramp(
        "disturbance.variance", (0.0, 0.0), followed_by=SERVO_FOLLOWERS.by("disturbance"), ge=0
    )

    def servo(self, period: float, ratio: Number = 1.0, rigs: int = 1) -> PositionServo:
        """Servos of both axes at a control period in s, a ratio above the plate's angles."""
        about = self.slew, self.acceleration, self.deadband, self.resolution, self.dead_time
        *limits, dead_time = (np.broadcast_to(column(each), (rigs, 1)) for each in about)
        return PositionServo([each * ratio for each in limits], dead_time, period)


class SimulatedDrives:
    """Two drives of N rigs: commanded motor rates in, rates of the cam shafts out.

    Args:
        model: The imperfections; its disturbance is the rig's to add.
        period: Control period in s.
        ratio: Motor angle per plate angle at level, dimensionless; also (2,) or (N, 2).
        seeds: One seed sequence per rig.
    """

    def __init__(
        self,
        model: DriveModel,
        period: float,
        ratio: Number,
        seeds: Sequence[np.random.SeedSequence],
    ) -> None:
        self._period, self._ratio, self._rigs = period, ratio, len(seeds)
        self._rate: Array = np.zeros((self._rigs, 2))
        self.ahead: Array = np.zeros((self._rigs, 2))
        """Angles by which the motors are ahead of the shafts, rad, shape (N, 2)."""
        self._every: tuple[TrainPart, ...] = ()
        self._vibration = Vibration(period, seeds)
        self._equip(model)

    def change(self, model: DriveModel, rate: Array) -> None:
        """Have the imperfections of a new model from now on.

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
        self._vibration.set_parameters(
            ratio * each(model.vibration) / omega,
            each(model.vibration_frequency),
            each(model.vibration_wander),
        )
        self._servo = model.servo(period, ratio, self._rigs)
        train = (
            Play(each(model.backlash) * ratio),
            Hysteresis(each(model.hysteresis) * ratio),
            Resonance(each(model.resonance), each(model.resonance_damping), period),
        )
        self._parts = [part for part in train if part.acts.any()]
        self._every = (self._servo, *train)
        self._goes_to = bool(self._servo.acts.any())
        self.ideal = not (any(shares) or self._goes_to or self._parts or self._vibration.acts)
        """Whether the shafts follow every command at once."""

    def follow(self, rate: Array) -> Array:
        """Mean rates over the next period for the commanded ones, both rad/s, shape (N, 2)."""
        if self._goes_to:
            rate = self._through(self._servo, rate)
        lacking = self._rate - rate
        mean: Array = rate + self._mean * lacking
        self._rate = rate + self._left * lacking
        turned = mean
        for part in self._parts:
            mean = self._through(part, mean)
        self.ahead = self.ahead + self._period * (turned - mean)
        if self._vibration.acts:
            mean = mean + self._vibration.rate()
        return mean

    def _through(self, part: TrainPart, rate: Array) -> Array:
        """Rates behind a part; a rig without it keeps its rate to the last bit."""
        return np.where(part.acts, part.follow(rate * self._period) / self._period, rate)
