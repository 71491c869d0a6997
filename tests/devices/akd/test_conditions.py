"""Tests of `twin.devices.akd.conditions`."""

import ast
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from stepped import SteppedDrives, still

import twin
from twin.base.data_file import read_packaged
from twin.devices.akd import conditions as c
from twin.devices.akd.conditions import DriveError
from twin.devices.akd.config import AkdConfig, MonitorConfig
from twin.devices.lumio.conditions import SCREEN_CONDITIONS
from twin.emulator.can_bus import Towards
from twin.emulator.drive import EmulatedDrive
from twin.emulator.power_stage import Power
from twin.safety.causes import OF_DRIVES

ROOMS = ("twin.devices.akd", "twin.devices.lumio")
ROWS = [
    (row["act"][0], getattr(c, row["expected"].partition(".")[2]))
    for row in read_packaged("twin.safety", "cases.toml")["drives"]
    if not row.get("stubborn")
]
CASES = sorted({*ROWS, ("node_silent", c.HEARTBEAT_LOST), ("second_node", c.DUPLICATE_ID)})
"""Every cause with a condition that it makes the host report."""


def swing(t):
    return 2.0 * math.cos(8 * t), -1.5 * math.sin(8 * t)


def turn(_):
    return 1.2, -1.2


@pytest.fixture
def rig():
    with SteppedDrives() as rig:
        rig.enabled()
        rig.run(0.04, swing)
        assert rig.servos.enabled
        assert not rig.seen
        yield rig


AT = [
    pytest.param(
        *each,
        period,
        id=f"{each[0]}-{each[1].name}-{1e3 * period:g} ms",
        marks=() if period == 0.002 else pytest.mark.long,
    )
    for period in (0.001, 0.002, 0.004)
    for each in CASES
    if each[0] != "pdo_late" or period < 0.003  # by 3 ms, in time within a longer period
]


@pytest.mark.parametrize(("cause", "condition", "period"), AT)
def test_a_condition_is_detected_within_its_stated_time(cause, condition, period):
    longest = condition.longest(period)
    with SteppedDrives(AkdConfig(period=period)) as rig:
        rig.enabled()
        rig.run(0.04, swing)
        assert rig.servos.enabled
        assert not rig.seen
        begin = rig.bus.time
        OF_DRIVES[cause](rig)
        seen = rig.run(longest + 0.01, turn)
    times = [each.at - begin for each in seen if each.condition == condition]
    assert times, [str(each) for each in seen]
    assert times[0] <= longest + 1e-9


def test_every_condition_that_a_module_names_is_in_the_table():
    # the names of a table are no attributes that a type checker knows
    named = set()
    for path in Path(twin.__file__).parent.rglob("*.py"):
        text, tables = path.read_text(encoding="utf-8"), {}
        if "conditions" not in text:
            continue
        tree = ast.parse(text)
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module in ROOMS:
                known = {each.asname or each.name for each in node.names}
                tables |= dict.fromkeys(known & {"c", "akd", "lumio"}, node.module)
        named |= {
            (f"{tables[node.value.id]}.conditions", node.attr, path.name)
            for node in ast.walk(tree)
            if isinstance(node, ast.Attribute)
            and isinstance(node.value, ast.Name)
            and node.value.id in tables
        }
    assert len(named) > 50
    assert not [each for each in named if not hasattr(sys.modules[each[0]], each[1])]


@pytest.mark.parametrize("every", [c.DRIVE_CONDITIONS, SCREEN_CONDITIONS])
def test_names_of_conditions_are_all_different(every):
    assert len({each.name for each in every}) == len(every)


def test_a_command_that_is_no_number_stops_at_once(rig):
    seen = rig.run(0.004, lambda _: (math.nan, 1.0))
    assert [each.condition for each in seen] == [c.BAD_COMMAND]
    rig.run(0.1)
    assert all(drive.rate == 0 for drive in rig.drives)


@pytest.mark.short("no state")
@pytest.mark.parametrize("status", [0x0237, 0x0267], ids=["enabled", "no state"])
def test_a_drive_that_goes_on_in_spite_of_a_quick_stop_is_left_to_its_own_watch(rig, status):
    rig.run(0.05, turn)
    rig.bus.faults.overwrite(0x201, at=0, data=b"\x0f\x00", towards=Towards.DRIVES)
    word = status.to_bytes(2, "little")
    rig.bus.faults.overwrite(0x181, at=0, data=word, towards=Towards.HOST)
    rig.servos.quick_stop()
    seen = [each.condition for each in rig.run(0.5, turn)]
    assert seen[0] == c.STOP_IGNORED  # and the host's heartbeat ends
    assert c.EMERGENCY_MESSAGE in seen


def test_a_command_beyond_the_rate_limit_is_kept_within_it(rig):
    limit = rig.config.rate_limit
    rig.servos.command(np.array([[5 * limit, -5 * limit]]))
    assert [axis.target for axis in rig.servos.axes] == [limit, -limit]


def test_the_limit_of_a_drive_without_torque_is_none():
    word = (0x0A50).to_bytes(2, "little")  # switch on disabled, internal limit active
    with SteppedDrives() as rig:
        rig.servos.start()
        rig.bus.faults.overwrite(0x181, at=0, data=word, towards=Towards.HOST)
        assert not [each for each in rig.run(0.1) if each.condition == c.INTERNAL_LIMIT]


def test_a_drive_whose_state_is_no_longer_seen_goes_on_watching_the_host():
    with SteppedDrives() as rig:
        rig.servos.start()
        rig.run(0.1)
        assert all(axis.powerless for axis in rig.servos.axes)
        watched = [drive.store.get(0x1016, 1) for drive in rig.drives]
        rig.bus.faults.drop(0x181)
        rig.run(0.1)
        rig.servos.stop()
        rig.bus.step(0.001)
        left = [drive.store.get(0x1016, 1) for drive in rig.drives]
    assert left == [watched[0], 0]
    assert watched[0] != 0


def test_nothing_is_reported_while_the_position_wraps():
    drives = [EmulatedDrive(n, start_counts=2**31 - 5000) for n in (1, 2)]
    with SteppedDrives(drives=drives) as rig:
        rig.enabled()
        begin = rig.servos.motor()
        assert not rig.run(0.5, lambda _: (1.0, 1.0))
        assert drives[0].motor.encoder.counts < 0
        moved = rig.servos.motor() - begin
        np.testing.assert_allclose(moved, drives[0].motor._angle, atol=0.01)


def test_an_isolated_missing_frame_does_not_stop_the_rig_but_its_age_shows(rig):
    rig.bus.faults.drop(0x181, lasting=0.003)
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


def test_stopping_brings_the_motors_to_rest_before_the_torque_goes(rig):
    rig.run(0.1, turn)
    rig.servos.stop()
    for drive in rig.drives:
        assert drive.state is Power.SWITCH_ON_DISABLED
        assert not drive.power.faults
        assert abs(drive.rate) < 0.01
    rig.servos.stop()


@pytest.mark.short(
    "standing-0.06-0.3-remote", "turning-0.5-0.3-pdo_stale", "standing-1.0-2.0-pdo_stale"
)
@pytest.mark.parametrize("cause", ["remote", "pdo_stale"])
@pytest.mark.parametrize(("silence", "stop"), [(0.06, 0.3), (0.5, 0.3), (1.0, 2.0)])
@pytest.mark.parametrize("rates", [still, turn], ids=["standing", "turning"])
def test_a_drive_that_keeps_its_torque_watches_the_host_beyond_the_shutdown(
    cause, silence, stop, rates
):
    config = AkdConfig(silence=silence, watch=MonitorConfig(stop=stop))
    with SteppedDrives(config) as rig:
        rig.enabled()
        rig.run(0.1, rates)
        drive = rig.drives[0]
        OF_DRIVES[cause](rig)
        rig.bus.faults.drop(0x201)  # nor does any control word reach it
        rig.servos.stop()
        for _ in range(round(1000 * (silence + 0.5))):
            rig.bus.step(0.001)
        assert not drive.power.live
        assert abs(drive.rate) < 0.01


@pytest.mark.short("*-0.002")
@pytest.mark.parametrize("period", [0.001, 0.002, 0.004])
@pytest.mark.parametrize(
    ("cause", "condition"), [("frozen", c.MOTOR_FROZEN), ("frozen_plate", c.PLATE_FROZEN)]
)
def test_a_frozen_encoder_is_found_in_time_where_the_motor_turns_as_slowly_as_may_be(
    cause, condition, period
):
    with SteppedDrives(AkdConfig(period=period)) as rig:
        rig.enabled()
        rig.run(0.1, lambda _: (0.1, 0.1))
        begin = rig.bus.time
        OF_DRIVES[cause](rig)
        seen = rig.run(condition.longest(period), lambda _: (0.1, 0.1))
    (found,) = [each for each in seen if each.condition == condition]
    assert found.at - begin <= condition.longest(period)


def test_an_encoder_that_moves_now_and_then_is_not_frozen():
    with SteppedDrives() as rig:
        rig.enabled()
        for _ in range(20):
            rig.drives[0].motor.plate.frozen = True
            rig.run(0.02, lambda _: (0.5, 0.5))  # 0.01 rad of 0.03
            rig.drives[0].motor.plate.frozen = False
            rig.run(0.02, lambda _: (0.5, 0.5))
        assert not [each for each in rig.seen if each.condition == c.PLATE_FROZEN]


def test_angles_are_of_one_instant_or_none():
    with SteppedDrives() as rig:
        rig.enabled()
        rig.run(0.1, turn)
        rig.servos.receive()
        plate, motor = rig.servos.turned()
        assert plate == pytest.approx(rig.servos.plate()[0])
        assert motor == pytest.approx(rig.servos.motor()[0])
        rig.bus.faults.drop(0x281, lasting=0.003)
        rig.run(0.002, turn)
        rig.servos.receive()
        assert rig.servos.turned() is None
