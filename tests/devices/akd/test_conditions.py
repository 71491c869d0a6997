import math
from dataclasses import replace

import numpy as np
import pytest

from twin.devices.akd import conditions as c
from twin.devices.akd.cia402 import DriveState
from twin.devices.akd.conditions import DriveError
from twin.devices.akd.config import RPM, AkdConfig, MonitorConfig
from twin.emulator.drive import DriveSettings, EmulatedDrive, Power
from twin.emulator.lockstep import LockstepDrives, still
from twin.hal.interface import Severity
from twin.safety import drive_causes as cause_of
from twin.safety.drive_causes import CASES, TPDO1


def swing(t):
    return 2.0 * math.cos(8 * t), -1.5 * math.sin(8 * t)


def turn(_):
    return 1.2, -1.2


@pytest.fixture
def rig():
    with LockstepDrives() as rig:
        rig.enabled()
        rig.run(0.1, swing)
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


STOPS = {cause: condition for cause, condition in CASES if condition.severity is Severity.STOP}


@pytest.mark.long
@pytest.mark.parametrize(("cause", "condition"), STOPS.items(), ids=[a.__name__ for a in STOPS])
def test_a_stop_brings_every_motor_to_rest_and_takes_the_torque_away(rig, cause, condition):
    cause(rig)
    rig.run(condition.within + 0.5, turn)
    assert not rig.servos.enabled
    assert all(drive.state is not Power.OPERATION_ENABLED for drive in rig.drives)
    rig.adapter.sleep(1.0)  # without power they run out
    assert all(abs(drive.rate) < 0.01 for drive in rig.drives)


def test_every_condition_has_a_case_here_or_is_about_the_start():
    covered = {condition for _, condition in CASES}
    start = {c.BAD_BUS, c.BIT_RATE, c.NODE_ABSENT, c.WRONG_IDENTITY, c.WRONG_SETTING}
    elsewhere = {c.GARBLED, c.RESET_REFUSED, c.BAD_COMMAND, c.SECOND_MASTER, c.RELAXED}
    assert covered | start | elsewhere == set(c.CONDITIONS)


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


def test_a_single_corrupt_position_is_not_used(rig):
    before = rig.servos.motor()
    rig.bus.faults.overwrite(TPDO1, at=0, data=bytes.fromhex("3702 03 ffffff7f"), lasting=0.002)
    rig.run(0.01)
    np.testing.assert_allclose(rig.servos.motor(), before, atol=0.05)


def test_an_isolated_missing_frame_does_not_stop_the_rig_but_its_age_shows(rig):
    rig.bus.faults.drop(TPDO1, lasting=0.003)
    rig.run(0.002, turn)
    rig.servos.receive()
    age = rig.servos.age()[0]
    assert age[0] > age[1] + 0.0015
    rig.run(0.1, turn)
    assert rig.servos.enabled


def test_the_other_drive_stops_too_when_one_falls_silent(rig):
    rig.bus.faults.silence(2)
    rig.run(0.2, turn)
    assert rig.servos.axes[0].state is not DriveState.OPERATION_ENABLED
    assert rig.drives[0].rate == 0


def test_a_fault_is_not_reset_without_a_request(rig):
    rig.drives[0].fail(235)
    rig.run(1.0)
    assert rig.drives[0].state is Power.FAULT
    with pytest.raises(DriveError, match="reset the faults first"):
        rig.servos.enable()


@pytest.mark.long
@pytest.mark.parametrize(
    "cause",
    [
        cause_of.drive_fault,
        cause_of.pdo_stale,
        cause_of.frozen,
        cause_of.motor_jump,
        cause_of.sto,
        cause_of.no_dc_link,
        cause_of.disabled,
        cause_of.limit,
    ],
)
def test_after_the_cause_is_gone_a_requested_reset_and_enable_go_on(rig, cause):
    cause(rig)
    rig.run(0.6, turn)
    drive = rig.drives[0]
    drive.close_sto()
    drive.power.dc_link = True
    drive.motor.frozen = False
    drive.limit_active = None
    rig.bus.faults.clear()
    rig.servos.reset_faults()
    rig.run(0.1)
    rig.servos.enable()
    seen = rig.run(0.3, swing)
    assert rig.servos.enabled
    assert not seen


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


@pytest.mark.long
@pytest.mark.parametrize(
    "cause",
    [
        cause_of.rebooted,
        cause_of.node_silent,
        cause_of.adapter_gone,
        cause_of.bus_off,
        cause_of.mode,
    ],
)
def test_where_a_reset_cannot_help_a_restart_does(rig, cause):
    cause(rig)
    rig.run(0.5, turn)
    assert rig.servos.needs_restart
    rig.servos.stop()
    rig.bus.faults.clear()
    rig.drives[0].mode_override = None
    rig.adapter.plugged = True
    for drive in rig.drives:
        drive.clear_causes()
    rig.enabled()
    if not rig.servos.enabled:
        rig.servos.reset_faults()
        rig.run(0.1)
        rig.servos.enable()
        rig.run(0.1)
    assert rig.servos.enabled
    assert not rig.servos.needs_restart


def test_a_drive_that_watches_nobody_would_go_on_turning(rig):
    rig.run(0.1, turn)
    rig.drives[0].store.set(0x1016, 1, 0)
    rig.adapter.sleep(1.0)
    assert rig.drives[0].rate == pytest.approx(1.2, rel=1e-3)


def test_the_drives_stop_by_themselves_when_the_host_dies(rig):
    rig.run(0.1, turn)
    assert abs(rig.drives[0].rate) > 0.9
    died = rig.bus.time
    while any(abs(drive.rate) > 0 for drive in rig.drives):
        rig.adapter.sleep(0.001)
        assert rig.bus.time - died < 0.1
    assert [drive.fault_numbers for drive in rig.drives] == [(129,), (129,)]


def test_withholding_the_heartbeat_alone_stops_the_drives(rig):
    rig.servos.heartbeat = False
    seen = rig.run(0.2, still)
    assert c.DRIVE_FAULT in [each.condition for each in seen]


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


def test_a_lower_limit_in_the_drive_holds_whatever_is_sent():
    config = AkdConfig(rate_limit=2.0)
    with LockstepDrives(config) as rig:
        rig.enabled()
        rig.servos.config = replace(config, rate_limit=8.0)
        rig.run(0.05, lambda _: (3.0, 0.0))
        assert rig.drives[0].rate == pytest.approx(20 * RPM, rel=1e-4)  # 19.1 rpm, rounded up
