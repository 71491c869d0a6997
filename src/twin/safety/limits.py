"""What must come of a fault done on purpose, and within which limits: times, tilt, way of the ball.

Nothing in a limit is measured but how the plate tilts and moves and where the ball rolls when the
fault begins: the time a stop takes follows from who has to stop the rig, the tilt and the way of
the ball follow from that time.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from controllers.arrays import Array
from controllers.ballplate import BallPlate
from twin.devices.akd.config import SHUTDOWN_STEP_LIMIT_S, AkdConfig
from twin.devices.lumio.config import PlausibilityLimits
from twin.emulator.drive import COASTING_TIME_S, STOP_RAMP
from twin.emulator.power_stage import Power
from twin.emulator.screen import Protocol
from twin.hal.interface import SCREEN_SIZE_M, Condition, Limits, Severity
from twin.hal.supervisor import Supervisor

if TYPE_CHECKING:
    from twin.emulator.lockstep import LockstepRig

STANDSTILL_RAD_S = 0.02
"""Plate rate in rad/s that counts as standstill: what levelling commands for one count of the
plate encoders, 0.38 mrad in its time constant of 20 ms."""
LEVEL_RAD = float(np.radians(0.3))
"""Plate angle in rad that counts as level: quantisation and noise of the angle, and friction."""


class Stopper(StrEnum):
    """Agent that ended the motion of an axis, the lines of defence in their order first."""

    LEVELLING = "host's levelling"
    QUICK_STOP = "host's quick stop"
    HEARTBEAT = "drive's heartbeat watch"
    STO = "safe torque off"
    DRIVE = "the drive itself"
    """By a stop of its own: its fault reaction, or a quick stop that nobody here asked for."""
    LOST_TORQUE = "loss of torque"
    """Nobody: the fault took the torque away, and the motor runs out."""
    NOBODY = "nobody"


Act = Callable[["LockstepRig"], None]
"""Something done to a rig."""
REACHED_STATES = {
    Stopper.NOBODY: Power.OPERATION_ENABLED,
    Stopper.LEVELLING: Power.OPERATION_ENABLED,
    Stopper.QUICK_STOP: Power.SWITCH_ON_DISABLED,
    Stopper.LOST_TORQUE: Power.SWITCH_ON_DISABLED,
    Stopper.HEARTBEAT: Power.FAULT,
    Stopper.STO: Power.FAULT,
    Stopper.DRIVE: Power.FAULT,
}
"""The state that a stop must lead to: with torque, held level; else without."""


@dataclass(frozen=True)
class FaultCase:
    """One fault done on purpose, and what must come of it: a row of the matrix.

    Attributes:
        name: What is done, in words.
        act: Does it.
        expected: The condition that must be reported; None if nothing may come of it.
        before: Whether it is done before the rig is switched on; a condition must refuse that.
        protocol: What the touch screen speaks.
        resting: Whether the ball rests instead of tracking the circle.
        stubborn: Whether a reset must be refused as long as the cause is there.
        of_screen: Whether it shows in the screen's bytes, a dead time and a frame later.
        first: The condition that stops the rig, where it shows before the expected one.
        stopped_by: Who must stop phi and theta; empty for the condition's severity.
        states: The states that phi and theta must reach; empty for those of ``REACHED``.
        required_text: Text required in the error line.
        wait: What passes in s before the device concerned is asked, when switching on.
        withheld: Whether the host is left with nothing but to end its heartbeat.
        hangs: Whether the host hangs: it detects nothing, so that the drives' detection counts.
        speed: Plate rate in rad/s that the fault itself brings about.
        slow: How many times longer than meant a control period lasts.
        shoved: For how long in s the plate is turned with ``speed`` by force.
        begins: Tells when the fault is there, of a cause that takes its time; the act starts it.
        goes: Whether the ball is on its way off the plate, so that nothing can keep it there.
        zeroed: Whether the zero rate of a stop brakes the drives, whoever ends their torque.
        host: Settings of the drives.
        gate: Thresholds of the touch screen.
    """

    name: str
    act: Act
    expected: Condition | None
    _: KW_ONLY
    before: bool = False
    protocol: Protocol = Protocol.MICROTOUCH
    resting: bool = False
    stubborn: bool = False
    of_screen: bool = False
    first: Condition | None = None
    stopped_by: tuple[Stopper, ...] = ()
    states: tuple[Power, ...] = ()
    required_text: str = ""
    wait: float = 0.0
    withheld: bool = False
    hangs: bool = False
    speed: float = 0.0
    slow: float = 1.0
    shoved: float = 0.0
    begins: Callable[[LockstepRig], bool] = lambda _: True
    goes: bool = False
    zeroed: bool = False
    host: AkdConfig = field(default_factory=AkdConfig)
    gate: PlausibilityLimits = field(default_factory=PlausibilityLimits)

    @property
    def refused(self) -> bool:
        """Whether the rig must not be switched on."""
        return self.before and self.severity not in {None, Severity.WARNING}

    @property
    def severity(self) -> Severity | None:
        """Severity of the expected condition."""
        return self.expected.severity if self.expected else None

    @property
    def reason(self) -> str:
        """Name of the condition for which the rig must end up as it does; empty if for none."""
        reason = self.first or self.expected
        if reason is None or reason.severity is Severity.WARNING:
            return ""
        return reason.name

    @property
    def stoppers(self) -> tuple[Stopper, ...]:
        """Who must stop phi and theta."""
        if self.stopped_by:
            return self.stopped_by
        if self.refused or not self.reason:
            return Stopper.NOBODY, Stopper.NOBODY
        level = (self.first or self.expected).severity is Severity.LEVEL  # type: ignore[union-attr]
        return (Stopper.LEVELLING if level else Stopper.QUICK_STOP,) * 2

    @property
    def reached(self) -> tuple[Power, ...]:
        """States that phi and theta must reach."""
        if self.states:
            return self.states
        if self.refused:
            return Power.SWITCH_ON_DISABLED, Power.SWITCH_ON_DISABLED
        return tuple(REACHED_STATES[stopper] for stopper in self.stoppers)


DEFAULT_LIMITS, DEFAULT_BALL = Limits(), BallPlate()
ANGLE_LIMIT_RAD, RATE_LIMIT_RAD_S, ACCELERATION_LIMIT_RAD_S2 = (
    float(DEFAULT_LIMITS.angle),
    float(DEFAULT_LIMITS.rate),
    float(DEFAULT_LIMITS.acceleration),
)
MAX_ANGLE_RAD = float(ANGLE_LIMIT_RAD + Supervisor.ANGLE_SLACK_RAD)
"""Largest plate angle in rad that the clamp and its slack for encoder and spring allow."""
STOP_RAMP_S = AkdConfig().rate_limit / STOP_RAMP
"""Time in s in which a drive brakes from its velocity limit with its quick stop ramp."""
LAST_HEARTBEAT_S = 2 * SHUTDOWN_STEP_LIMIT_S + 0.05
"""Longest time in s from the end of a run to the host's last heartbeat: it waits for standstill,
then for no torque, then sends what is left."""


@dataclass(frozen=True)
class AtFault:
    """The rig when a fault begins.

    Attributes:
        tilt: Larger plate angle, rad.
        rate: Larger plate rate, rad/s.
        ball: Distances from the centre along x and y, m, shape (2,).
        velocity: Speeds of the ball along x and y, m/s, shape (2,).
    """

    tilt: float
    rate: float
    ball: Array
    velocity: Array


def standstill_limit(case: FaultCase, detected: float, at: AtFault) -> float | None:
    """Longest time in s from the fault to standstill; None where nothing has to stop.

    Args:
        case: The row.
        detected: Longest time to its detection, s.
        at: The rig at the fault.
    """
    times = [STOP_LIMITS[each](case, detected, at) for each in case.stoppers if each in STOP_LIMITS]
    return max(times, default=None)


def _quick_stopped(case: FaultCase, detected: float, _: AtFault) -> float:
    """Detection, two periods to the drives, the ramp from the velocity limit."""
    return detected + 2 * case.host.period + STOP_RAMP_S


def _time_until_watched(case: FaultCase, detected: float, at: AtFault) -> float:
    return (
        _quick_stopped(case, detected, at) if case.zeroed else _time_without_watch(case, detected)
    )


def _time_without_watch(case: FaultCase, detected: float) -> float:
    """Until a drive has no torque that watches the host.

    The silence that the drives allow, one period, and the ramp. Before that, where the host ends
    its heartbeat on purpose, detection, two periods, and its patience with the quick stop or, if
    that comes first, leaving the bus.
    """
    watch = case.host.silence + case.host.period + STOP_RAMP_S
    if not case.withheld:
        return watch
    return detected + min(case.host.watch.stop, LAST_HEARTBEAT_S) + 2 * case.host.period + watch


def _run_out(case: FaultCase, _: float, at: AtFault) -> float:
    """Two periods, then down to 1/e in every time constant without torque."""
    rate = at.rate + 2 * ACCELERATION_LIMIT_RAD_S2 * case.host.period
    return 2 * case.host.period + COASTING_TIME_S * math.log(max(rate / STANDSTILL_RAD_S, 1.0))


def _time_to_level(case: FaultCase, detected: float, at: AtFault) -> float:
    """Brake, turn back at the rate limit, then at the root of acceleration times angle.

    After detection, and with the time in which a measured drift is taken in.
    """
    angle, rate = tilt_limit(case, detected, 0.0, at), _fastest(case, detected, at)
    last = 10 * case.host.period  # time constant of the last piece, see `Clamp.towards_level`
    back = min(RATE_LIMIT_RAD_S, math.sqrt(ACCELERATION_LIMIT_RAD_S2 * angle))
    time = (rate + back) / ACCELERATION_LIMIT_RAD_S2
    time += (
        max(0.0, angle - back**2 / ACCELERATION_LIMIT_RAD_S2) / RATE_LIMIT_RAD_S
        + 2 * back / ACCELERATION_LIMIT_RAD_S2
    )
    time += (
        last * math.log(ACCELERATION_LIMIT_RAD_S2 * last / STANDSTILL_RAD_S)
        + Supervisor.DRIFT_TIME_S
    )
    return detected + case.slow * time


STOP_LIMITS: dict[Stopper, Callable[[FaultCase, float, AtFault], float]] = {
    Stopper.LEVELLING: _time_to_level,
    Stopper.QUICK_STOP: _quick_stopped,
    Stopper.HEARTBEAT: _time_until_watched,
    Stopper.STO: _run_out,
    Stopper.LOST_TORQUE: _run_out,
    Stopper.DRIVE: lambda case, *_: case.host.period + STOP_RAMP_S,
}
"""Longest time to standstill by who has to stop an axis, from case, detection in s and fault."""


def torque_off_limit(case: FaultCase, detected: float, stop: float | None) -> float | None:
    """Longest time in s to no torque; None where the plate is held, or nothing has to stop.

    Two periods from standstill.
    """
    if stop is None or Stopper.LEVELLING in case.stoppers:
        return None
    return (_time_without_watch(case, detected) if case.zeroed else stop) + 2 * case.host.period


def tilt_limit(case: FaultCase, detected: float, stop: float | None, at: AtFault) -> float:
    """Largest plate angle in rad after the fault.

    The tilt at the fault, and the fastest rate until standstill, with levelling until detection and
    braking; never past the clamp. Where a fault turns the plate itself, its own rate until then,
    or the whole push and the fastest rate until detection.

    Args:
        case: The row.
        detected: Longest time to its detection, s.
        stop: Longest time to standstill, s; None where nothing has to stop.
        at: The rig at the fault.
    """
    if case.refused:
        return LEVEL_RAD  # nothing may move
    if stop is None:
        return MAX_ANGLE_RAD
    rate = _fastest(case, detected, at)
    if case.shoved:
        return at.tilt + case.speed * case.shoved + RATE_LIMIT_RAD_S * detected
    if Stopper.LEVELLING in case.stoppers:
        way = rate * detected + rate**2 / (2 * ACCELERATION_LIMIT_RAD_S2)
        return min(at.tilt + case.slow * way, MAX_ANGLE_RAD)
    largest = at.tilt + rate * stop
    return largest if case.speed else min(largest, MAX_ANGLE_RAD)


def _fastest(case: FaultCase, detected: float, at: AtFault) -> float:
    """Fastest plate rate in rad/s that a controller reaches until the fault is detected."""
    return max(min(at.rate + ACCELERATION_LIMIT_RAD_S2 * detected, RATE_LIMIT_RAD_S), case.speed)


def ball_limit(
    case: FaultCase, detected: float, stop: float | None, at: AtFault
) -> tuple[float, float]:
    """Farthest the ball may be from the centre along x and y until the plate stands, m.

    The operating area where nothing has to stop; else place and speed at the fault, and the slope
    of the largest tilt until standstill, on the plate.

    Args:
        case: The row.
        detected: Longest time to its detection, s.
        stop: Longest time to standstill, s; None where nothing has to stop.
        at: The rig at the fault.
    """
    way: Array = np.asarray(DEFAULT_LIMITS.area, float)
    if stop is not None:
        slope = DEFAULT_BALL.k1 * math.sin(tilt_limit(case, detected, stop, at))
        # A change of the plate's rate carries the ball along by c2 times it, (5.1).
        carried = 2 * DEFAULT_BALL.c2 * _fastest(case, detected, at)
        way = at.ball + (at.velocity + carried) * stop + slope * stop**2 / 2
        if not case.goes:
            way = np.minimum(way, np.array(SCREEN_SIZE_M) / 2)
    x, y = way.tolist()
    return x, y
