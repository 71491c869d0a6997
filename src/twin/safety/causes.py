"""Faults done on purpose: to two drives and their bus, or to a rig that tracks a circle.

Those that are a few steps each stand in ``causes.toml``, the others are functions here.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from controllers.arrays import Array
from twin.base.data_file import read_packaged
from twin.devices.akd import conditions as akd
from twin.emulator.can_bus import Towards
from twin.emulator.drive import VELOCITY_UNIT
from twin.emulator.drive_objects import Frame
from twin.emulator.power_stage import Power
from twin.emulator.screen import Protocol, ScreenFault
from twin.emulator.serve import Wiring
from twin.hal.cams import FixedRatio
from twin.hal.interface import SCREEN_SIZE_M
from twin.safety.limits import DEFAULT_LIMITS, MAX_ANGLE_RAD, Act

if TYPE_CHECKING:
    from twin.emulator.lockstep import LockstepRig

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


def act_of(given: list[Any]) -> Callable[[LockstepRig], Any]:
    """What a row does with a rig: a cause of the drives or of the rig, or one of ``ROW_FUNCTIONS``.

    Args:
        given: The name of the cause or function, and its arguments.

    Raises:
        KeyError: If there is none of this name.
    """
    name, *arguments = given
    if cause := OF_DRIVES.get(name):
        return lambda rig: cause(rig.lockstep)
    function = OF_RIG.get(name) or ROW_FUNCTIONS[name]
    return lambda rig: function(rig, *arguments)


def words_of(name: str) -> str:
    """Description in words of a cause, or of one of ``ROW_FUNCTIONS``, by its name.

    Raises:
        KeyError: If there is none of this name.
    """
    cause = OF_DRIVES.get(name) or OF_RIG.get(name)
    return cause.words if cause else (ROW_FUNCTIONS[name].__doc__ or "").rstrip(".")


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
        act_of([each] if isinstance(each, str) else each)(rig)


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
def omit_check(rig: LockstepRig) -> None:
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
def is_rewired(rig: LockstepRig) -> bool:
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
