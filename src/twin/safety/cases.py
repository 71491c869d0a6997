"""The fault matrix's rows: what is done to a rig that tracks a circle, and what must come of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from twin.devices.akd import conditions as akd
from twin.devices.lumio import conditions as lumio
from twin.devices.realtime import LOOP_OVERRUN
from twin.emulator.can_faults import Towards
from twin.emulator.drive import EmulatedDrive
from twin.emulator.drive_settings import DriveSettings
from twin.emulator.lockstep import LockstepRig
from twin.emulator.screen_bytes import Protocol
from twin.emulator.screen_faults import ScreenFault
from twin.hal import supervisor
from twin.hal.faults import Condition
from twin.safety import drive_causes

Act = Callable[[LockstepRig], None]


@dataclass(frozen=True, kw_only=True)
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
    """

    name: str
    act: Act
    expected: Condition | None
    before: bool = False
    protocol: Protocol = Protocol.MICROTOUCH
    resting: bool = False
    stubborn: bool = False
    of_screen: bool = False


def _before(name: str, act: Act, expected: Condition) -> FaultCase:
    return FaultCase(name=name, act=act, expected=expected, before=True)


def _drive(cause: Callable[..., None], condition: Condition) -> FaultCase:
    name = (cause.__doc__ or cause.__name__).rstrip(".")
    return FaultCase(name=name, act=lambda rig: cause(rig.lockstep), expected=condition)


def _screen(
    name: str,
    fault: ScreenFault,
    expected: Condition | None,
    *,
    lasting: float = 0.06,
    protocol: Protocol = Protocol.MICROTOUCH,
) -> FaultCase:
    return FaultCase(
        name=name,
        act=lambda rig: rig.inject(fault, lasting),
        expected=expected,
        protocol=protocol,
        of_screen=True,
    )


def _wrong_bit_rate(rig: LockstepRig) -> None:
    rig.lockstep.bus.faults.drop()
    rig.lockstep.bus.faults.make_passive()


def _absent(rig: LockstepRig) -> None:
    rig.lockstep.bus.drives.pop()


def _foreign(rig: LockstepRig) -> None:
    rig.lockstep.drives[0].store.set(0x1018, 1, 0x123)


def _twin(rig: LockstepRig) -> None:
    rig.lockstep.bus.drives.append(EmulatedDrive(DriveSettings(node=1, serial=7)))


def _no_ball(rig: LockstepRig) -> None:
    rig.plant.present = False


def _no_screen(rig: LockstepRig) -> None:
    rig.port.plugged = False


def _sto_before(rig: LockstepRig) -> None:
    rig.lockstep.drives[0].open_sto()


def _nothing(_: LockstepRig) -> None:
    """Leave the rig alone."""


def _lasting_fault(rig: LockstepRig) -> None:
    rig.lockstep.drives[0].fail(235, lasting=True)
    rig.lockstep.drives[0].power.refuse_reset = True


def _stall(rig: LockstepRig) -> None:
    rig.stall = rig.period


def _silence(rig: LockstepRig) -> None:
    rig.lockstep.bus.faults.drop(towards=Towards.DRIVES)


def _wrap(rig: LockstepRig) -> None:
    for drive in rig.lockstep.drives:
        drive.motor.jump(2**31 - 2000)


AT_START = (
    FaultCase(
        name="The bit rate is wrong", act=_wrong_bit_rate, expected=akd.BIT_RATE, before=True
    ),
    FaultCase(name="Drive theta is absent", act=_absent, expected=akd.NODE_ABSENT, before=True),
    FaultCase(name="Node 1 is no AKD", act=_foreign, expected=akd.WRONG_IDENTITY, before=True),
    FaultCase(name="Two drives have node 1", act=_twin, expected=akd.DUPLICATE_ID, before=True),
    FaultCase(name="STO is open", act=_sto_before, expected=akd.STO_OPEN, before=True),
    FaultCase(
        name="The touch screen is absent", act=_no_screen, expected=lumio.UNPLUGGED, before=True
    ),
    FaultCase(name="There is no ball", act=_no_ball, expected=supervisor.BALL_LOST, before=True),
)

LATER = {
    (drive_causes.node_silent, akd.HEARTBEAT_LOST),
    (drive_causes.drive_fault, akd.FAULT_NUMBER),
    (drive_causes.remote, akd.STOP_IGNORED),
    (drive_causes.second_node, akd.DUPLICATE_ID),
}
"""Cases left out: another condition ends the run before theirs can be reported."""

DRIVES = (
    *(_drive(*each) for each in drive_causes.CASES if each not in LATER),
    _drive(drive_causes.second_node, akd.DRIVE_REBOOTED),
    FaultCase(
        name="Drive phi refuses the reset of its fault",
        act=_lasting_fault,
        expected=akd.DRIVE_FAULT,
        stubborn=True,
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
    FaultCase(name="The ball rests", act=_nothing, expected=None, resting=True),
    FaultCase(
        name="The touch screen is unplugged",
        act=_no_screen,
        expected=lumio.UNPLUGGED,
    ),
)

LOOP = (
    FaultCase(name="The host falls silent", act=_silence, expected=akd.PDO_STALE),
    FaultCase(name="Every period takes too long", act=_stall, expected=LOOP_OVERRUN),
    FaultCase(name="The motor positions wrap", act=_wrap, expected=None, before=True),
)

CASES = (*AT_START, *DRIVES, *SCREEN, *LOOP)
"""Every row of the matrix."""
