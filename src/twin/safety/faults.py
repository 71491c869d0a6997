"""The fault matrix's rows: what is done to a rig that tracks a circle, and what must come of it.

They are written in ``cases.toml``. What is done is a cause of ``causes.toml`` or a function here; a
row without a name of its own is called what its function's docstring says.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from controllers.arrays import Array
from twin.data_file import packaged
from twin.devices import realtime
from twin.devices.akd import conditions as akd
from twin.devices.akd.config import AkdConfig, MonitorConfig
from twin.devices.lumio import conditions as lumio
from twin.devices.lumio.config import PlausibilityLimits
from twin.devices.rig import HardwareRig
from twin.emulator.can_bus import Towards
from twin.emulator.drive import Power
from twin.emulator.drive_objects import Frame
from twin.emulator.lockstep import PATIENCE, LockstepRig
from twin.emulator.screen import Protocol, ScreenFault
from twin.hal import supervisor
from twin.hal.cams import FixedRatio
from twin.hal.interface import Condition, Limits
from twin.safety.case import BEYOND, BRING_UP, Act, FaultCase, Stopper

NAMES = {each.name: each for kind in (Power, Protocol, Towards) for each in kind}
"""What a text in a step names."""


class FaultCause(NamedTuple):
    """Something that can go wrong; called with what it goes wrong with, it does.

    Attributes:
        name: What rows call it.
        words: What it is, in words.
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
                place = place[int(part)] if part.isdigit() else getattr(place, part)
            if callable(there := getattr(place, last)):
                more = given.pop() if given and isinstance(given[-1], dict) else {}
                there(*given, **more)
            else:
                setattr(place, last, *given)


def _meant(value: Any) -> Any:
    """What a value in a step stands for."""
    if isinstance(value, list):
        return tuple(map(_meant, value))
    if isinstance(value, dict):
        return {key: _meant(each) for key, each in value.items()}
    return NAMES.get(value, value.encode()) if isinstance(value, str) else value


def _causes(table: dict[str, Any]) -> dict[str, FaultCause]:
    return {
        name: FaultCause(name, words, tuple((way, *map(_meant, given)) for way, *given in steps))
        for name, (words, *steps) in table.items()
    }


_TABLES = packaged("twin.safety", "causes.toml")
OF_DRIVES = _causes(_TABLES["drives"])
"""What can go wrong with two drives and their bus, `LockstepDrives`."""
OF_RIG = _causes(_TABLES["rig"])
"""What can go wrong with a rig, `LockstepRig`."""


_RPDO1, _CONTROL, _TARGET = 0x200, 0, 2
_ENABLE = struct.pack("<H", 0x0F)
_COUNT = 0.001 * math.pi / 30
"""Of a target rate, rad/s."""
_LIMITS = Limits()
_EDGE = np.add(_LIMITS.area, _LIMITS.margin)
"""Where the ball may be at most, x and y, m."""
_FAR, _FAST = 0.07, 1.65
"""From where along y a ball is pushed, m, and how fast, m/s: across the plate."""
_QUICK = 0.2
"""Rate in rad/s at which the plate turns when a row wants it to."""


def nothing(_: LockstepRig) -> None:
    """The ball rests."""


def no_adapter(rig: LockstepRig) -> None:
    """The CAN adapter is absent."""
    bad = akd.DriveError(akd.BAD_BUS, "CAN emulated", "no channel 'emulated'")
    rig.lockstep.missing = bad


def refused_reset(rig: LockstepRig) -> None:
    """Drive phi refuses the reset of its fault when switched on."""
    OF_DRIVES["lasting_fault"](rig.lockstep)
    rig.reset = True


def damage(rig: LockstepRig, fault: str, lasting: float = 0.06) -> None:
    """What the screen sends has a fault, by its name, for some seconds."""
    rig.line.damage.inject(ScreenFault[fault], rig.now() + lasting)


def stall(rig: LockstepRig, periods: int) -> None:
    """The loop misses so many periods between two."""
    rig.stall = periods * rig.period


def uneven(rig: LockstepRig) -> None:
    """Drives answer in half a period; every other command is computed for three quarters of one."""
    rig.lockstep.bus.faults.delay([0x181, 0x182, 0x281, 0x282], by=rig.period / 2)
    rig.uneven = 0.75 * rig.period


def another_sync(rig: LockstepRig) -> None:
    """Another master sends SYNC."""
    rig.lockstep.bus.beside.append((Frame(0x080), 0.002))


def another_command(rig: LockstepRig, rate: float) -> None:
    """Another master turns drive phi, at a rate in rad/s."""
    turn = _ENABLE + struct.pack("<i", round(rate / _COUNT))
    rig.lockstep.bus.beside.append((Frame(_RPDO1 + 1, turn), 0.0005))


def break_cams(rig: LockstepRig) -> None:
    """The cams give no number."""
    rig.replace_transmission(FixedRatio(math.nan))


def ask(rig: LockstepRig, phi: float, theta: float) -> None:
    """The controller asks for plate rates in rad/s."""
    rig.asked = np.array([[phi, theta]])


def no_quick_stop(rig: LockstepRig) -> None:
    """From now on every control word arrives as one that enables operation."""
    nodes = [_RPDO1 + drive.node for drive in rig.lockstep.drives]
    rig.lockstep.bus.faults.overwrite(nodes, at=_CONTROL, data=_ENABLE, towards=Towards.DRIVES)


def no_zero_rate(rig: LockstepRig) -> None:
    """From now on every target arrives as the present one."""
    for drive in rig.lockstep.drives:
        present = struct.pack("<i", drive.store.get(0x60FF))
        rig.lockstep.bus.faults.overwrite(
            _RPDO1 + drive.node, at=_TARGET, data=present, towards=Towards.DRIVES
        )


def together(rig: LockstepRig, *names: str) -> None:
    """Several causes or functions, one after the other."""
    for name in names:
        _done([name])(rig)


def zero_rate_in_turn(rig: LockstepRig) -> None:
    """The plate turns; then the motor encoder jumps, and no quick stop reaches the drives."""
    ask(rig, 2 * _QUICK, 2 * _QUICK)
    _once(rig, turns, lambda rig: together(rig, "no_quick_stop", "motor_jump"))


def push(rig: LockstepRig, x_rate: float, y_rate: float) -> None:
    """The ball has another velocity at once, m/s."""
    x, y = _ball(rig)
    rig.plant.devices.place(np.array([[x, x_rate, y, y_rate]]))


def push_later(rig: LockstepRig) -> None:
    """The ball is pushed across the plate along y, once it is on the far side."""
    _once(rig, lambda rig: bool(_ball(rig)[1] > _FAR), lambda rig: push(rig, 0.0, -_FAST))


def move_ball(rig: LockstepRig) -> None:
    """The ball is put elsewhere by hand."""
    x, y = _ball(rig)
    rig.plant.devices.place(np.array([[x - 0.15, 0.0, y - 0.15, 0.0]]))


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


def fast(rig: LockstepRig, axis: int) -> bool:
    """Whether the ball is too fast along an axis."""
    return bool(abs(rig.plant.devices.state[0, 1 + 4 * axis]) > float(_LIMITS.ball_speed))


def outside(rig: LockstepRig, axis: int) -> bool:
    """Whether the ball is outside of its area along an axis."""
    return bool(abs(_ball(rig)[axis]) > _EDGE[axis])


def steep(rig: LockstepRig, axis: int) -> bool:
    """Whether the plate is tilted too far about an axis."""
    return bool(abs(rig.plant.devices.state[0, 2 + 4 * axis]) > BEYOND)


def turns(rig: LockstepRig) -> bool:
    """Whether the plate turns about both axes."""
    return bool(np.abs(rig.plant.devices.state[0, 3::4]).min() > _QUICK)


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


SOURCES = {"drives": akd, "screen": lumio, "supervisor": supervisor, "loop": realtime}
"""Where conditions stand."""
WAITS = {
    "bring_up": BRING_UP,
    "power_on": HardwareRig.POWER_ON,
    "patience": PATIENCE,
    "period": AkdConfig().period,  # what is done after a period's commands shows in the next one's
    "stale": PlausibilityLimits().stale,
}
"""What may pass before the device concerned is asked, s."""


def _condition(name: str) -> Condition:
    source, _, which = name.partition(".")
    found: Condition = getattr(SOURCES[source], which)
    return found


def _done(given: list[Any]) -> Callable[[LockstepRig], Any]:
    """What a cause of the drives, of the rig, or a function does with a rig."""
    name, *arguments = given
    if cause := OF_DRIVES.get(name):
        return lambda rig: cause(rig.lockstep)
    function = OF_RIG.get(name) or globals()[name]
    return lambda rig: function(rig, *arguments)


def _words(name: str) -> str:
    """What a cause or a function does, in words."""
    cause = OF_DRIVES.get(name) or OF_RIG.get(name)
    return cause.words if cause else (globals()[name].__doc__ or "").rstrip(".")


def _host(table: dict[str, Any]) -> AkdConfig:
    return AkdConfig(**table | {"watch": MonitorConfig(**table.get("watch", {}))})


READ: dict[str, Callable[[Any], Any]] = {
    "act": _done,
    "begins": _done,
    "expected": _condition,
    "first": _condition,
    "stopped_by": lambda names: tuple(Stopper[name] for name in names),
    "states": lambda names: tuple(Power[name] for name in names),
    "protocol": lambda name: Protocol[name],
    "wait": lambda names: sum(WAITS[name] for name in names),
    "host": _host,
    "gate": lambda table: PlausibilityLimits(**table),
}
"""What a key's value stands for, where that is not the value itself."""


def _case(row: dict[str, Any]) -> FaultCase:
    given = {key: READ[key](value) if key in READ else value for key, value in row.items()}
    return FaultCase(**{"name": _words(row["act"][0]), "expected": None} | given)


_ROWS = packaged("twin.safety", "cases.toml")
GROUPS = {name: tuple(map(_case, rows)) for name, rows in _ROWS.items()}
"""The rows by what they are about."""
CASES = tuple(chain(*GROUPS.values()))
"""Every row of the matrix."""
