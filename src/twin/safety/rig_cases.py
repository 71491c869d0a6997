"""Rows of the supervisor, of the host's program, of settings, and of one line of defence alone."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable

import numpy as np

from controllers.arrays import Array
from twin.devices.akd import conditions as akd
from twin.devices.akd.config import AkdConfig, MonitorConfig
from twin.devices.lumio import conditions as lumio
from twin.devices.lumio.config import PlausibilityLimits
from twin.devices.realtime import LOOP_OVERRUN
from twin.emulator.can_faults import Frame, Towards
from twin.emulator.drive import Power
from twin.emulator.lockstep import LockstepRig
from twin.emulator.screen import ScreenFault
from twin.emulator.screen_bytes import Protocol
from twin.hal import supervisor
from twin.hal.interface import Limits, Transmission
from twin.safety import drive_causes
from twin.safety.case import BRING_UP, Act, FaultCase, Stopper
from twin.safety.limits import BEYOND

WATCHES = Stopper.HEARTBEAT, Stopper.HEARTBEAT
_RPDO1, _CONTROL, _TARGET = 0x200, 0, 2
_ENABLE = struct.pack("<H", 0x0F)
_HANG = 3.0
"""Time in s that a host hangs: until after the run's end."""


def no_quick_stop(rig: LockstepRig) -> None:
    """From now on every control word arrives as one that enables operation."""
    nodes = [_RPDO1 + drive.settings.node for drive in rig.lockstep.drives]
    rig.lockstep.bus.faults.overwrite(nodes, at=_CONTROL, data=_ENABLE, towards=Towards.DRIVES)


def _no_zero_rate(rig: LockstepRig) -> None:
    """From now on every target arrives as the present one."""
    for drive in rig.lockstep.drives:
        present = struct.pack("<i", drive.store.get(0x60FF))
        rig.lockstep.bus.faults.overwrite(
            _RPDO1 + drive.settings.node, at=_TARGET, data=present, towards=Towards.DRIVES
        )


def _level_alone(rig: LockstepRig) -> None:
    no_quick_stop(rig)
    rig.port.plugged = False


def _quick_stop_alone(rig: LockstepRig) -> None:
    _no_zero_rate(rig)
    drive_causes.motor_jump(rig.lockstep)


def watch_alone(rig: LockstepRig) -> None:
    """The motor encoder jumps, and neither zero rate nor quick stop reaches the drives."""
    no_quick_stop(rig)
    _no_zero_rate(rig)
    drive_causes.motor_jump(rig.lockstep)


def _hang(rig: LockstepRig) -> None:
    rig.hang = _HANG


def _sto_alone(rig: LockstepRig) -> None:
    for drive in rig.lockstep.drives:
        drive.store.set(0x1016, 1, 0)
        drive.open_sto()
    _hang(rig)


DEFENCES = (
    FaultCase(
        "Levelling alone: the screen is unplugged, and no quick stop reaches the drives",
        _level_alone,
        lumio.UNPLUGGED,
    ),
    FaultCase(
        "Quick stop alone: the motor encoder jumps, and no zero rate reaches the drives",
        _quick_stop_alone,
        akd.ENCODER_JUMP,
    ),
    FaultCase(
        "Heartbeat watch alone: the motor encoder jumps, and neither reaches the drives",
        watch_alone,
        akd.ENCODER_JUMP,
        stopped_by=WATCHES,
        withheld=True,
    ),
    FaultCase(
        "Heartbeat watch alone: the host hangs",
        _hang,
        LOOP_OVERRUN,
        stopped_by=WATCHES,
        hangs=True,
    ),
    FaultCase(
        "STO alone: the host hangs, the drives watch nobody, and STO is opened",
        _sto_alone,
        LOOP_OVERRUN,
        stopped_by=(Stopper.STO, Stopper.STO),
        hangs=True,
    ),
)
"""The last rows of the matrix."""


_LIMITS = Limits()
_EDGE = np.add(_LIMITS.area, _LIMITS.margin)
"""Where the ball may be at most, x and y, m."""
_NEXT = AkdConfig().period
"""What is done after a period's commands shows in the next one's, s."""
_SHOVE = 4.0
"""Rate in rad/s by which the plate is turned by force: faster than a drive counts as run away."""
_SHOVED = 0.05
"""For how long, s."""
_FAR, _FAST = 0.07, 1.65
"""From where along y a ball is pushed, m, and how fast, m/s: across the plate."""
_QUICK = 0.2
"""Rate in rad/s at which the plate turns when a row wants it to."""
_TURN = struct.pack("<Hi", 0x0F, round(1.2 / 0.001 / (math.pi / 30)))
"""RPDO1: enabled, 1.2 rad/s."""


def _ball(rig: LockstepRig) -> Array:
    """Position of the ball along x and y, m."""
    found: Array = rig.plant.devices.state[0, 0::4]
    return found


def _push(x_rate: float, y_rate: float) -> Act:
    def act(rig: LockstepRig) -> None:
        x, y = _ball(rig)
        rig.plant.devices.place(np.array([[x, x_rate, y, y_rate]]))

    return act


def _once(rig: LockstepRig, there: Callable[[LockstepRig], bool], act: Act) -> None:
    """Act as soon as something is so, after the step of the bus in which it comes about."""
    moved = rig.lockstep.bus.moved

    def move(dt: float) -> None:
        moved(dt)
        if there(rig):
            rig.lockstep.bus.moved = moved
            act(rig)

    rig.lockstep.bus.moved = move


def _push_later(rig: LockstepRig) -> None:
    """Push the ball across the plate along y, once it is on the far side."""
    _once(rig, lambda rig: bool(_ball(rig)[1] > _FAR), _push(0.0, -_FAST))


def _fast(axis: int) -> Callable[[LockstepRig], bool]:
    limit = float(_LIMITS.ball_speed)
    return lambda rig: bool(abs(rig.plant.devices.state[0, 1 + 4 * axis]) > limit)


def _outside(axis: int) -> Callable[[LockstepRig], bool]:
    return lambda rig: bool(abs(_ball(rig)[axis]) > _EDGE[axis])


def _move_ball(rig: LockstepRig) -> None:
    x, y = _ball(rig)
    rig.plant.devices.place(np.array([[x - 0.15, 0.0, y - 0.15, 0.0]]))


def _shove(axis: int) -> Act:
    def act(rig: LockstepRig) -> None:
        end = rig.now() + _SHOVED
        away = math.copysign(_SHOVE, rig.plant.devices.state[0, 2 + 4 * axis])
        rig.plant.shoved[axis] = away
        moved = rig.lockstep.bus.moved

        def move(dt: float) -> None:
            if rig.now() >= end:
                rig.plant.shoved[:] = 0.0
            moved(dt)

        rig.lockstep.bus.moved = move

    return act


def _steep(axis: int) -> Callable[[LockstepRig], bool]:
    return lambda rig: bool(abs(rig.plant.devices.state[0, 2 + 4 * axis]) > BEYOND)


def _ask(phi: float, theta: float) -> Act:
    def act(rig: LockstepRig) -> None:
        rig.asked = np.array([[phi, theta]])

    return act


class _Broken:
    """Cams that give no number."""

    def motor(self, plate: Array) -> Array:
        """No angles."""
        return np.full_like(plate, np.nan)


def _break_cams(rig: LockstepRig) -> None:
    broken: Transmission = _Broken()
    rig.replace_transmission(broken)


def _stick(rig: LockstepRig) -> None:
    rig.lockstep.drives[0].store.stuck.add((0x356E, 0))


def _no_adapter(rig: LockstepRig) -> None:
    bad = akd.DriveError(akd.BAD_BUS, "CAN emulated", "no channel 'emulated'")
    rig.lockstep.missing = bad


def _unreadable(rig: LockstepRig) -> None:
    rig.lockstep.adapter.unreadable_lines += 3


def _refused_reset(rig: LockstepRig) -> None:
    rig.lockstep.drives[0].fail(235, lasting=True)
    rig.lockstep.drives[0].power.refuse_reset = True
    rig.ask_reset()


def _beside(frame: Frame, every: float) -> Act:
    return lambda rig: rig.lockstep.bus.beside.append((frame, every))


def _speak_elo(rig: LockstepRig) -> None:
    rig.line.protocol = Protocol.ELO


def _dead(lasting: float) -> Act:
    return lambda rig: rig.inject(ScreenFault.MISSING_PEN_UP, lasting)


def nothing(_: LockstepRig) -> None:
    """Leave the rig alone."""


def _turns(rig: LockstepRig) -> bool:
    return bool(np.abs(rig.plant.devices.state[0, 3::4]).min() > _QUICK)


def _jump_unstopped(rig: LockstepRig) -> None:
    """The motor encoder jumps, and no quick stop reaches the drives."""
    no_quick_stop(rig)
    drive_causes.motor_jump(rig.lockstep)


def _jump_in_turn(rig: LockstepRig) -> None:
    """The same while the plate turns."""
    _ask(2 * _QUICK, 2 * _QUICK)(rig)
    _once(rig, _turns, _jump_unstopped)


SUPERVISED = (
    *(
        FaultCase(
            f"The ball is pushed out of its area along {name}",
            _push(*rates),
            supervisor.BALL_OUTSIDE,
            begins=_outside(axis),
            of_screen=True,
            goes=True,
        )
        for axis, name, rates in ((0, "x", (1.0, 0.0)), (1, "y", (0.0, 0.5)))
    ),
    *(
        FaultCase(
            f"The ball is pushed too fast along {name}",
            act,
            supervisor.BALL_FAST,
            begins=_fast(axis),
            of_screen=True,
            goes=True,
        )
        for axis, name, act in ((0, "x", _push(-_FAST, 0.0)), (1, "y", _push_later))
    ),
    *(
        FaultCase(
            f"The plate is turned past its limit by force, {name}",
            _shove(axis),
            supervisor.PLATE_TILTED,
            begins=_steep(axis),
            speed=_SHOVE,
            shoved=_SHOVED,
            goes=True,
        )
        for axis, name in ((0, "phi"), (1, "theta"))
    ),
    FaultCase(
        "The controller asks for what is no number",
        _ask(math.nan, 0.0),
        supervisor.BAD_REQUEST,
        wait=_NEXT,
    ),
    FaultCase(
        "The controller asks for the fastest turn for good",
        _ask(10.0, 0.0),
        supervisor.BALL_OUTSIDE,
        begins=_outside(0),
        of_screen=True,
        goes=True,
    ),
    FaultCase("The ball is put elsewhere by hand", _move_ball, lumio.RELOCATED, of_screen=True),
)
"""What the supervisor notices from measurements alone, and what the screen does of a ball."""

PROGRAM = (
    FaultCase("The cams give no number", _break_cams, akd.BAD_COMMAND, wait=_NEXT),
    FaultCase("The adapter garbles lines", _unreadable, akd.GARBLED),
    FaultCase("Another master sends SYNC", _beside(Frame(0x080), 0.002), akd.SECOND_MASTER),
    FaultCase(
        "Another master turns drive phi",
        _beside(Frame(0x201, _TURN), 0.0005),
        akd.SECOND_MASTER,
        speed=1.2,
    ),
    FaultCase("The screen says nothing for a moment", _dead(0.08), lumio.STALE, of_screen=True),
)
"""What reaches the host from beside its drives and its screen."""

UNFIT = (
    FaultCase("The CAN adapter is absent", _no_adapter, akd.BAD_BUS, before=True),
    FaultCase("Drive phi keeps its own torque limit", _stick, akd.WRONG_SETTING, before=True),
    FaultCase(
        "Drive phi refuses the reset of its fault when switched on",
        _refused_reset,
        akd.RESET_REFUSED,
        before=True,
        states=(Power.FAULT, Power.SWITCH_ON_DISABLED),
        wait=BRING_UP,
    ),
    FaultCase(
        "The screen speaks another protocol",
        _speak_elo,
        lumio.UNKNOWN_PROTOCOL,
        before=True,
        stopped_by=(Stopper.QUICK_STOP, Stopper.QUICK_STOP),
        wait=BRING_UP,
    ),
)
"""What a rig is refused with when it is switched on, beside the first rows."""

SETTINGS = (
    FaultCase(
        "The safety nets are relaxed",
        nothing,
        akd.RELAXED,
        before=True,
        host=AkdConfig(silence=0.5),
        gate=PlausibilityLimits(stale=0.5),
    ),
    FaultCase(
        "Silence 0.6 s, patience 2 s: the motor encoder jumps, and no stop is obeyed",
        watch_alone,
        akd.ENCODER_JUMP,
        stopped_by=WATCHES,
        withheld=True,
        host=AkdConfig(silence=0.6, watch=MonitorConfig(stop=2.0)),
    ),
    FaultCase(
        "Stale only after 1 s: the screen says nothing any more",
        _dead(math.inf),
        lumio.BALL_LOST,
        of_screen=True,
        gate=PlausibilityLimits(stale=1.0),
    ),
    FaultCase(
        "Supervisor alone: the screen says nothing any more, and waits for 1 s itself",
        _dead(math.inf),
        supervisor.BALL_LOST,
        of_screen=True,
        wait=PlausibilityLimits().stale,
        gate=PlausibilityLimits(lost=1.0),
    ),
    FaultCase(
        "Zero rate alone: the motor encoder jumps, and no quick stop reaches the drives",
        _jump_in_turn,
        akd.ENCODER_JUMP,
        begins=_turns,
        stopped_by=WATCHES,
        withheld=True,
        zeroed=True,
    ),
)
"""Rows with settings other than those by default, and with one line of defence alone."""
