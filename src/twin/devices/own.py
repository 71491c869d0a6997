"""Hardware of one's own behind the seam: a class with a few methods in place of drives or screen.

One class may be both, ``backend = "my_rig.py:Arduino"`` in a rig file, or one half only: servos,
``[drives] kind = "own"``, or a screen, ``[touch] kind = "own"``, each with its ``backend``.
``ballplate.hardware`` is its public interface. A protection that it lacks, such as a watchdog on
the board, is reported in every run.
"""

from __future__ import annotations

import inspect
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
from typing import Any, NamedTuple, Self, TypeVar

import numpy as np

from controllers.arrays import Array
from controllers.catalog import EXECUTION_LOG, error_words, failed_line
from twin.base.errors import RigError, ScenarioError
from twin.devices.common import FaultReports, Ranged, net, range_field
from twin.hal.agreement import OPPOSITE, WRONG_RATIO
from twin.hal.interface import AXIS_NAMES, Condition, Fault, Limits, Touch, conditions

Answer = TypeVar("Answer")
Own = TypeVar("Own", bound="OwnDevice")


class Reading(NamedTuple):
    """The newest measurement of own hardware.

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

    @classmethod
    def of_plate(cls, phi: float, theta: float, at: float) -> Self:
        """Measurement of servos without a screen: plate angles in rad, and when they arrived, s."""
        return cls(math.nan, math.nan, at, phi, theta)


class OwnDevice(ABC):
    """Common base of own servos and screens."""

    @abstractmethod
    def start(self) -> None:
        """Connect; may wait. Servos bring the plate level, with torque."""

    @abstractmethod
    def stop(self) -> None:
        """Disconnect; also called after any error. Servos stand still, then have no torque."""

    @abstractmethod
    def measure(self) -> Reading:
        """The newest measurement, or the previous one if there is none; must not wait."""

    def time(self) -> float:
        """Monotonic time in s."""
        return time.monotonic()

    def faults(self) -> tuple[str, ...]:
        """What the hardware reports of itself, in words; anything ends the run."""
        return ()


class ScreenHardware(OwnDevice):
    """A screen or camera of one's own: derive from it, and write ``start``, ``measure``, ``stop``.

    The loop calls ``measure`` once per control period from one thread. What is raised in it levels
    the plate; the servos are other devices, and continue.
    """


class ServoHardware(OwnDevice):
    """Servos of one's own: derive from it, and write ``start``, ``command``, ``stop``.

    The loop calls ``measure`` and ``command`` once per control period from one thread; neither may
    wait. What is raised in any of them stops the rig. ``measure`` is for a plate with encoders:
    ``Reading.of_plate(phi, theta, self.time())``.
    """

    watchdog = False
    """Whether the board itself holds the plate still when it hears nothing for a while."""

    def measure(self) -> Reading:
        """No encoder: nothing is measured."""
        return Reading(math.nan, math.nan, self.time())

    @abstractmethod
    def command(self, rates: tuple[float, float], angles: tuple[float, float]) -> None:
        """Move the plate until the next command.

        Args:
            rates: Plate rates (phi', theta') in rad/s, for drives that hold a speed.
            angles: Plate angles (phi, theta) in rad at the end of the period, for servos that go to
                a position. The rates add up to them.
        """

    def wait(self, seconds: float) -> None:
        """Let time pass."""
        time.sleep(seconds)


class Hardware(ServoHardware, ScreenHardware):
    """A rig of one's own: derive from it, and write ``start``, ``measure``, ``command``, ``stop``.

    The loop calls ``measure`` and ``command`` once per control period from one thread; neither may
    wait. What is raised in any of them stops the rig.
    """

    @abstractmethod
    def measure(self) -> Reading:
        """The newest measurement, the one before again if there is none."""


@dataclass(frozen=True, kw_only=True)
class _OwnSettings(Ranged):
    """Settings of own hardware of any kind.

    Attributes:
        options: What the class is made with.
        silent: Seconds without a new measurement after which the plate is levelled.
    """

    options: Mapping[str, Any] = field(default_factory=dict)
    silent: float = net(0.25, 0.01, 5)


@dataclass(frozen=True, kw_only=True)
class _PlateThresholds(_OwnSettings):
    """Settings of own servos.

    Attributes:
        plate_lag: Time constant in s with which the plate follows its command; the plate angle of a
            rig without an encoder is computed with it.
        astray_deg: By how much the measured plate may differ from its command, deg.
    """

    plate_lag: float = range_field(0.0, 0, 2)
    astray_deg: float = net(3.0, 0.1, 20)

    @property
    def lost(self) -> float:
        """Plate angle in rad by which commanded and measured plate may differ."""
        return math.radians(self.astray_deg)

    @property
    def late(self) -> float:
        """Longest time in s from a command to the motion of the plate."""
        return 0.1 + 2 * self.plate_lag


@dataclass(frozen=True, kw_only=True)
class _BallThresholds(_OwnSettings):
    """Settings of an own screen.

    Attributes:
        unseen: Seconds without a ball in the measurements after which it counts as not seen.
        rest: Seconds in which a ball is measured in one and the same place, on a plate tilted by
            more than ``steep_deg``, after which the plate is levelled.
        steep_deg: Tilt on which no ball rests, deg.
    """

    unseen: float = net(0.1, 0, 2)
    rest: float = net(0.5, 0.05, 10)
    steep_deg: float = net(2.0, 0.2, 20)


@dataclass(frozen=True, kw_only=True)
class OwnServosConfig(_PlateThresholds):
    """The table ``[drives]`` of a rig file with ``kind = "own"``.

    Attributes:
        backend: File and class, ``my_servos.py:Feetech``.
    """

    keys = "drives."
    backend: str


@dataclass(frozen=True, kw_only=True)
class OwnScreenConfig(_BallThresholds):
    """The table ``[touch]`` of a rig file with ``kind = "own"``.

    Attributes:
        backend: File and class, ``my_camera.py:Camera``.
    """

    keys = "touch."
    backend: str


@dataclass(frozen=True, kw_only=True)
class OwnConfig(_BallThresholds, _PlateThresholds):
    """Settings of own hardware that is servos and screen, the table ``[own]``."""

    keys = "own."


@dataclass(frozen=True, kw_only=True)
class _DirectionTest:
    """When a plate counts as turning against its commands.

    Attributes:
        memory: Duration in s of the motion that is looked at.
        delays: How many s later than its command the plate may move.
        commanded: Minimum range of the command in rad.
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
            asked, seen = commanded[: len(commanded) - lag], measured[lag:]
            if len(asked) < 2 or not np.ptp(asked) >= self.commanded:
                return False
            asked = asked - asked.mean()
            slopes.append(float(asked @ (seen - seen.mean())) / float(asked @ asked))
        return max(slopes) <= self.slope


@dataclass(frozen=True, kw_only=True)
class _ScaleTest:
    """When a plate that misses its command counts as moving on a wrong scale.

    The measured angle is explained by the commanded one, delayed and behind a first-order lag:
    measured = gain * lagged(commanded, delay) + constant, by least squares, with an unknown start
    of the lag.

    Attributes:
        delays: How many s later than its command the plate may move.
        lags: Time constants in s with which it may follow.
        commanded: Minimum range of the command in rad.
        unexplained: Share of the motion, as root of the mean square, that may be left.
        too_far: Gain from which no lag and no slow servo explains the motion.
        too_near: Gain below which the plate is reported to turn too little.
    """

    delays: tuple[float, ...] = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25)
    lags: tuple[float, ...] = (0.0, 0.05, 0.1, 0.2)
    commanded: float = math.radians(2.0)
    unexplained: float = 0.1
    too_far: float = 1.3
    too_near: float = 0.75

    def gain(self, commanded: Array, measured: Array, period: float) -> float | None:
        """Measured per commanded angle, both in rad period by period, (n,).

        None where the command moves too little, or where no delay and lag explains the motion.
        """
        best: tuple[float, float] | None = None
        time = period * np.arange(len(commanded))
        for lag in self.lags:
            followed = _follow(commanded, 1 - math.exp(-period / lag)) if lag else commanded
            unknown = np.ones((len(time), 1))  # where the encoder has its zero, and the start
            if lag:
                unknown = np.column_stack((unknown, np.exp(-time / lag)))
            for delay in self.delays:
                late = round(delay / period)
                asked, seen = followed[: max(0, len(followed) - late)], measured[late:]
                if len(asked) < 2 or not np.ptp(asked) >= self.commanded:
                    continue
                known = np.column_stack((asked, unknown[: len(asked)]))
                fitted = np.linalg.lstsq(known, seen, rcond=None)[0]
                left = float(np.square(seen - known @ fitted).sum() / max(np.var(seen), 1e-12))
                if best is None or left / len(seen) < best[0]:
                    best = left / len(seen), float(fitted[0])
        return best[1] if best and best[0] <= self.unexplained**2 else None


def _follow(angle: Array, share: float) -> Array:
    """An angle in rad, (n,), behind a first-order lag that takes in a share each period."""
    followed, now = np.empty_like(angle), angle[0]
    for index, each in enumerate(angle):
        now += share * (each - now)
        followed[index] = now
    return followed


SCALE_TEST = _ScaleTest()
DIRECTION_TEST = _DirectionTest()
UNDELAYED_DIRECTION_TEST = _DirectionTest(delays=(0.0,))
"""The same for a plate that is known not to be where it should be, to tell in which way."""
ASTRAY_FOR = 0.3
"""Seconds for which a plate must be astray until it is a fault."""
OWN_CONDITIONS = tuple(conditions("twin.devices").values())
"""Every condition that own hardware is watched for, from ``conditions.toml``."""
FAILED, REPORTED, SILENT, ASTRAY, FROZEN, LACKING, *_OF_SCREEN = OWN_CONDITIONS
SCREEN_FAILED, SCREEN_REPORTED = _OF_SCREEN
"""Conditions of an own screen, in place of ``FAILED`` and ``REPORTED``."""


def load_backend(named: str, config: OwnConfig) -> Hardware:
    """The hardware that a rig file names, servos and screen in one; nothing is opened.

    Args:
        named: File and class, ``my_rig.py:Arduino``.
        config: Its options.

    Raises:
        ScenarioError: If there is no such class, or it cannot be made.
    """
    return _load(named, config.options, Hardware, "backend")  # type: ignore[type-abstract]


def load_servos(config: OwnServosConfig) -> ServoHardware:
    """The servos that the table ``[drives]`` names; nothing is opened.

    A class that is a screen as well serves as servos; nobody reads where it sees the ball.

    Raises:
        ScenarioError: If there is no such class, or it cannot be made.
    """
    return _load(config.backend, config.options, ServoHardware, "drives.backend")  # type: ignore[type-abstract]


def load_screen(config: OwnScreenConfig) -> ScreenHardware:
    """The screen that the table ``[touch]`` names; nothing is opened.

    Raises:
        ScenarioError: If there is no such class, it cannot be made, or it would move the plate.
    """
    key = "touch.backend"
    made = _load(config.backend, config.options, ScreenHardware, key)  # type: ignore[type-abstract]
    if isinstance(made, ServoHardware):
        raise ScenarioError(
            f"{key}: {config.backend} includes servos and would move the plate when it "
            "starts; a class for both devices is named as backend, above the tables"
        )
    return made


def _load(named: str, options: Mapping[str, Any], base: type[Own], key: str) -> Own:
    """The object of a class that a key of a rig file names."""
    file, _, name = named.rpartition(":")
    if not file.endswith(".py") or not Path(file).is_file():
        raise ScenarioError(f"{key}: {named!r} must be FILE.py:CLASS; no file {file!r}")
    EXECUTION_LOG.info("runs %s, the hardware of the rig file", file)
    sys.path.append(str(Path(file).resolve().parent))  # modules that it imports may lie there
    try:
        kind = runpy.run_path(file).get(name)
        if isinstance(kind, type) and issubclass(kind, base):
            _check_options(kind, options, key)
            return kind(**options)
    except ScenarioError:
        raise
    except (Exception, SystemExit) as error:
        raise ScenarioError(f"{key}: {_describe_error(error, file)}") from error
    raise ScenarioError(
        f"{key}: {file} has no class {name!r} derived from ballplate.hardware.{base.__name__}"
    )


def _check_options(kind: type, options: Mapping[str, Any], key: str) -> None:
    """Make sure that a class can be made with its options of the rig file.

    Raises:
        ScenarioError: If one is missing, or one too many.
    """
    signature = inspect.signature(kind)
    try:
        signature.bind(**options)
    except TypeError as error:
        where = "own.options" if key == "backend" else key.replace("backend", "options")
        takes = ", ".join(signature.parameters) or "none"
        raise ScenarioError(f"{where}: {error} (options of {kind.__name__}: {takes})") from None


def _describe_error(error: BaseException, file: str) -> str:
    """File, line and error in one line; the error alone if it came from elsewhere."""
    return failed_line(error, {file}) or error_words(error)


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
            raise RigError(f"{self.where}: {_describe_error(error, self._file)}") from error

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
                self._report(self._failed, _describe_error(error, self._file))
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

    def __init__(self, config: _BallThresholds) -> None:
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

    def _watch_direction(self, test: _DirectionTest) -> None:
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
