"""The fault matrix's rows: what is done to a rig, what must come of it, and within which limits.

Nothing in a limit is measured but how the plate tilts and moves and where the ball rolls when the
fault begins: the time a stop takes follows from who has to stop the rig, the tilt and the way of
the ball follow from that time.

Rows are written in ``cases.toml``. What is done to a rig that tracks a circle is a cause of
``causes.toml`` or a function here; a row without a name of its own gets its name from the docstring
of its function.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, field
from enum import StrEnum
from itertools import chain
from typing import Any, NamedTuple, TypeVar

import numpy as np

from controllers.arrays import Array
from controllers.ballplate import BallPlate
from twin.base.data_file import read_packaged
from twin.base.errors import ScenarioError
from twin.devices import common, realtime
from twin.devices import rig as hardware
from twin.devices.akd import conditions as akd
from twin.devices.akd.config import AkdConfig, MonitorConfig
from twin.devices.akd.servos import SHUTDOWN_STEP_LIMIT_S
from twin.devices.lumio import conditions as lumio
from twin.devices.lumio.config import PlausibilityLimits
from twin.devices.rig import HardwareRig
from twin.emulator.can_bus import Towards
from twin.emulator.drive import COASTING_TIME_S, STOP_RAMP, VELOCITY_UNIT
from twin.emulator.drive_objects import Frame
from twin.emulator.fault_lines import MATRIX_ROWS, fault_name
from twin.emulator.lockstep import BALL_TIMEOUT_S, LockstepRig
from twin.emulator.power_stage import Power
from twin.emulator.screen import Protocol, ScreenFault
from twin.emulator.serve import Wiring
from twin.hal import agreement, supervisor
from twin.hal.cams import FixedRatio
from twin.hal.interface import SCREEN_SIZE_M, Condition, Limits, Severity
from twin.hal.supervisor import Supervisor

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


Act = Callable[[LockstepRig], None]


BRING_UP = akd.NODE_ABSENT.within
"""Longest time in s from switching on to drives that could be enabled, or a refusal."""
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
        says: Text required in the error line.
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
    says: str = ""
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


STEP_NAMES = {each.name: each for kind in (Power, Protocol, Towards) for each in kind}
"""Enumeration members that a step may name."""


class FaultCause(NamedTuple):
    """Something that can go wrong; a call makes it go wrong in the given way.

    Attributes:
        name: What rows call it.
        words: Its description, in words.
        steps: How it comes about: each a way, and what is given there.
    """

    name: str
    words: str
    steps: tuple[tuple[Any, ...], ...]

    def __call__(self, target: Any) -> None:
        """Make it go wrong with two drives and their bus, or with a rig."""
        for way, *given in self.steps:
            *through, last = way.split(".")
            place = target
            for part in through:
                place = place[int(part)] if part.isdecimal() else getattr(place, part)
            if callable(there := getattr(place, last)):
                more = given.pop() if given and isinstance(given[-1], dict) else {}
                there(*given, **more)
            else:
                setattr(place, last, *given)


def _meant(value: Any) -> Any:
    """The value that a value in a step stands for."""
    if isinstance(value, list):
        return tuple(map(_meant, value))
    if isinstance(value, dict):
        return {key: _meant(each) for key, each in value.items()}
    return STEP_NAMES.get(value, value.encode()) if isinstance(value, str) else value


def _causes(table: dict[str, Any]) -> dict[str, FaultCause]:
    return {
        name: FaultCause(name, words, tuple((way, *map(_meant, given)) for way, *given in steps))
        for name, (words, *steps) in table.items()
    }


_CAUSE_TABLES = read_packaged("twin.safety", "causes.toml")
OF_DRIVES = _causes(_CAUSE_TABLES["drives"])
"""Causes of faults in two drives and their bus, `LockstepDrives`."""
OF_RIG = _causes(_CAUSE_TABLES["rig"])
"""Causes of faults in a rig, `LockstepRig`."""


_RPDO1, _TARGET = 0x200, 2
_BALL_EDGE_M = np.add(DEFAULT_LIMITS.area, DEFAULT_LIMITS.margin)
"""Where the ball may be at most, x and y, m."""
_PUSH_PLACE_M, _PUSH_SPEED_M_S = 0.07, 1.65
"""From where along y a ball is pushed, m, and how fast, m/s: across the plate."""
_FAST_TURN_RAD_S = 0.2
"""Rate in rad/s at which the plate turns when a row wants it to."""


Function = TypeVar("Function", bound=Callable[..., Any])
ROW_FUNCTIONS: dict[str, Callable[..., Any]] = {}
"""Functions that a row of ``cases.toml`` may name besides the causes of ``causes.toml``."""


def row_function(function: Function) -> Function:
    """Let rows name a function."""
    ROW_FUNCTIONS[function.__name__] = function
    return function


@row_function
def nothing(_: LockstepRig) -> None:
    """The ball rests."""


@row_function
def no_adapter(rig: LockstepRig) -> None:
    """The CAN adapter is absent."""
    bad = akd.DriveError(akd.BAD_BUS, "CAN emulated", "no channel 'emulated'")
    rig.lockstep.missing = bad


@row_function
def damage(rig: LockstepRig, fault: str, lasting: float = 0.06) -> None:
    """What the screen sends has a fault, by its name, for some seconds."""
    rig.line.damage.inject(ScreenFault[fault], rig.now() + lasting)


@row_function
def stall(rig: LockstepRig, periods: int) -> None:
    """The loop misses so many periods between two."""
    rig.stall = periods * rig.period


@row_function
def uneven(rig: LockstepRig) -> None:
    """Drives answer in half a period; every other command is computed for three quarters of one."""
    rig.lockstep.bus.faults.delay([0x181, 0x182, 0x281, 0x282], by=rig.period / 2)
    rig.uneven = 0.75 * rig.period


@row_function
def another_sync(rig: LockstepRig) -> None:
    """A second master sends SYNC."""
    rig.lockstep.bus.foreign_frames.append((Frame(0x080), 0.002))


@row_function
def another_command(rig: LockstepRig, rate: float) -> None:
    """A second master turns drive phi, at a rate in rad/s."""
    turn = struct.pack("<Hi", 0x0F, round(rate / VELOCITY_UNIT))
    rig.lockstep.bus.foreign_frames.append((Frame(_RPDO1 + 1, turn), 0.0005))


@row_function
def break_cams(rig: LockstepRig) -> None:
    """The cams give no number."""
    rig.replace_transmission(FixedRatio(math.nan))


@row_function
def ask(rig: LockstepRig, phi: float, theta: float) -> None:
    """The controller asks for plate rates in rad/s."""
    rig.asked = np.array([[phi, theta]])


@row_function
def no_zero_rate(rig: LockstepRig) -> None:
    """From now on every target arrives as the present one."""
    for drive in rig.lockstep.drives:
        present = struct.pack("<i", drive.store.get(0x60FF))
        rig.lockstep.bus.faults.overwrite(
            _RPDO1 + drive.node, at=_TARGET, data=present, towards=Towards.DRIVES
        )


Named = str | list[Any]
"""A cause or function by its name, or a list of that and its arguments."""


@row_function
def together(rig: LockstepRig, *named: Named) -> None:
    """Several causes or functions, one after the other."""
    for each in named:
        _done([each] if isinstance(each, str) else each)(rig)


@row_function
def then(rig: LockstepRig, seconds: float, first: Named, second: Named) -> None:
    """A first cause or function, and a second one some seconds later."""
    due = rig.now() + seconds
    together(rig, first)
    _once(rig, lambda rig: rig.now() >= due, lambda rig: together(rig, second))


@row_function
def in_turn(rig: LockstepRig, *named: Named) -> None:
    """The plate is made to turn about both axes; then causes or functions."""
    ask(rig, 2 * _FAST_TURN_RAD_S, 2 * _FAST_TURN_RAD_S)
    _once(rig, turns, lambda rig: together(rig, *named))


@row_function
def also(rig: LockstepRig, cob_id: int, data: str, every: float, kind: str = "") -> None:
    """Somebody else sends a frame every so often, s; kind: remote or extended, if it is that."""
    rig.lockstep.bus.foreign_frames.append((_frame(cob_id, data, kind), every))


@row_function
def say(rig: LockstepRig, cob_id: int, data: str) -> None:
    """Somebody else sends a frame once."""
    rig.lockstep.bus.from_other(_frame(cob_id, data))


def _frame(cob_id: int, data: str, kind: str = "") -> Frame:
    return Frame(cob_id, bytes.fromhex(data), kind == "remote", kind == "extended")


@row_function
def rewire_in_turn(rig: LockstepRig, wiring: dict[str, list[float]]) -> None:
    """The plate turns; then drives, motors and encoders are joined otherwise."""
    ask(rig, 2 * _FAST_TURN_RAD_S, -1.5 * _FAST_TURN_RAD_S)
    joined = {key: (value[0], value[1]) for key, value in wiring.items()}
    _once(rig, turns, lambda rig: rig.plant.rewire(**joined))


@row_function
def level_by_wrong_encoders(rig: LockstepRig) -> None:
    """The plate turns; then it is levelled by encoders that count the wrong way."""
    ask(rig, 2 * _FAST_TURN_RAD_S, 2 * _FAST_TURN_RAD_S)

    def turn(rig: LockstepRig) -> None:
        rig.plant.rewire(encoder_scale=(-1.0, -1.0))
        ask(rig, math.nan, math.nan)

    _once(rig, turns, turn)


@row_function
def exchange_drives(rig: LockstepRig) -> None:
    """Both drives are exchanged with their encoders, and the ball is pushed."""
    rig.plant.rewire(motors=(1, 0), encoders=(1, 0))
    push(rig, 0.08, 0.02)


@row_function
def turn_axis_over(rig: LockstepRig) -> None:
    """Motor and encoder of phi both count the wrong way, and the ball is pushed."""
    rig.plant.rewire(motor_scale=(-1.0, 1.0), encoder_scale=(-1.0, 1.0))
    push(rig, 0.08, 0.02)


@row_function
def unchecked(rig: LockstepRig) -> None:
    """Nobody has checked the rig under its present configuration."""
    rig.unchecked = "doctor --move has not passed under this configuration"


@row_function
def push(rig: LockstepRig, x_rate: float, y_rate: float) -> None:
    """The ball changes its velocity at once, m/s."""
    x, y = _ball(rig)
    rig.plant.devices.place(np.array([[x, x_rate, y, y_rate]]))


@row_function
def push_later(rig: LockstepRig) -> None:
    """The ball is pushed across the plate along y, once it is on the far side."""
    _once(
        rig,
        lambda rig: bool(_ball(rig)[1] > _PUSH_PLACE_M),
        lambda rig: push(rig, 0.0, -_PUSH_SPEED_M_S),
    )


@row_function
def move_ball(rig: LockstepRig) -> None:
    """The ball is put elsewhere by hand."""
    x, y = _ball(rig)
    rig.plant.devices.place(np.array([[x - 0.15, 0.0, y - 0.15, 0.0]]))


@row_function
def shove(rig: LockstepRig, axis: int, rate: float, lasting: float) -> None:
    """The plate is turned further about an axis by force, at a rate in rad/s for a time in s."""
    end = rig.now() + lasting
    rig.plant.shoved[axis] = math.copysign(rate, rig.plant.devices.state[0, 2 + 4 * axis])
    moved = rig.lockstep.bus.moved

    def move(dt: float) -> None:
        if rig.now() >= end:
            rig.plant.shoved[:] = 0.0
        moved(dt)

    rig.lockstep.bus.moved = move


@row_function
def fast(rig: LockstepRig, axis: int) -> bool:
    """Whether the ball is too fast along an axis."""
    return bool(abs(rig.plant.devices.state[0, 1 + 4 * axis]) > float(DEFAULT_LIMITS.ball_speed))


@row_function
def outside(rig: LockstepRig, axis: int) -> bool:
    """Whether the ball is outside of its area along an axis."""
    return bool(abs(_ball(rig)[axis]) > _BALL_EDGE_M[axis])


@row_function
def steep(rig: LockstepRig, axis: int) -> bool:
    """Whether the plate is tilted too far about an axis."""
    return bool(abs(rig.plant.devices.state[0, 2 + 4 * axis]) > MAX_ANGLE_RAD)


@row_function
def off(rig: LockstepRig) -> bool:
    """Whether the ball is off the screen."""
    return bool((np.abs(_ball(rig)) > np.array(SCREEN_SIZE_M) / 2).any())


@row_function
def late(rig: LockstepRig) -> bool:
    """Whether positions come later than the screen's driver allows."""
    since = rig.line.damage.lasting(rig.now(), ScreenFault.LATER)
    return rig.line.damage.LATER * since > rig.touch.gate.late


@row_function
def turns(rig: LockstepRig) -> bool:
    """Whether the plate turns about both axes."""
    return bool(np.abs(rig.plant.devices.state[0, 3::4]).min() > _FAST_TURN_RAD_S)


@row_function
def rewired(rig: LockstepRig) -> bool:
    """Whether drives, motors and encoders are joined otherwise."""
    return rig.plant.wiring != Wiring()


def _ball(rig: LockstepRig) -> Array:
    """Position of the ball along x and y, m."""
    return rig.plant.devices.state[0, 0::4]


def _once(rig: LockstepRig, there: Callable[[LockstepRig], bool], act: Act) -> None:
    """Act as soon as something is so, after the step of the bus in which it comes about."""
    moved = rig.lockstep.bus.moved

    def move(dt: float) -> None:
        moved(dt)
        if there(rig):
            rig.lockstep.bus.moved = moved
            act(rig)

    rig.lockstep.bus.moved = move


CONDITION_SOURCES = {
    "drives": akd,
    "screen": lumio,
    "supervisor": supervisor,
    "agreement": agreement,
    "rig": hardware,
    "devices": common,
    "loop": realtime,
}
"""Where conditions stand."""
WAIT_LIMITS_S = {
    "bring_up": BRING_UP,
    "power_on": HardwareRig.POWER_ON,
    "patience": BALL_TIMEOUT_S,
    "period": AkdConfig().period,  # what is done after a period's commands shows in the next one's
    "stale": PlausibilityLimits().stale,
}
"""What may pass before the device concerned is asked, s."""


def _condition(name: str) -> Condition:
    source, _, which = name.partition(".")
    return getattr(CONDITION_SOURCES[source], which)


def _done(given: list[Any]) -> Callable[[LockstepRig], Any]:
    """What a cause of the drives, of the rig, or a function does with a rig."""
    name, *arguments = given
    if cause := OF_DRIVES.get(name):
        return lambda rig: cause(rig.lockstep)
    function = OF_RIG.get(name) or ROW_FUNCTIONS[name]
    return lambda rig: function(rig, *arguments)


def _words(name: str) -> str:
    """Description of a cause or a function, in words."""
    cause = OF_DRIVES.get(name) or OF_RIG.get(name)
    return cause.words if cause else (ROW_FUNCTIONS[name].__doc__ or "").rstrip(".")


KEY_READERS: dict[str, Callable[[Any], Any]] = {
    "act": _done,
    "begins": _done,
    "expected": _condition,
    "first": _condition,
    "stopped_by": lambda names: tuple(Stopper[name] for name in names),
    "states": lambda names: tuple(Power[name] for name in names),
    "protocol": lambda name: Protocol[name],
    "wait": lambda names: sum(WAIT_LIMITS_S[name] for name in names),
    "host": lambda table: AkdConfig(**table | {"watch": MonitorConfig(**table.get("watch", {}))}),
    "gate": lambda table: PlausibilityLimits(**table),
}
"""What a key's value stands for, where that is not the value itself."""


def _case(row: dict[str, Any]) -> FaultCase:
    given = {
        key: KEY_READERS[key](value) if key in KEY_READERS else value for key, value in row.items()
    }
    return FaultCase(**{"name": _words(row["act"][0]), "expected": None} | given)


_CASE_TABLES = read_packaged("twin.safety", "cases.toml")
CASE_GROUPS = {name: tuple(map(_case, rows)) for name, rows in _CASE_TABLES.items()}
"""The rows by what they are about."""
CASES = tuple(chain(*CASE_GROUPS.values()))
"""Every row of the matrix."""


def choose_cases(words: Sequence[str]) -> list[int]:
    """Indices of the cases with all of the words in name or condition; all if there are none.

    The beginning of a word is enough, in capital or small letters. The name of a fault of a run is
    that of its row.

    Raises:
        ScenarioError: If no case has the words of a text.
    """
    if not words:
        return list(range(len(CASES)))
    chosen: set[int] = set()
    for text in words:
        wanted = text.lower().split()
        row = MATRIX_ROWS.get(fault_name(text) or "")
        found = {
            index
            for index, case in enumerate(CASES)
            if case.name == row
            or (
                row is None
                and all(re.search(rf"\b{re.escape(word)}", _search_text(case)) for word in wanted)
            )
        }
        if not found or not wanted:
            raise ScenarioError(
                f"--only '{text:.80}': no fault or condition contains these words; "
                "`ballplate safety --list` lists all"
            )
        chosen |= found
    return sorted(chosen)


def _search_text(case: FaultCase) -> str:
    """The text of a case that words are looked up in, in small letters."""
    return f"{case.name} {case.expected.name if case.expected else 'none'}".lower()
