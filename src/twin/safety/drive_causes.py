"""What can go wrong with drives and bus, each as a function that makes it go wrong."""

from __future__ import annotations

from twin.emulator.can_faults import Towards
from twin.emulator.drive import DriveSettings, EmulatedDrive, Power
from twin.emulator.lockstep import LockstepDrives

TPDO1, TPDO2 = 0x181, 0x281


def bus_off(rig: LockstepDrives) -> None:
    """The controller leaves the bus."""
    rig.bus.faults.take_off_bus()


def error_passive(rig: LockstepDrives) -> None:
    """The adapter becomes error passive."""
    rig.bus.faults.make_passive()


def adapter_gone(rig: LockstepDrives) -> None:
    """The CAN adapter is pulled."""
    rig.adapter.plugged = False


def heartbeat_lost(rig: LockstepDrives) -> None:
    """The heartbeat of drive phi gets lost."""
    rig.bus.faults.drop(0x701, towards=Towards.HOST)


def node_silent(rig: LockstepDrives) -> None:
    """Drive theta falls silent."""
    rig.bus.faults.silence(2)


def rebooted(rig: LockstepDrives) -> None:
    """Drive phi reboots in mid-run."""
    rig.drives[0].reboot()


def left_operational(rig: LockstepDrives) -> None:
    """Drive phi leaves the operational state."""
    rig.drives[0].nmt = 127


def monitoring_off(rig: LockstepDrives) -> None:
    """Drive phi no longer watches the host."""
    rig.drives[0].store.set(0x1016, 1, 0)


def sdo_silent(rig: LockstepDrives) -> None:
    """Drive phi answers no SDO."""
    rig.drives[0].sdo_silent = True


def sdo_abort(rig: LockstepDrives) -> None:
    """Drive phi aborts an SDO."""
    rig.drives[0].sdo_aborts[0x1016, 1] = 0x08000022


def emergency(rig: LockstepDrives) -> None:
    """Drive phi sends an emergency message."""
    rig.drives[0].emergency(0x4310, 0x08, b"\x01")


def emergency_burst(rig: LockstepDrives) -> None:
    """Drive phi sends a burst of emergency messages."""
    for _ in range(12):
        rig.drives[0].emergency(0x4390)


def emergency_short(rig: LockstepDrives) -> None:
    """Drive phi sends a short emergency message."""
    rig.drives[0].short_emergencies = True
    rig.drives[0].emergency(0x4310)


def pdo_missing(rig: LockstepDrives) -> None:
    """One PDO of drive phi is missing."""
    rig.bus.faults.drop(TPDO1, lasting=0.003)


def pdo_stale(rig: LockstepDrives) -> None:
    """The PDOs of drive phi are missing from now on."""
    rig.bus.faults.drop(TPDO1)


def pdo_short(rig: LockstepDrives) -> None:
    """One PDO of drive phi is too short."""
    rig.bus.faults.truncate(TPDO1, to=5, lasting=0.003)


def pdo_late(rig: LockstepDrives) -> None:
    """One PDO of drive phi is late."""
    rig.bus.faults.delay(TPDO1, by=0.003, lasting=0.003)


def pdo_wrong_cycle(rig: LockstepDrives) -> None:
    """One PDO of drive phi comes again in the wrong cycle."""
    rig.bus.faults.duplicate(TPDO1, lasting=0.003)


def pdo_unsteady(rig: LockstepDrives) -> None:
    """Half of the PDOs of drive phi are missing."""
    rig.bus.faults.drop(TPDO1, share=0.5)


def duplicate(rig: LockstepDrives) -> None:
    """The PDOs of both drives come twice."""
    rig.bus.faults.duplicate([TPDO1, TPDO2])


def second_node(rig: LockstepDrives) -> None:
    """A second drive has the node of drive phi."""
    rig.bus.drives.append(EmulatedDrive(DriveSettings(node=1)))


def frozen(rig: LockstepDrives) -> None:
    """The motor position of drive phi is frozen."""
    rig.drives[0].motor.frozen = True


def frozen_plate(rig: LockstepDrives) -> None:
    """The plate encoder of drive phi is frozen."""
    rig.drives[0].motor.frozen_plate = True


def motor_jump(rig: LockstepDrives) -> None:
    """The motor encoder of drive phi jumps."""
    rig.drives[0].motor.jump(20_000)


def plate_jump(rig: LockstepDrives) -> None:
    """The plate encoder of drive phi jumps."""
    rig.drives[0].motor.jump_plate(1500)  # 2.2 deg


def stalled(rig: LockstepDrives) -> None:
    """Drive phi runs the wrong way."""
    rig.drives[0].store.set(0x6083, 0, 0)
    rig.drives[0].store.set(0x6084, 0, 0)
    rig.drives[0].motor.rate = -1.5


def mode(rig: LockstepDrives) -> None:
    """Drive phi is in another mode."""
    rig.drives[0].mode_override = 1


def drive_fault(rig: LockstepDrives) -> None:
    """Drive phi has a fault."""
    rig.drives[0].fail(235)


def disabled(rig: LockstepDrives) -> None:
    """Drive phi loses its torque."""
    rig.drives[0].power.state = Power.SWITCH_ON_DISABLED


def quick_stopped(rig: LockstepDrives) -> None:
    """Drive phi is in quick stop."""
    rig.drives[0].power.option = 6
    rig.drives[0].store.set(0x605A, 0, 6)
    rig.drives[0].power.state = Power.QUICK_STOP
    rig.bus.faults.drop(0x201, lasting=0.01)


def remote(rig: LockstepDrives) -> None:
    """Drive phi loses its remote bit."""
    rig.drives[0].remote = False


def limit(rig: LockstepDrives) -> None:
    """Drive phi has an internal limit active."""
    rig.drives[0].limit_active = True


def no_dc_link(rig: LockstepDrives) -> None:
    """Drive phi has no DC link."""
    rig.drives[0].power.dc_link = False


def sto(rig: LockstepDrives) -> None:
    """The STO input of drive phi opens."""
    rig.drives[0].open_sto()


def warning(rig: LockstepDrives) -> None:
    """Drive phi warns."""
    rig.drives[0].warning = True
