import math

import numpy as np
import pytest

from twin.devices.akd import conditions as c
from twin.devices.akd.conditions import DriveError
from twin.devices.akd.config import AkdConfig, MonitorConfig
from twin.emulator.drive import DriveSettings, EmulatedDrive, Power
from twin.emulator.lockstep import LockstepDrives, still
from twin.safety import drive_causes as cause_of
from twin.safety.drive_causes import TPDO1

CASES = (
    (cause_of.bus_off, c.BUS_OFF),
    (cause_of.error_passive, c.ERROR_PASSIVE),
    (cause_of.adapter_gone, c.ADAPTER_GONE),
    (cause_of.heartbeat_lost, c.HEARTBEAT_LOST),
    (cause_of.node_silent, c.HEARTBEAT_LOST),
    (cause_of.node_silent, c.PDO_STALE),
    (cause_of.rebooted, c.DRIVE_REBOOTED),
    (cause_of.left_operational, c.NMT_LEFT),
    (cause_of.monitoring_off, c.MONITORING_OFF),
    (cause_of.sdo_silent, c.SDO_TIMEOUT),
    (cause_of.sdo_abort, c.SDO_ABORT),
    (cause_of.emergency, c.EMERGENCY),
    (cause_of.emergency_burst, c.EMERGENCY_BURST),
    (cause_of.emergency_short, c.EMERGENCY_SHORT),
    (cause_of.pdo_missing, c.PDO_MISSING),
    (cause_of.pdo_stale, c.PDO_STALE),
    (cause_of.pdo_short, c.PDO_SHORT),
    (cause_of.pdo_late, c.PDO_LATE),
    (cause_of.pdo_wrong_cycle, c.PDO_WRONG_CYCLE),
    (cause_of.pdo_unsteady, c.PDO_UNSTEADY),
    (cause_of.duplicate, c.DUPLICATE_ID),
    (cause_of.second_node, c.DUPLICATE_ID),
    (cause_of.frozen, c.FROZEN),
    (cause_of.frozen_plate, c.PLATE_FROZEN),
    (cause_of.motor_jump, c.ENCODER_JUMP),
    (cause_of.plate_jump, c.ENCODER_JUMP),
    (cause_of.stalled, c.RUNAWAY),
    (cause_of.mode, c.MODE_CHANGED),
    (cause_of.drive_fault, c.DRIVE_FAULT),
    (cause_of.drive_fault, c.FAULT_NUMBER),
    (cause_of.disabled, c.DRIVE_DISABLED),
    (cause_of.quick_stopped, c.QUICK_STOPPED),
    (cause_of.remote, c.REMOTE_LOST),
    (cause_of.remote, c.STOP_IGNORED),
    (cause_of.limit, c.INTERNAL_LIMIT),
    (cause_of.no_dc_link, c.NO_DC_LINK),
    (cause_of.sto, c.STO_OPEN),
    (cause_of.warning, c.DRIVE_WARNING),
)
"""Every cause with a condition that it makes the host report."""


def swing(t):
    return 2.0 * math.cos(8 * t), -1.5 * math.sin(8 * t)


def turn(_):
    return 1.2, -1.2


@pytest.fixture
def rig():
    with LockstepDrives() as rig:
        rig.enabled()
        rig.run(0.04, swing)
        assert rig.servos.enabled
        assert not rig.seen
        yield rig


@pytest.mark.parametrize(
    ("cause", "condition"), CASES, ids=[f"{a.__name__}-{b.name}" for a, b in CASES]
)
def test_a_condition_is_detected_within_its_stated_time(rig, cause, condition):
    begin = rig.bus.time
    cause(rig)
    seen = rig.run(condition.within + 0.01, turn)
    times = [each.at - begin for each in seen if each.condition == condition]
    assert times, [str(each) for each in seen]
    assert times[0] <= condition.within + 1e-9


def test_names_of_conditions_are_all_different():
    assert len({each.name for each in c.CONDITIONS}) == len(c.CONDITIONS)


def test_a_command_that_is_no_number_stops_at_once(rig):
    seen = rig.run(0.004, lambda _: (math.nan, 1.0))
    assert [each.condition for each in seen] == [c.BAD_COMMAND]
    rig.run(0.1)
    assert all(drive.rate == 0 for drive in rig.drives)


def test_nothing_is_reported_while_the_position_wraps():
    drives = [EmulatedDrive(DriveSettings(node=n, start_counts=2**31 - 5000)) for n in (1, 2)]
    with LockstepDrives(drives=drives) as rig:
        rig.enabled()
        begin = rig.servos.motor()
        assert not rig.run(0.5, lambda _: (1.0, 1.0))
        assert drives[0].motor.position < 0
        moved = rig.servos.motor() - begin
        np.testing.assert_allclose(moved, drives[0].motor._angle, atol=0.01)


def test_an_isolated_missing_frame_does_not_stop_the_rig_but_its_age_shows(rig):
    rig.bus.faults.drop(TPDO1, lasting=0.003)
    rig.run(0.002, turn)
    rig.servos.receive()
    age = rig.servos.age()[0]
    assert age[0] > age[1] + 0.0015
    rig.run(0.1, turn)
    assert rig.servos.enabled


def test_a_fault_is_not_reset_without_a_request(rig):
    rig.drives[0].fail(235)
    rig.run(1.0)
    assert rig.drives[0].state is Power.FAULT
    with pytest.raises(DriveError, match="reset the faults first"):
        rig.servos.enable()


def test_a_reset_before_the_cause_is_gone_is_refused_and_said_so(rig):
    rig.drives[0].open_sto()
    rig.run(0.2)
    begin = rig.bus.time
    rig.servos.reset_faults()
    seen = rig.run(0.3)
    refused = [each for each in seen if each.condition == c.RESET_REFUSED]
    assert refused
    assert refused[0].at - begin <= c.RESET_REFUSED.within
    assert c.STO_OPEN in [each.condition for each in seen]


def test_the_drives_stop_by_themselves_when_the_host_dies(rig):
    rig.run(0.1, turn)
    assert abs(rig.drives[0].rate) > 0.9
    died = rig.bus.time
    while any(abs(drive.rate) > 0 for drive in rig.drives):
        rig.adapter.sleep(0.001)
        assert rig.bus.time - died < 0.1
    assert [drive.fault_numbers for drive in rig.drives] == [(129,), (129,)]


def test_stopping_brings_the_motors_to_rest_before_the_torque_goes(rig):
    rig.run(0.1, turn)
    rig.servos.stop()
    for drive in rig.drives:
        assert drive.state is Power.SWITCH_ON_DISABLED
        assert not drive.fault_numbers
        assert abs(drive.rate) < 0.01
    rig.servos.stop()


@pytest.mark.parametrize("cause", [cause_of.remote, cause_of.pdo_stale], ids=lambda f: f.__name__)
@pytest.mark.parametrize(("silence", "stop"), [(0.06, 0.3), (0.5, 0.3), (1.0, 2.0)])
@pytest.mark.parametrize("rates", [still, turn], ids=["standing", "turning"])
def test_a_drive_that_keeps_its_torque_watches_the_host_beyond_the_shutdown(
    cause, silence, stop, rates
):
    config = AkdConfig(silence=silence, watch=MonitorConfig(stop=stop))
    with LockstepDrives(config) as rig:
        rig.enabled()
        rig.run(0.1, rates)
        drive = rig.drives[0]
        cause(rig)
        rig.bus.faults.drop(0x201)  # nor does any control word reach it
        rig.servos.stop()
        for _ in range(round(1000 * (silence + 0.5))):
            rig.bus.step(0.001)
        assert not drive.power.live
        assert abs(drive.rate) < 0.01
