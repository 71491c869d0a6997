"""The fault matrix's rows: what is done to a rig that tracks a circle, and what must come of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from twin.devices.akd import conditions as akd
from twin.devices.lumio import conditions as lumio
from twin.devices.realtime import LOOP_OVERRUN
from twin.devices.rig import HardwareRig
from twin.emulator.can_faults import Towards
from twin.emulator.drive import DriveSettings, EmulatedDrive, Power
from twin.emulator.lockstep import PATIENCE, LockstepRig
from twin.emulator.screen import ScreenFault
from twin.emulator.screen_bytes import Protocol
from twin.hal import supervisor
from twin.hal.interface import Condition
from twin.safety import drive_causes
from twin.safety.case import BRING_UP, FaultCase, Stopper
from twin.safety.rig_cases import DEFENCES, PROGRAM, SETTINGS, SUPERVISED, UNFIT, WATCHES, nothing


def _drive(cause: Callable[..., None], condition: Condition) -> FaultCase:
    first: dict[str, Any] = {"first": FIRST[cause]} if condition in AFTERWARDS else {}
    name = (cause.__doc__ or cause.__name__).rstrip(".")
    return FaultCase(
        f"{name}: afterwards" if first else name,
        lambda rig: cause(rig.lockstep),
        condition,
        **ANSWERS.get(cause, {}),
        **first,
    )


def _screen(
    name: str,
    fault: ScreenFault,
    expected: Condition | None,
    *,
    lasting: float = 0.06,
    protocol: Protocol = Protocol.MICROTOUCH,
) -> FaultCase:
    return FaultCase(
        name, lambda rig: rig.inject(fault, lasting), expected, protocol=protocol, of_screen=True
    )


def _wrong_bit_rate(rig: LockstepRig) -> None:
    rig.lockstep.bus.faults.drop()
    rig.lockstep.bus.faults.make_passive()


def _absent(rig: LockstepRig) -> None:
    rig.lockstep.bus.drives.pop()


def _foreign(rig: LockstepRig) -> None:
    rig.lockstep.drives[0].store.set(0x1018, 1, 0x123)


def _twin(rig: LockstepRig) -> None:
    rig.lockstep.bus.drives.append(EmulatedDrive(DriveSettings(node=1)))


def _no_ball(rig: LockstepRig) -> None:
    rig.plant.present = False


def _no_screen(rig: LockstepRig) -> None:
    rig.port.plugged = False


def _sto_before(rig: LockstepRig) -> None:
    rig.lockstep.drives[0].open_sto()


def _lasting_fault(rig: LockstepRig) -> None:
    rig.lockstep.drives[0].fail(235, lasting=True)
    rig.lockstep.drives[0].power.refuse_reset = True


def _stall(rig: LockstepRig) -> None:
    rig.stall = 3 * rig.period


def _half(rig: LockstepRig) -> None:
    rig.stall = rig.period


def _uneven(rig: LockstepRig) -> None:
    """Drives answer in half a period; every other command is computed for three quarters of one."""
    rig.lockstep.bus.faults.delay([0x181, 0x182, 0x281, 0x282], by=rig.period / 2)
    rig.uneven = 0.75 * rig.period


def _uneven_missing(rig: LockstepRig) -> None:
    _uneven(rig)
    drive_causes.pdo_unsteady(rig.lockstep)


def _silence(rig: LockstepRig) -> None:
    rig.lockstep.bus.faults.drop(towards=Towards.DRIVES)


def _wrap(rig: LockstepRig) -> None:
    for drive in rig.lockstep.drives:
        drive.motor.jump(2**31 - 2000)


AT_START = (
    FaultCase("The bit rate is wrong", _wrong_bit_rate, akd.BIT_RATE, before=True),
    FaultCase("Drive theta is absent", _absent, akd.NODE_ABSENT, before=True),
    FaultCase("Node 1 is no AKD", _foreign, akd.WRONG_IDENTITY, before=True),
    FaultCase("Two drives have node 1", _twin, akd.DUPLICATE_ID, before=True),
    FaultCase(
        "STO is open",
        _sto_before,
        akd.DRIVE_FAULT,
        before=True,
        says="F602",
        states=(Power.FAULT, Power.SWITCH_ON_DISABLED),
        wait=BRING_UP + HardwareRig.POWER_ON,
    ),
    FaultCase("The touch screen is absent", _no_screen, lumio.UNPLUGGED, before=True),
    FaultCase(
        "There is no ball",
        _no_ball,
        supervisor.BALL_LOST,
        before=True,
        stopped_by=(Stopper.QUICK_STOP, Stopper.QUICK_STOP),
        wait=BRING_UP + HardwareRig.POWER_ON + PATIENCE,
    ),
)

LATER = {
    (drive_causes.node_silent, akd.HEARTBEAT_LOST),
    (drive_causes.second_node, akd.DUPLICATE_ID),
}
"""Cases left out: another condition ends the run before theirs can be reported."""

BUS_GONE: dict[str, Any] = {"stopped_by": WATCHES}
DEAF: dict[str, Any] = {"stopped_by": (Stopper.HEARTBEAT, Stopper.QUICK_STOP), "withheld": True}
NO_TORQUE: dict[str, Any] = {"stopped_by": (Stopper.LOST_TORQUE, Stopper.QUICK_STOP)}
ITSELF: dict[str, Any] = {"stopped_by": (Stopper.DRIVE, Stopper.QUICK_STOP)}
ANSWERS: dict[Callable[..., None], dict[str, Any]] = {
    drive_causes.bus_off: BUS_GONE,
    drive_causes.adapter_gone: BUS_GONE,
    drive_causes.left_operational: DEAF,
    drive_causes.remote: DEAF,
    drive_causes.rebooted: NO_TORQUE,
    drive_causes.disabled: NO_TORQUE,
    drive_causes.drive_fault: ITSELF,
    drive_causes.quick_stopped: {**ITSELF, "states": (Power.SWITCH_ON_DISABLED,) * 2},
    drive_causes.no_dc_link: {
        **NO_TORQUE,
        "first": akd.DRIVE_FAULT,
        "states": (Power.FAULT, Power.SWITCH_ON_DISABLED),
    },
    drive_causes.sto: {
        "stopped_by": (Stopper.STO, Stopper.QUICK_STOP),
        "first": akd.DRIVE_FAULT,
    },
    drive_causes.stalled: {"speed": 1.5},
}
"""What comes of a cause where the severity of its condition does not say it all."""

AFTERWARDS = (akd.FAULT_NUMBER, akd.STOP_IGNORED)
"""Conditions that are noted after another has ended the run."""
FIRST = {drive_causes.drive_fault: akd.DRIVE_FAULT, drive_causes.remote: akd.REMOTE_LOST}
"""Which that is."""

DRIVES = (
    *(_drive(*each) for each in drive_causes.CASES if each not in LATER),
    _drive(drive_causes.second_node, akd.DRIVE_REBOOTED),
    FaultCase(
        "Drive phi refuses the reset of its fault",
        _lasting_fault,
        akd.DRIVE_FAULT,
        stubborn=True,
        **ITSELF,
    ),
)

SCREEN = (
    _screen("Touch bytes are truncated", ScreenFault.TRUNCATE, lumio.BAD_BYTES),
    _screen("Touch packets come in two parts", ScreenFault.SPLIT, None),
    _screen("Touch packets come two at once", ScreenFault.MERGE, None),
    _screen("Touch bytes are garbled", ScreenFault.GARBLE, lumio.BAD_BYTES),
    _screen("There is noise between touch packets", ScreenFault.NOISE, lumio.BAD_BYTES),
    _screen(
        "Touch checksums are wrong", ScreenFault.CHECKSUM, lumio.CHECKSUM, protocol=Protocol.ELO
    ),
    _screen("Bytes flood the touch port", ScreenFault.FLOOD, lumio.FLOOD, lasting=0.6),
    _screen("The ball is lifted (pen-up)", ScreenFault.PEN_UP, lumio.BALL_LOST, lasting=math.inf),
    _screen(
        "The ball is lifted without a pen-up",
        ScreenFault.MISSING_PEN_UP,
        lumio.BALL_LOST,
        lasting=math.inf,
    ),
    _screen("A brief dropout of the touch", ScreenFault.DROPOUT, lumio.DROPOUT, lasting=0.07),
    _screen(
        "A second contact on the screen",
        ScreenFault.TWO_CONTACTS,
        lumio.TWO_CONTACTS,
        protocol=Protocol.HID_0006,
    ),
    _screen(
        "Touch values out of range",
        ScreenFault.OUT_OF_RANGE,
        lumio.OUT_OF_RANGE,
        protocol=Protocol.ELO,
        lasting=0.05,
    ),
    _screen("The touch axes are swapped", ScreenFault.SWAP_AXES, lumio.SWAPPED_AXES, lasting=1.0),
    _screen("The touch is frozen", ScreenFault.FREEZE, lumio.FROZEN, lasting=math.inf),
    _screen("One touch frame jumps", ScreenFault.JUMP, lumio.JUMP),
    FaultCase("The ball rests", nothing, None, resting=True),
    FaultCase("The touch screen is unplugged", _no_screen, lumio.UNPLUGGED),
)

LOOP = (
    FaultCase("The host falls silent", _silence, akd.PDO_STALE, **BUS_GONE),
    FaultCase("Of four periods three are missed", _stall, LOOP_OVERRUN, slow=4.0),
    FaultCase("Every other period is missed", _half, None),
    FaultCase("Every other command comes late, the drives' answers in time", _uneven, None),
    FaultCase(
        "Every other command comes late, and half of the PDOs of drive phi are missing",
        _uneven_missing,
        akd.PDO_UNSTEADY,
    ),
    FaultCase("The motor positions wrap", _wrap, None, before=True),
)

CASES = (*AT_START, *UNFIT, *DRIVES, *SCREEN, *SUPERVISED, *LOOP, *PROGRAM, *DEFENCES, *SETTINGS)
"""Every row of the matrix."""
