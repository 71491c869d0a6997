"""Hardware of one's own behind the seam: a class with a few methods in place of drives and screen.

A rig file names it, ``backend = "my_rig.py:Arduino"``; ``ballplate.hardware`` is its door. What it
does not do for itself, as a watchdog on the board, is told in every run.
"""

from __future__ import annotations

import math
import runpy
import sys
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from numbers import Real
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from controllers.arrays import Array
from controllers.catalog import EXECUTES, error_words, failed_line
from twin.base.errors import RigError, ScenarioError
from twin.devices.common import FaultReports, Ranged, net, ranged
from twin.hal.agreement import AXES, OPPOSITE
from twin.hal.interface import Condition, Fault, Limits, Touch, conditions

Answer = TypeVar("Answer")


class Reading(NamedTuple):
    """What the hardware has measured last.

    Attributes:
        x: Ball along the longer side in m, from the middle of the plate; NaN where it is not seen.
        y: The same along the shorter side.
        at: When that arrived, s of ``Hardware.time``, so never ahead of it.
        phi: Measured plate angle in rad, positive where it lets the ball roll to larger x; None
            where there is no encoder.
        theta: The same; positive where it lets the ball roll to smaller y.
    """

    x: float
    y: float
    at: float
    phi: float | None = None
    theta: float | None = None


class Hardware(ABC):
    """A rig of one's own: derive from it, and write ``start``, ``measure``, ``command``, ``stop``.

    The loop calls ``measure`` and ``command`` once per control period from one thread; neither may
    wait. What is raised in any of them stops the rig.
    """

    watchdog = False
    """Whether the board itself holds the plate still when it hears nothing for a while."""

    @abstractmethod
    def start(self) -> None:
        """Connect and bring the plate level, with torque; may wait."""

    @abstractmethod
    def measure(self) -> Reading:
        """The newest measurement, the one before again if there is none."""

    @abstractmethod
    def command(self, rates: tuple[float, float], angles: tuple[float, float]) -> None:
        """Move the plate until the next command.

        Args:
            rates: Plate rates (phi', theta') in rad/s, for drives that hold a speed.
            angles: Plate angles (phi, theta) in rad at the end of the period, for servos that go to
                a position. The rates add up to them.
        """

    @abstractmethod
    def stop(self) -> None:
        """Hold still, take the torque away, disconnect; also called after any error."""

    def time(self) -> float:
        """Monotonic time in s."""
        return time.monotonic()

    def wait(self, seconds: float) -> None:
        """Let time pass."""
        time.sleep(seconds)

    def faults(self) -> tuple[str, ...]:
        """What the hardware reports of itself, in words; anything stops the rig."""
        return ()


@dataclass(frozen=True, kw_only=True)
class OwnConfig(Ranged):
    """What the twin is to know of own hardware, and the thresholds that watch over it.

    Attributes:
        options: What the class is made with.
        plate_lag: Time constant in s with which the plate follows its command; the plate angle of a
            rig without an encoder is computed with it.
        silent: Seconds without a new measurement after which the plate is levelled.
        unseen: Seconds without a ball in the measurements after which it counts as not seen.
        astray_deg: By how much the measured plate may differ from what it was told, deg.
        rest: Seconds in which a ball is measured in one and the same place, on a plate tilted by
            more than ``steep_deg``, after which the plate is levelled.
        steep_deg: Tilt on which no ball rests, deg.
    """

    keys = "own."
    options: Mapping[str, Any] = field(default_factory=dict)
    plate_lag: float = ranged(0.0, 0, 2)
    silent: float = net(0.25, 0.01, 5)
    unseen: float = net(0.1, 0, 2)
    astray_deg: float = net(3.0, 0.1, 20)
    rest: float = net(0.5, 0.05, 10)
    steep_deg: float = net(2.0, 0.2, 20)

    @property
    def lost(self) -> float:
        """Plate angle in rad by which commanded and measured plate may differ."""
        return math.radians(self.astray_deg)

    @property
    def late(self) -> float:
        """Longest time in s from a command to the motion of the plate."""
        return 0.1 + 2 * self.plate_lag


@dataclass(frozen=True, kw_only=True)
class _DirectionTest:
    """When a plate counts as turning against its commands.

    Attributes:
        memory: Duration in s of the motion that is looked at.
        delays: How many s later than its command the plate may move.
        commanded: Range in rad through which the command must have gone.
        slope: Measured angle per commanded one, at most, at every delay.
        every: Number of periods from one look to the next.
    """

    memory: float = 0.6
    delays: tuple[float, ...] = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25)
    commanded: float = math.radians(2.0)
    slope: float = -0.4
    every: int = 8

    def opposite(self, commanded: Array, measured: Array, period: float) -> bool:
        """Whether an axis turned the other way, by its angles in rad period by period, (n,)."""
        slopes = []
        for delay in self.delays:
            lag = round(delay / period)
            told, seen = commanded[: len(commanded) - lag], measured[lag:]
            if len(told) < 2 or not np.ptp(told) >= self.commanded:
                return False
            told = told - told.mean()
            slopes.append(float(told @ (seen - seen.mean())) / float(told @ told))
        return max(slopes) <= self.slope


DIRECTION = _DirectionTest()
AT_ONCE = _DirectionTest(delays=(0.0,))
"""The same for a plate that is known not to be where it should be, to tell in which way."""
ASTRAY_FOR = 0.3
"""Seconds for which a plate must be astray until it is a fault."""
OWN_CONDITIONS = tuple(conditions("twin.devices").values())
"""Every condition that own hardware is watched for, from ``conditions.toml``."""
FAILED, REPORTED, SILENT, ASTRAY, FROZEN, LACKING = OWN_CONDITIONS


def load_backend(named: str, config: OwnConfig) -> Hardware:
    """The hardware that a rig file names; nothing is opened.

    Args:
        named: File and class, ``my_rig.py:Arduino``.
        config: Its options.

    Raises:
        ScenarioError: If there is no such class, or it cannot be made.
    """
    file, _, name = named.rpartition(":")
    if not file.endswith(".py") or not Path(file).is_file():
        raise ScenarioError(f"backend: {named!r} must be FILE.py:CLASS; no file {file!r}")
    EXECUTES.info("runs %s, the hardware of the rig file", file)
    sys.path.append(str(Path(file).resolve().parent))  # what it imports may lie beside it
    try:
        kind = runpy.run_path(file).get(name)
        if isinstance(kind, type) and issubclass(kind, Hardware):
            return kind(**config.options)
    except (Exception, SystemExit) as error:
        raise ScenarioError(f"backend: {_describe_error(error, file)}") from error
    raise ScenarioError(
        f"backend: {file} has no class {name!r} derived from ballplate.hardware.Hardware"
    )


def _describe_error(error: BaseException, file: str) -> str:
    """File, line and error in one line; the error alone if it came from elsewhere."""
    return failed_line(error, {file}) or error_words(error)


class OwnServos:
    """Own hardware as two servo axes; the methods are those of `AkdServos`.

    Args:
        hardware: The hardware.
        config: Its thresholds.
        limits: What may be commanded.
        period: Control period in s.
    """

    round_trip: float | None = None

    def __init__(
        self, hardware: Hardware, config: OwnConfig, limits: Limits, period: float
    ) -> None:
        self.config = config
        self.reading: Reading | None = None
        """The newest measurement that is one."""
        self.enabled = False
        self.now = hardware.time
        self._hardware = hardware
        self._file = type(hardware).start.__code__.co_filename
        self.where = type(hardware).__name__
        self._limit = float(np.max(limits.angle))
        self._period = period
        self._share = 1 - math.exp(-period / config.plate_lag) if config.plate_lag else 1.0
        self._rate, self._angle, self._model = np.zeros((3, 2))
        self._started = False
        self._astray: float | None = None
        self._looks = 0
        self._motion: deque[tuple[float, ...]] = deque(maxlen=round(DIRECTION.memory / period))
        """Commanded, then measured plate angles of the last periods, rad."""
        self._place, self._moved = (math.nan, math.nan), math.inf
        """Where the ball was seen last, and since when it is seen there on a steep plate."""
        self._reports = FaultReports(math.inf)

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
        self._started = True
        self._reports, self._astray = FaultReports(math.inf), None
        self._motion.clear()
        try:
            self._hardware.start()
            self.reading = self._checked(self._hardware.measure())
        except (Exception, SystemExit) as error:
            self.stop()
            raise RigError(f"{self.where}: {_describe_error(error, self._file)}") from error

    def stop(self) -> None:
        """Let the hardware stop; idempotent, never raises."""
        if self._started:
            self._started = self.enabled = False
            self._asked(self._hardware.stop)

    def enable(self) -> None:
        """The hardware has torque once it is started."""
        self.enabled = True

    def quick_stop(self) -> None:
        """Hold still from now on."""
        self._rate = np.zeros(2)

    def receive(self) -> None:
        """Take in the newest measurement."""
        for words in self._asked(self._said) or ():
            self._report(REPORTED, str(words))
        answer = self._asked(lambda: self._checked(self._hardware.measure()))
        if answer is not None:
            self.reading = answer
        self._watch()

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
    def _measured(self) -> Reading | None:
        """The newest reading if it has plate angles."""
        return self.reading if self.reading and self.reading.phi is not None else None

    def plate(self) -> Array:
        """Measured plate angles, or where the plate is believed to be, rad, shape (1, 2)."""
        reading = self._measured
        return np.array([reading[3:]]) if reading else self._model[None].copy()

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
        self._angle = self._model = np.asarray(plate, float).reshape(2)

    def faults(self) -> tuple[Fault, ...]:
        """Faults detected since the last call, oldest first."""
        return self._reports.take()

    def _checked(self, reading: Any) -> Reading:
        """A reading of finite time whose angles, if any, are finite; positions may be NaN.

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
        if (ahead := reading.at - self.now()) > self.config.silent:
            raise TypeError(f"at is {ahead:.3g} s ahead of time(): give self.time() as it arrived")
        return reading

    def _said(self) -> tuple[str, ...]:
        """What the hardware reports, a text by itself or several."""
        said = self._hardware.faults()
        return (said,) if isinstance(said, str) else tuple(said or ())

    def _watch(self) -> None:
        reading, now = self.reading, self.now()
        if reading is None:
            return
        if not now - reading.at <= self.config.silent:
            self._report(SILENT, f"none for {now - reading.at:.2f} s")
        plate, place = self.plate()[0], (reading.x, reading.y)
        if place != self._place or np.degrees(np.abs(plate).max()) <= self.config.steep_deg:
            self._place, self._moved = place, now
        elif now - self._moved > self.config.rest:
            self._report(FROZEN, f"the same for {now - self._moved:.2f} s on a tilted plate")
        if reading.phi is None:
            return
        self._motion.append((*self._model.tolist(), *plate.tolist()))
        self._looks += 1
        if self._looks % DIRECTION.every == 0:
            self._watch_direction(DIRECTION)
        off = float(np.degrees(np.abs(plate - self._model).max()))
        if off <= self.config.astray_deg:
            self._astray = None
        elif self._astray is None:
            self._astray = now
        elif now - self._astray > ASTRAY_FOR:
            self._watch_direction(AT_ONCE)
            self._report(ASTRAY, f"{off:.1f} deg off for {now - self._astray:.1f} s")

    def _watch_direction(self, test: _DirectionTest) -> None:
        """Report an axis that is measured to turn against its commands."""
        commanded, measured = np.split(np.array(self._motion), 2, axis=1)
        for axis, name in enumerate(AXES):
            told, seen = commanded[:, axis], measured[:, axis]
            if test.opposite(told, seen, self._period):
                turned = np.degrees((told[-1] - told[0], seen[-1] - seen[0]))
                text = f"{name}: commanded {turned[0]:+.2f} deg, measured {turned[1]:+.2f} deg"
                self._report(OPPOSITE, text)

    def _asked(self, method: Callable[[], Answer]) -> Answer | None:
        """What a method of the hardware gives; None, and a fault, where it fails."""
        try:
            return method()
        except (Exception, SystemExit) as error:  # noqa: BLE001 - a user's file may do anything
            self._report(FAILED, _describe_error(error, self._file))
            return None

    def _report(self, condition: Condition, detail: str) -> None:
        self._reports.report(condition, self.where, detail, self.now())


class OwnScreen:
    """The ball as own hardware sees it; the methods are those of `LumioScreen`.

    Args:
        servos: Who reads it.
    """

    def __init__(self, servos: OwnServos) -> None:
        self._servos, self.where = servos, servos.where
        self.start()

    def start(self) -> None:
        """Know nothing of what was before."""
        self._position, self._seen = np.zeros((1, 2)), -math.inf

    def stop(self) -> None:
        """Nothing to close."""

    def note_plate(self, plate: Array) -> None:
        """Not needed."""

    def faults(self) -> tuple[Fault, ...]:
        """None of its own."""
        return ()

    def read(self) -> Touch:
        """The newest position seen, with its age."""
        reading, now = self._servos.reading, self._servos.now()
        if reading is not None and math.isfinite(reading.x) and math.isfinite(reading.y):
            self._position, self._seen = np.array([[reading.x, reading.y]]), reading.at
            touched = True
        else:
            touched = now - self._seen <= self._servos.config.unseen
        return Touch(self._position, np.array([max(0.0, now - self._seen)]), np.array([touched]))
