"""Rows in which one line of defence has to do alone, with those before it taken away."""

from __future__ import annotations

import struct

from twin.devices.akd import conditions as akd
from twin.devices.lumio import conditions as lumio
from twin.devices.realtime import LOOP_OVERRUN
from twin.emulator.can_faults import Towards
from twin.emulator.lockstep import LockstepRig
from twin.safety import drive_causes
from twin.safety.case import FaultCase
from twin.safety.reaction import Stopper

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
        name="Levelling alone: the screen is unplugged, and no quick stop reaches the drives",
        act=_level_alone,
        expected=lumio.UNPLUGGED,
    ),
    FaultCase(
        name="Quick stop alone: the motor encoder jumps, and no zero rate reaches the drives",
        act=_quick_stop_alone,
        expected=akd.ENCODER_JUMP,
    ),
    FaultCase(
        name="Heartbeat watch alone: the motor encoder jumps, and neither reaches the drives",
        act=watch_alone,
        expected=akd.ENCODER_JUMP,
        stopped_by=(Stopper.HEARTBEAT, Stopper.HEARTBEAT),
        withheld=True,
    ),
    FaultCase(
        name="Heartbeat watch alone: the host hangs",
        act=_hang,
        expected=LOOP_OVERRUN,
        stopped_by=(Stopper.HEARTBEAT, Stopper.HEARTBEAT),
        hangs=True,
    ),
    FaultCase(
        name="STO alone: the host hangs, the drives watch nobody, and STO is opened",
        act=_sto_alone,
        expected=LOOP_OVERRUN,
        stopped_by=(Stopper.STO, Stopper.STO),
        hangs=True,
    ),
)
"""The last rows of the matrix."""
