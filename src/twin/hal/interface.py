"""Conditions and faults of devices, limits of commands, and the interfaces behind a rig.

A device reports a `Fault`: condition, place, detail. `Clamp` keeps every command within `Limits`.
Behind a rig are two servos with plate encoders, a touch screen, a clock and a transmission.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, NamedTuple, Protocol

import numpy as np

from controllers.arrays import Arithmetic, Array, Mask, Number, column, elementwise
from twin.base.data_file import read_packaged
from twin.base.followers import FREE, GIVEN, Followers
from twin.base.settings import Unit, setting


class Severity(StrEnum):
    """Reaction of the supervisor.

    WARNING: recorded. LEVEL: level the plate with the drives, then hold.
    STOP: no motion is safe; zero rate, quick stop, drives off.
    """

    WARNING = "warning"
    LEVEL = "level"
    STOP = "stop"


AXIS_NAMES = ("phi", "theta")
"""The axes of the plate, in the order of every array of axes."""
LEVEL_REACTION = "level the plate, then hold"
"""Reaction to a condition of severity LEVEL, in words."""
NOMINAL_PERIOD = 0.002
"""Control period of the thesis in s, the default of every rig."""


class Condition(NamedTuple):
    """A condition of a fault, a row of the supervisor's table.

    Attributes:
        name: Its name in records, tables and messages, as ``heartbeat lost``.
        severity: Reaction of the supervisor.
        within: Longest time in s from its start to its detection at the nominal control period.
        reaction: The reaction in words.
        recovery: The action of a person before the next run, in words.
        device: Whether it is a fault of a device; a missing ball is not.
        periods: Number of control periods that are part of ``within``.
    """

    name: str
    severity: Severity
    within: float
    reaction: str
    recovery: str
    device: bool = True
    periods: int = 1

    def longest(self, period: float) -> float:
        """Longest time in s from its start to its detection at a control period in s."""
        return self.within + self.periods * (period - NOMINAL_PERIOD)


def conditions(package: str) -> dict[str, Condition]:
    """The conditions in ``conditions.toml`` of a package, by their names in programs.

    A reaction or recovery that is a key of the table ``words`` is replaced by its text.

    Args:
        package: Its full name.
    """
    table, found = read_packaged(package, "conditions.toml"), {}
    for name, row in table["conditions"].items():
        texts = {key: table["words"].get(row[key], row[key]) for key in ("reaction", "recovery")}
        found[name] = Condition(**row | texts | {"severity": Severity(row["severity"])})
    return found


class Fault(NamedTuple):
    """A detected condition.

    Attributes:
        condition: The condition.
        where: The device, as ``drive phi (node 1)`` or ``touch screen``.
        detail: The observation, in words and numbers.
        at: Its time on the monotonic clock of the rig, s; None if not recorded.
    """

    condition: Condition
    where: str
    detail: str
    at: float | None = None

    def __str__(self) -> str:
        return f"{self.where}: {self.condition.name}: {self.detail}"


class FaultSource(Protocol):
    """A device that reports its faults."""

    def faults(self) -> tuple[Fault, ...]:
        """Faults detected since the last call, oldest first; never waits."""


LIMIT_FOLLOWERS = Followers(
    mechanism=GIVEN,
    equations=GIVEN,
    source=FREE,
    explain="compares runs that do not stop; a limit that stops a rig is no tracking error",
    identify="fits the measured motion, whatever limited it",
    symbols=GIVEN,
)
STOP_FOLLOWERS = replace(LIMIT_FOLLOWERS, symbols="bound the ball by the operating area")


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Limits of a rig's commands, and of the position and speed of its ball; SI units.

    Fields are numbers, or arrays with one entry per rig.

    Attributes:
        angle: Plate angle either way, rad; thesis chapter 3: 10 deg.
        rate: Plate rate either way, rad/s; assumed, the thesis limits it without a number.
        acceleration: Plate acceleration either way, rad/s^2; thesis chapter 3: 7.
        area: Operating area |x|, |y| of references, m; thesis chapter 3: 0.25 x 0.15.
        margin: Distance beyond the area at which the rig stops, m; assumed.
        ball_speed: Speed of the ball along x or y at which the rig stops, m/s; assumed: over the
            plate's length at 10 deg it gains 1.3.
    """

    angle: Number = setting(
        "rig.limits.angle_deg", 10.0, Unit.DEG, followed_by=LIMIT_FOLLOWERS, gt=0, le=30
    )
    rate: Number = setting(
        "rig.limits.rate_deg",
        35.0,
        Unit.DEG,
        followed_by=LIMIT_FOLLOWERS.by("limits", 3600.0),
        gt=0,
    )
    acceleration: Number = setting(
        "rig.limits.acceleration", 7.0, followed_by=LIMIT_FOLLOWERS.by("limits", 1e4), gt=0
    )
    area: tuple[float, float] | Array = setting(
        "rig.limits.area", (0.25, 0.15), followed_by=LIMIT_FOLLOWERS, gt=0
    )
    margin: Number = setting("rig.limits.margin", 0.04, followed_by=STOP_FOLLOWERS, ge=0)
    ball_speed: Number = setting("rig.limits.ball_speed", 1.5, followed_by=STOP_FOLLOWERS, gt=0)


class Clamp:
    """Keeps plate rates within the limits of rate, acceleration and braking before the angle limit.

    The acceleration limit has priority: it holds from every rate and angle. The angle limit holds
    from every state in which the plate can still be braked before it, so for all commands through
    the clamp; a plate that was turned past that point by other means is braked as fast as the
    acceleration limit allows.

    Args:
        limits: The limits.
        period: Control period in s.
    """

    def __init__(self, limits: Limits, period: float) -> None:
        angle, rate, acceleration = map(column, (limits.angle, limits.rate, limits.acceleration))
        self._acceleration = acceleration
        self._period = period
        self._step = acceleration * period
        self._half_step = self._step / 2
        self._whole_way = 2 * acceleration * angle
        self._per_angle = 2 * acceleration
        self._least, self._most = self._half_step**2, (rate + self._half_step) ** 2

    def __call__(self, requested: Array, rate: Array, angle: Array) -> Array:
        """The rates that may be commanded for the requested ones, rad/s, shape (N, 2).

        Args:
            requested: Finite rates, rad/s, shape (N, 2).
            rate: Rates commanded last, rad/s, shape (N, 2).
            angle: Plate angles, rad, shape (N, 2).
        """
        return elementwise(self.allowed, requested, rate, angle)

    def allowed(self, by: Arithmetic, requested: Any, rate: Any, angle: Any) -> Any:
        """The rate that may be commanded about one plate axis, rad/s, by any arithmetic."""
        sense = by.where(requested < 0, -1.0, 1.0)
        # A rate v braked by one step per period covers at most (v + step / 2)^2 / (2 a), so this
        # is the square of v + step / 2 that the way to the angle limit allows.
        square = self._whole_way - self._per_angle * (sense * angle)
        largest = by.sqrt(by.least(by.most(square, self._least), self._most)) - self._half_step
        requested = sense * by.least(largest, abs(requested))
        return by.least(by.most(requested, rate - self._step), rate + self._step)

    def towards_level(self, angle: Array) -> Array:
        """The rates that bring the plate level, with half of the acceleration allowed."""
        return -np.sign(angle) * np.minimum(
            np.sqrt(self._acceleration * np.abs(angle)), np.abs(angle) / (10 * self._period)
        )


SCREEN_SIZE_M = (0.70, 0.395)
"""Size of the touch screen along x and y in m, thesis chapter 3."""


class Touch(NamedTuple):
    """The newest ball position a touch screen has reported.

    Attributes:
        position: Ball in plate axes, m, shape (N, 2).
        age: Seconds since it arrived, shape (N,).
        touched: Whether the screen feels the ball, shape (N,).
    """

    position: Array
    age: Array
    touched: Mask


class Servos(Protocol):
    """Two velocity-controlled servo axes and the encoders on the plate, ordered (phi, theta)."""

    def plate(self) -> Array:
        """Plate angles from the plate encoders in rad, shape (N, 2)."""

    def motor(self) -> Array:
        """Motor shaft angles in rad, shape (N, 2)."""

    def command(self, motor_rate: Array) -> None:
        """Command the motor shaft rates in rad/s, shape (N, 2), until the next command."""


class TouchScreen(Protocol):
    """A touch screen that never makes its caller wait."""

    def read(self) -> Touch:
        """The newest sample."""


class PoweredServos(Servos, FaultSource, Protocol):
    """The servos of a real rig: brought up, driven period by period, shut down.

    A rig calls, in this order: ``start``, then ``enable`` until ``enabled``, then ``home``. After
    ``start``, once per period: ``receive`` when it begins, ``plate`` and ``motor``, ``command``,
    ``send``, and ``settle`` in the remaining idle time. ``stop`` ends it, also after any error.
    No method but ``start``, ``stop``, ``settle`` and ``sleep`` waits. An error after ``start`` is a
    `Fault` in ``faults``, never an exception. Rates and angles of the motors are those of the rig's
    transmission: at the cam shafts, or of the plate itself.
    """

    @property
    def lost(self) -> float:
        """Plate angle in rad that may be lost between motor and plate."""

    @property
    def late(self) -> float:
        """Longest time in s from a command to the motion of the plate."""

    @property
    def enabled(self) -> bool:
        """Whether both axes follow their commands."""

    @property
    def encoders(self) -> bool:
        """Whether ``plate`` is measured; False where it is computed from the commands."""

    @property
    def round_trip(self) -> float | None:
        """Seconds from the last command to its last answer; None while or where there is none."""

    def now(self) -> float:
        """Monotonic time in s; the servos have the clock of the rig."""

    def sleep(self, seconds: float) -> None:
        """Wait for a time in s; ``time.sleep`` where ``now`` is real time."""

    def start(self, *, reset: bool = False) -> None:
        """Connect both axes, supervised and without motion; may wait.

        Args:
            reset: Whether faults that the drives hold are reset, as a person requests.

        Raises:
            TwinError: If a device is not as it must be; all is disconnected again then.
        """

    def stop(self) -> None:
        """Stand still, take the torque away, disconnect; idempotent, never raises."""

    def enable(self) -> None:
        """Request torque at zero rate; ``enabled`` shows when it is there.

        Raises:
            TwinError: If a fault forbids it.
        """

    def quick_stop(self) -> None:
        """Request standstill, then no torque; called in every period after a fault."""

    def home(self, plate: Array, motor: Array) -> None:
        """Declare the present angles of plate and motors, rad, shape (1, 2) each."""

    def receive(self) -> None:
        """Process received data."""

    def send(self) -> None:
        """Send the commands of the period that begins."""

    def settle(self, limit: float) -> None:
        """Wait for the answers to the last commands, at most for a time in s."""

    def turned(self) -> tuple[Array, Array] | None:
        """Plate and motor angles in rad, shape (2,) each, of one moment; None if none is known."""

    def age(self) -> Array:
        """Seconds since the plate angles were measured, shape (1, 2); 0 for computed ones."""

    def warnings(self) -> tuple[Fault, ...]:
        """Warnings of every run from its start, as a missing safety net."""


class PoweredScreen(TouchScreen, FaultSource, Protocol):
    """The touch screen of a real rig: started, read period by period, stopped.

    After ``start``, once per period: ``receive`` when it begins, ``note_plate``, ``read``,
    ``faults``. No method but ``start`` and ``stop`` waits. An error after ``start`` is a `Fault` in
    ``faults``, never an exception.
    """

    @property
    def where(self) -> str:
        """Its name in messages."""

    def start(self) -> None:
        """Connect, without any earlier measurement; may wait.

        Raises:
            TwinError: If it cannot; all is disconnected again then.
        """

    def stop(self) -> None:
        """Disconnect; idempotent, never raises."""

    def receive(self) -> None:
        """Process received data."""

    def note_plate(self, plate: Array) -> None:
        """Store the plate angles (phi, theta), rad, shape (1, 2): no ball rests on a tilt."""


class Clock(Protocol):
    """Time as the loop sees it."""

    @property
    def time(self) -> float:
        """Seconds since the start."""

    def wait(self) -> None:
        """Return at the beginning of the next control period."""


class Transmission(Protocol):
    """Maps plate angles to motor angles."""

    def motor(self, plate: Array) -> Array:
        """Motor angles that hold the plate angles (phi, theta), both rad, (..., 2)."""
