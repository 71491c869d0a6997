"""Drivers of hardware of one's own: servos and a screen with methods that may fail at any time.

A protection that the hardware lacks, such as a watchdog on the board, is reported in every run.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from numbers import Real
from typing import Any, TypeVar

import numpy as np

from controllers.arrays import Array
from twin.base.errors import RigError
from twin.devices.common import FaultReports
from twin.devices.own_config import BallThresholds, OwnConfig, OwnScreenConfig, OwnServosConfig
from twin.devices.own_hardware import OwnDevice, Reading, ScreenHardware, ServoHardware
from twin.devices.own_loading import describe_error
from twin.devices.plate_tests import (
    DIRECTION_TEST,
    SCALE_TEST,
    UNDELAYED_DIRECTION_TEST,
    DirectionTest,
)
from twin.hal.agreement import OPPOSITE, WRONG_RATIO
from twin.hal.interface import AXIS_NAMES, Condition, Fault, Limits, Touch, conditions

Answer = TypeVar("Answer")
ASTRAY_FOR = 0.3
"""Seconds for which a plate must be astray until it is a fault."""
OWN_CONDITIONS = tuple(conditions("twin.devices").values())
"""Every condition that own hardware is watched for, from ``conditions.toml``."""
FAILED, REPORTED, SILENT, ASTRAY, FROZEN, LACKING, *_OF_SCREEN = OWN_CONDITIONS
SCREEN_FAILED, SCREEN_REPORTED = _OF_SCREEN
"""Conditions of an own screen, in place of ``FAILED`` and ``REPORTED``."""


class _OwnDriver:
    """Calls the methods of own hardware, and reports what fails in them; a FaultSource.

    Args:
        hardware: The hardware.
        silent: Seconds without a new measurement that are a fault.
        failed: What is reported where a method fails.
        reported: What is reported where the hardware reports an error.
    """

    def __init__(
        self, hardware: OwnDevice, silent: float, failed: Condition, reported: Condition
    ) -> None:
        self.reading: Reading | None = None
        """The newest measurement that is one."""
        self.where = type(hardware).__name__
        self.now = hardware.time
        self._device = hardware
        self._silent, self._failed, self._reported = silent, failed, reported
        self._file = type(hardware).start.__code__.co_filename
        self._started = False
        self._reports = FaultReports(math.inf)

    def _connect(self) -> None:
        """Let the hardware connect, and read it once.

        Raises:
            RigError: If it cannot, or measures nothing that is a reading.
        """
        self._started = True
        self._reports = FaultReports(math.inf)
        try:
            self._device.start()
            self.reading = self._checked(self._device.measure())
        except (Exception, SystemExit) as error:
            self.stop()
            raise RigError(f"{self.where}: {describe_error(error, self._file)}") from error

    def stop(self) -> None:
        """Let the hardware stop; idempotent, never raises."""
        if self._started:
            self._started = False
            self._asked(self._device.stop)

    def receive(self) -> None:
        """Take in the newest measurement; nothing of hardware that is stopped."""
        if not self._started:
            return
        for words in self._asked(self._said) or ():
            self._report(self._reported, str(words))
        answer = self._asked(lambda: self._checked(self._device.measure()))
        if answer is not None:
            self.reading = answer
        if self.reading is not None:
            self._watch(self.reading, self.now())

    def faults(self) -> tuple[Fault, ...]:
        """Faults detected since the last call, oldest first."""
        return self._reports.take()

    def _watch(self, reading: Reading, now: float) -> None:
        """Report what the newest measurement shows at a time in s."""
        if not now - reading.at <= self._silent:
            self._report(SILENT, f"none for {now - reading.at:.2f} s")

    def _checked(self, reading: Any) -> Reading:
        """A reading of finite time; its angles, if any, are finite; positions may be NaN.

        Raises:
            TypeError: If it is none.
        """
        if not isinstance(reading, Reading):
            raise TypeError(f"measure must give a ballplate.hardware.Reading, not {reading!r}")
        angles = [each for each in (reading.phi, reading.theta) if each is not None]
        numbers = (reading.x, reading.y, reading.at, *angles)
        if not all(isinstance(each, Real) for each in numbers):
            raise TypeError(f"measure must give numbers, NaN for a ball not seen: {reading}")
        if len(angles) == 1 or not all(map(math.isfinite, (*numbers[2:], self.now()))):
            raise TypeError(f"measure must give a time, and two finite angles or none: {reading}")
        if (ahead := reading.at - self.now()) > self._silent:
            raise TypeError(
                f"Reading.at is {ahead:.3g} s ahead of time(): give self.time() of its arrival"
            )
        return reading

    def _said(self) -> tuple[str, ...]:
        """Reports of the hardware, a text by itself or several."""
        texts = self._device.faults()
        return (texts,) if isinstance(texts, str) else tuple(texts or ())

    def _asked(self, method: Callable[[], Answer]) -> Answer | None:
        """Result of a method of the hardware; None, and a fault, where it fails."""
        try:
            return method()
        except (Exception, SystemExit) as error:  # noqa: BLE001 - a user's file may do anything
            if not self._is_reported(self._failed):
                self._report(self._failed, describe_error(error, self._file))
            return None

    def _is_reported(self, condition: Condition) -> bool:
        """Whether a fault was reported; to find its words again would take time in every period."""
        return self._reports.latched(condition, self.where)

    def _report(self, condition: Condition, detail: str) -> None:
        self._reports.report(condition, self.where, detail, self.now())


class _BallWatch:
    """Notices pictures that never change: no ball rests on a steep plate.

    Args:
        config: ``rest`` and ``steep_deg``.
    """

    def __init__(self, config: BallThresholds) -> None:
        self._config = config
        self._place, self._moved = (math.nan, math.nan), math.inf
        """Where the ball was seen last, and since when it is seen there on a steep plate."""

    def look(self, reading: Reading, now: float, plate: Array) -> str:
        """Error of a reading at a time in s, in words; empty for none.

        Args:
            reading: The newest.
            now: Time in s.
            plate: Plate angles in rad, shape (2,).
        """
        place = (reading.x, reading.y)
        steep = np.degrees(np.abs(plate).max()) > self._config.steep_deg
        if place != self._place or not steep or not all(map(math.isfinite, place)):
            self._place, self._moved = place, now
        elif now - self._moved > self._config.rest:
            return f"the same for {now - self._moved:.2f} s on a tilted plate"
        return ""


class OwnServos(_OwnDriver):
    """Own hardware as two servo axes: `PoweredServos`.

    Args:
        hardware: The hardware.
        config: Its thresholds; those of `OwnConfig` watch over its ball as well.
        limits: What may be commanded.
        period: Control period in s.
    """

    round_trip: float | None = None

    def __init__(
        self,
        hardware: ServoHardware,
        config: OwnConfig | OwnServosConfig,
        limits: Limits,
        period: float,
    ) -> None:
        super().__init__(hardware, config.silent, FAILED, REPORTED)
        self.config = config
        self.lost, self.late = config.lost, config.late
        """As of `PoweredServos`."""
        self.enabled = False
        self.sleep = hardware.wait
        self._hardware = hardware
        self._limit = float(np.max(limits.angle))
        self._period = period
        self._share = 1 - math.exp(-period / config.plate_lag) if config.plate_lag else 1.0
        self._rate, self._angle, self._model = np.zeros((3, 2))
        self._read_at, self._model_then = -math.inf, self._model
        """Time in s of the newest measurement, and the modelled plate angles then, rad."""
        self._astray: float | None = None
        self._looks = 0
        self._motion: deque[tuple[float, ...]] = deque(maxlen=round(DIRECTION_TEST.memory / period))
        """Commanded, then measured plate angles of the last periods, rad."""
        self._ball = _BallWatch(config) if isinstance(config, OwnConfig) else None

    def warnings(self) -> tuple[Fault, ...]:
        """Safety nets that such a rig does not have."""
        found = [] if self._hardware.watchdog else ["nothing stops the plate if this program dies"]
        if self.reading is not None and self.reading.phi is None:
            found.append("no encoder shows whether the plate follows")
        return tuple(Fault(LACKING, self.where, words) for words in found)

    def start(self, *, reset: bool = False) -> None:
        """Let the hardware connect, and read it once.

        Raises:
            RigError: If it cannot, or measures nothing that is a reading.
        """
        self._astray = None
        self._motion.clear()
        self._read_at = -math.inf
        self._connect()

    def stop(self) -> None:
        """Let the hardware stop; idempotent, never raises."""
        self.enabled = False
        super().stop()

    def enable(self) -> None:
        """The hardware has torque once it is started."""
        self.enabled = True

    def quick_stop(self) -> None:
        """Hold still from now on."""
        self._rate = np.zeros(2)

    def send(self) -> None:
        """Command what is to hold for the period that begins."""
        before = self._angle
        if not np.isfinite(self._rate).all():
            self._report(FAILED, f"it was to be commanded {self._rate.tolist()} rad/s")
            self._rate = np.zeros(2)
        self._angle = np.clip(before + self._period * self._rate, -self._limit, self._limit)
        rates = (self._angle - before) / self._period
        self._model = self._model + self._share * (self._angle - self._model)
        if self._started:
            pairs: Any = (tuple(rates.tolist()), tuple(self._angle.tolist()))
            self._asked(lambda: self._hardware.command(*pairs))

    def settle(self, limit: float) -> None:
        """Nothing is waited for."""

    def command(self, motor_rate: Array) -> None:
        """Plate rates in rad/s, shape (1, 2), until the next command."""
        self._rate = np.asarray(motor_rate, float).reshape(2)

    @property
    def encoders(self) -> bool:
        """Whether the newest measurement has plate angles."""
        return self._measured is not None

    @property
    def _measured(self) -> Reading | None:
        """The newest reading if it has plate angles."""
        return self.reading if self.reading and self.reading.phi is not None else None

    def plate(self) -> Array:
        """Measured plate angles, or where the plate is believed to be, rad, shape (1, 2).

        Once measurements have ended, the plate is believed to follow its commands from the last
        one, so that levelling ends where the plate is level.
        """
        reading = self._measured
        if reading is None:
            return self._model[None].copy()
        measured = np.array([reading[3:]])
        if self.now() - reading.at <= self._silent:
            return measured
        return np.asarray(measured + self._model - self._model_then)

    def motor(self) -> Array:
        """The commanded plate angles, rad, shape (1, 2)."""
        return self._angle[None].copy()

    def turned(self) -> tuple[Array, Array] | None:
        """Nothing: no encoder of a motor is known."""
        return None

    def age(self) -> Array:
        """Seconds since the plate was measured; 0 where it is computed, shape (1, 2)."""
        reading = self._measured
        return np.full((1, 2), self.now() - reading.at if reading else 0.0)

    def home(self, plate: Array, motor: Array) -> None:
        """Declare where the plate stands, rad, shape (1, 2)."""
        self._angle = self._model = self._model_then = np.asarray(plate, float).reshape(2)

    def _watch(self, reading: Reading, now: float) -> None:
        super()._watch(reading, now)
        if reading.at != self._read_at:
            self._read_at, self._model_then = reading.at, self._model
        plate = self.plate()[0]
        if self._ball and (words := self._ball.look(reading, now, plate)):
            self._report(FROZEN, words)
        if reading.phi is None:
            return
        self._motion.append((*self._model.tolist(), *plate.tolist()))
        self._looks += 1
        if self._looks % DIRECTION_TEST.every == 0:
            self._watch_direction(DIRECTION_TEST)
        off = np.degrees(np.abs(plate - self._model))
        astray = off.max() > self.config.astray_deg
        if astray and self._looks % DIRECTION_TEST.every == 0:
            self._watch_scale(int(off.argmax()))
        if not astray:
            self._astray = None
        elif self._astray is None:
            self._astray = now
        elif now - self._astray > ASTRAY_FOR:
            self._watch_direction(UNDELAYED_DIRECTION_TEST)
            if not self._is_reported(ASTRAY):
                text = f"{off.max():.1f} deg off for {now - self._astray:.1f} s"
                self._report(ASTRAY, f"{text}{self._describe_scale(int(off.argmax()))}")

    def _watch_direction(self, test: DirectionTest) -> None:
        """Report an axis that is measured to turn against its commands."""
        if self._is_reported(OPPOSITE):
            return
        commanded, measured = np.split(np.array(self._motion), 2, axis=1)
        for axis, name in enumerate(AXIS_NAMES):
            asked, seen = commanded[:, axis], measured[:, axis]
            if test.opposite(asked, seen, self._period):
                turned = np.degrees((asked[-1] - asked[0], seen[-1] - seen[0]))
                text = f"{name}: commanded {turned[0]:+.2f} deg, measured {turned[1]:+.2f} deg"
                self._report(OPPOSITE, text)

    def _scale(self, axis: int) -> float | None:
        """Measured per commanded angle of an axis; None where it does not explain the motion."""
        commanded, measured = np.split(np.array(self._motion), 2, axis=1)
        return SCALE_TEST.gain(commanded[:, axis], measured[:, axis], self._period)

    def _watch_scale(self, axis: int) -> None:
        """Report an axis that is measured to turn farther than commanded."""
        if self._is_reported(WRONG_RATIO):
            return
        gain = self._scale(axis)
        if gain is not None and gain >= SCALE_TEST.too_far:
            text = f"{AXIS_NAMES[axis]}: measured {gain:.1f} times what is commanded"
            self._report(WRONG_RATIO, text)

    def _describe_scale(self, axis: int) -> str:
        """Advice on an axis that turns less than commanded; empty if unknown."""
        gain = self._scale(axis)
        if gain is None or gain > SCALE_TEST.too_near:
            return ""
        seen = f"{AXIS_NAMES[axis]} is measured to turn {gain:.1f} times what is commanded"
        return f"; {seen}: check its scale, and whether the servos are fast enough"


class _LastSeen:
    """Where the ball was seen last.

    Args:
        unseen: Seconds without a ball in the measurements after which it counts as not seen.
    """

    def __init__(self, unseen: float) -> None:
        self._unseen = unseen
        self._position, self._seen = np.zeros((1, 2)), -math.inf

    def touch(self, reading: Reading | None, now: float) -> Touch:
        """The newest position seen, with its age at a time in s."""
        if reading is not None and math.isfinite(reading.x) and math.isfinite(reading.y):
            self._position, self._seen = np.array([[reading.x, reading.y]]), reading.at
            touched = True
        else:
            touched = now - self._seen <= self._unseen
        return Touch(self._position, np.array([max(0.0, now - self._seen)]), np.array([touched]))


class OwnScreen:
    """The ball as own hardware sees it that is servos as well: `PoweredScreen`.

    Args:
        servos: Who reads it.
    """

    def __init__(self, servos: OwnServos) -> None:
        self._servos, self.where = servos, servos.where
        self.start()

    def start(self) -> None:
        """Know nothing of what was before."""
        config = self._servos.config
        self._last = _LastSeen(config.unseen if isinstance(config, OwnConfig) else 0.0)

    def stop(self) -> None:
        """Nothing to close."""

    def receive(self) -> None:
        """Nothing: the servos take in what is measured."""

    def note_plate(self, plate: Array) -> None:
        """Not needed."""

    def faults(self) -> tuple[Fault, ...]:
        """None of its own."""
        return ()

    def read(self) -> Touch:
        """The newest position seen, with its age."""
        return self._last.touch(self._servos.reading, self._servos.now())


class SeparateScreen(_OwnDriver):
    """Own hardware that is a screen and nothing else: `PoweredScreen`.

    Args:
        hardware: The hardware; its ages and times are of its own clock.
        config: Its thresholds.
    """

    def __init__(self, hardware: ScreenHardware, config: OwnScreenConfig) -> None:
        super().__init__(hardware, config.silent, SCREEN_FAILED, SCREEN_REPORTED)
        self.config = config
        self._forget()

    def _forget(self) -> None:
        self.reading = None
        self._plate = np.zeros(2)
        self._last = _LastSeen(self.config.unseen)
        self._ball = _BallWatch(self.config)

    def start(self) -> None:
        """Let the hardware connect, and read it once; what was before is not known any more.

        Raises:
            RigError: If it cannot, or measures nothing that is a reading.
        """
        self.stop()
        self._forget()
        self._connect()

    def stop(self) -> None:
        """Let the hardware stop; nothing is touched any more. Idempotent, never raises."""
        super().stop()
        self.reading = None

    def note_plate(self, plate: Array) -> None:
        """Take in the plate angles (phi, theta), rad, shape (1, 2)."""
        self._plate = np.asarray(plate, float).reshape(2)

    def read(self) -> Touch:
        """The newest position seen, with its age."""
        return self._last.touch(self.reading, self.now())

    def _watch(self, reading: Reading, now: float) -> None:
        super()._watch(reading, now)
        if words := self._ball.look(reading, now, self._plate):
            self._report(FROZEN, words)
