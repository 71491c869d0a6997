"""Tests of `twin.devices.akd.bringup`."""

import numpy as np
import pytest
from stepped import SteppedDrives, refused

from twin.base.errors import RigError
from twin.devices.akd import conditions as c
from twin.devices.akd.config import AkdConfig, AxisConfig
from twin.devices.akd.remote import Network, absent
from twin.emulator.drive import EmulatedDrive
from twin.emulator.lockstep import LockstepRig
from twin.emulator.power_stage import Power


@pytest.fixture
def rig():
    with SteppedDrives() as rig:
        yield rig


WRITTEN = {
    (0x6060, 0): 3,
    (0x605A, 0): 2,
    (0x1017, 0): 20,
    (0x1016, 1): 127 << 16 | 60,
    (0x60C2, 1): 2,
    (0x60C2, 2): -3,
    (0x1005, 0): 0x80,
    (0x356E, 0): 3000,  # 4.5 N m at 1.523 N m/A are 2.95 A: 3 A
    (0x356F, 0): -3000,
    (0x3622, 0): 77_000,  # 8 rad/s are 76.4 rpm: 77 rpm
    (0x3623, 0): -77_000,
    (0x207F, 0): 77_000,
    (0x6083, 0): 20_000_000,  # 2000 rad/s^2 are 19 099 rpm/s: 20 000 rpm/s
    (0x6084, 0): 20_000_000,
    (0x1400, 1): 0x201,
    (0x1400, 2): 1,
    (0x1600, 0): 2,
    (0x1600, 1): 0x60400010,
    (0x1600, 2): 0x60FF0020,
    (0x1800, 1): 0x181,
    (0x1800, 2): 1,
    (0x1800, 3): 0,
    (0x1A00, 0): 3,
    (0x1A00, 1): 0x60410010,
    (0x1A00, 2): 0x60610008,
    (0x1A00, 3): 0x60640020,
    (0x1801, 1): 0x281,
    (0x1A01, 1): 0x606C0020,
    (0x1A01, 2): 0x20500020,
    (0x1401, 1): 0x80000301,
    (0x1403, 1): 0x80000501,
    (0x1802, 1): 0x80000381,
    (0x1803, 1): 0x80000481,
}


def test_after_the_start_the_drive_holds_what_was_meant(rig):
    rig.servos.start()
    store = rig.drives[0].store
    assert {key: store.get(*key) for key in WRITTEN} == WRITTEN


@pytest.fixture
def kept(rig, monkeypatch):
    """Makes the first drive keep another value of an object than was written."""

    def keep(key, value):
        store, write = rig.drives[0].store, rig.drives[0].store.write

        def forgetful(index, sub, data, **more):
            write(index, sub, data, **more)
            if (index, sub) == key and store.get(*key) == WRITTEN[key]:
                store.set(*key, value)

        monkeypatch.setattr(store, "write", forgetful)

    return keep


SWITCHED_OFF = [key for key in WRITTEN if key[1] == 1 and key[0] >> 8 in (0x14, 0x18)]
ROUNDED = [
    key
    for key in WRITTEN
    if abs(WRITTEN[key]) > 2000 and key[0] >> 8 not in (0x10, 0x14, 0x16, 0x18, 0x1A)
]
OTHERWISE = [
    # hardly more than the tenth of a percent off that a drive may round, else one
    *((key, its + (abs(its) // 900 if key in ROUNDED else 0) + 1) for key, its in WRITTEN.items()),
    ((0x3623, 0), -WRITTEN[0x3623, 0]),
    # bit 31 of a COB-ID says that the message is off: a drive that keeps the rest is not set
    *((key, WRITTEN[key] ^ 1 << 31) for key in SWITCHED_OFF),
]
AS_GOOD = [
    *((key, WRITTEN[key] + abs(WRITTEN[key]) // 2000) for key in ROUNDED),  # as a float can
    # a drive may show bit 30 of an identifier by itself
    *((key, WRITTEN[key] | 1 << 30) for key in [(0x1005, 0), *SWITCHED_OFF]),
]


def objects(each):
    return f"{each[0]:04X}h.{each[1]}" if isinstance(each, tuple) else f"{each:X}h"


@pytest.mark.parametrize(("key", "value"), OTHERWISE, ids=objects)
def test_a_drive_that_keeps_something_else_is_refused_by_object(rig, key, value, kept):
    kept(key, value)
    text = refused(rig, c.WRONG_SETTING)
    assert f"{key[0]:04X}h:{key[1]}" in text
    assert f"keeps {value}, not {WRITTEN[key]}" in text


@pytest.mark.parametrize(("key", "value"), AS_GOOD, ids=objects)
def test_a_drive_that_keeps_what_means_the_same_is_taken(rig, key, value, kept):
    kept(key, value)
    rig.servos.start()
    assert rig.drives[0].store.get(*key) == value


def test_after_the_start_both_drives_are_operational_without_torque(rig):
    rig.servos.start()
    assert [drive.nmt for drive in rig.drives] == [5, 5]
    assert [drive.state for drive in rig.drives] == [Power.SWITCH_ON_DISABLED] * 2
    rig.run(0.5)
    assert not rig.seen
    assert not rig.servos.enabled


def test_enabling_takes_one_state_a_cycle(rig):
    rig.servos.start()
    rig.run(0.01)
    rig.servos.enable()
    states = [rig.drives[0].state]
    while states[-1] is not Power.OPERATION_ENABLED:
        rig.run(0.002)
        states.append(rig.drives[0].state)
        assert len(states) < 12
    assert list(dict.fromkeys(states)) == [
        Power.SWITCH_ON_DISABLED,
        Power.READY,
        Power.SWITCHED_ON,
        Power.OPERATION_ENABLED,
    ]
    rig.run(0.01)
    assert rig.servos.enabled


def test_the_command_turns_the_motor_and_its_angle_comes_back(rig):
    rig.enabled()
    begin = rig.servos.motor()
    rig.run(0.5, lambda _: (1.0, -0.5))
    moved = rig.servos.motor() - begin
    np.testing.assert_allclose(moved, [[0.5, -0.25]], atol=0.01)
    np.testing.assert_allclose(rig.servos.plate(), 0.2 * moved, atol=5e-4)
    np.testing.assert_allclose([axis.rate for axis in rig.servos.axes], [1.0, -0.5], atol=2e-4)


def test_signs_and_gear_of_the_configuration_hold_for_command_and_measurement():
    axes = (
        AxisConfig(name="phi", node=1, motor_sign=-1, gear=2.0),
        AxisConfig(name="theta", node=2, plate_sign=-1),
    )
    with SteppedDrives(AkdConfig(axes=axes)) as rig:
        rig.enabled()
        rig.run(0.3, lambda _: (1.0, 1.0))
        assert rig.drives[0].rate == pytest.approx(-2.0, rel=1e-3)
        np.testing.assert_allclose(rig.servos.motor(), [[0.3, 0.3]], atol=0.01)
        assert rig.servos.plate()[0, 1] < 0


def test_home_declares_where_both_encoders_are(rig):
    rig.enabled()
    rig.run(0.1, lambda _: (1.0, 1.0))
    rig.run(0.02)
    rig.servos.home(np.array([[0.01, -0.02]]), np.array([[0.1, -0.1]]))
    np.testing.assert_allclose(rig.servos.plate(), [[0.01, -0.02]], atol=1e-12)
    np.testing.assert_allclose(rig.servos.motor(), [[0.1, -0.1]], atol=1e-12)


def test_the_age_counts_from_the_sync_that_sampled(rig):
    rig.enabled()
    rig.servos.receive()
    np.testing.assert_allclose(rig.servos.age(), 0.002, atol=1e-9)


def test_a_drive_that_is_not_there_is_named_with_those_that_are(rig):
    del rig.drives[1], rig.bus.drives[1]
    text = refused(rig, c.NODE_ABSENT)
    assert "drive theta (node 2)" in text
    assert "nodes 1" in text


def test_an_answer_counts_though_the_computer_was_away_while_it_came(rig):
    def away_in_between():
        rig.adapter.sleep(0.6)
        return rig.adapter.now()

    network = Network(rig.adapter, 0.5, away_in_between)
    network.request(1, 0x1000, 0, bytes.fromhex("4000100000000000"))
    assert network.answers == {1: 1}


def test_two_drives_with_one_id_are_noticed(rig):
    rig.bus.drives.append(EmulatedDrive(2))
    assert "2 devices" in refused(rig, c.DUPLICATE_ID)


def test_a_setting_that_is_refused_names_object_and_reason(rig):
    rig.drives[0].sdo_aborts[0x6083, 0] = 0x06090031
    text = refused(rig, c.SDO_ABORT)
    assert "6083h" in text
    assert "too high" in text


def test_a_drive_that_stops_answering_in_between_is_noticed(rig):
    rig.bus.faults.drop(0x581, after=0.2)
    assert refused(rig, c.SDO_TIMEOUT).endswith("no answer")


@pytest.mark.parametrize("silent", [0, 1])
def test_a_drive_that_falls_silent_keeps_no_torque_in_the_other_for_long(rig, silent):
    there = rig.drives[1 - silent]
    left_with_torque(there, Power.OPERATION_ENABLED, 6)
    off = []

    def watch(_):
        if not there.power.live and not off:
            off.append(rig.bus.time)

    def vendor():  # the last thing it tells
        rig.drives[silent].sdo_silent = True
        return 0x6A

    rig.bus.moved = watch
    begin = rig.bus.time
    rig.drives[silent].store.live(0x1018, 1, vendor)
    refused(rig, c.SDO_TIMEOUT)
    assert off[0] - begin < 0.75
    assert rig.bus.time - begin < 1.0


def test_a_drive_without_heartbeat_does_not_become_operational(rig):
    rig.bus.faults.drop(0x701)
    assert "no heartbeat" in refused(rig, c.NMT_LEFT)


def left_with_torque(drive, state, option):
    drive.store.set(0x6060, 0, 3)
    drive.store.set(0x605A, 0, option)
    drive.power.option = option
    drive.power.state = state
    drive.motor.rate = 3.0


@pytest.mark.parametrize("option", [2, 6])
@pytest.mark.parametrize("state", [Power.OPERATION_ENABLED, Power.QUICK_STOP])
def test_a_drive_found_with_torque_loses_it_whatever_its_quick_stop_option(rig, state, option):
    left_with_torque(rig.drives[0], state, option)
    rig.servos.start()
    assert rig.drives[0].rate == 0
    assert rig.drives[0].state is Power.SWITCH_ON_DISABLED
    assert rig.drives[0].store.get(0x605A) == 2
    rig.servos.enable()
    rig.run(0.1)
    assert rig.servos.enabled


@pytest.mark.parametrize("absent", [0, 1])
def test_a_drive_found_with_torque_loses_it_though_the_other_is_absent(rig, absent):
    del rig.bus.drives[absent]
    there = rig.drives[1 - absent]
    left_with_torque(there, Power.OPERATION_ENABLED, 6)
    refused(rig, c.NODE_ABSENT)
    assert there.rate == 0
    assert there.state is Power.SWITCH_ON_DISABLED


def test_a_drive_that_keeps_its_torque_is_refused_with_what_to_do(rig):
    left_with_torque(rig.drives[0], Power.OPERATION_ENABLED, 2)
    rig.drives[0].remote = False  # another tool controls it: it obeys no control word
    assert "keeps its torque" in refused(rig, c.WRONG_SETTING)


def test_a_fault_from_before_is_named_with_its_number_and_the_way_to_reset_it(rig):
    drive = rig.drives[0]
    drive.fail(129)
    drive.fail(235)
    rig.servos.start()
    (fault,) = (each for each in rig.run(0.02) if each.condition == c.DRIVE_FAULT)
    assert "F129 CAN monitoring: the master went silent, F235" in fault.detail
    assert "--reset" in fault.condition.recovery
    rig.servos.start(reset=True)
    rig.run(0.1)
    drive.fail(501)  # a new one is not called by the old one's number
    (fault,) = (each for each in rig.run(0.02) if each.condition == c.DRIVE_FAULT)
    assert "F129" not in fault.detail


def test_a_rig_that_is_switched_on_with_a_fault_says_which_in_one_line(scenario):
    rig = LockstepRig(scenario("plant.kind=lagrange"))
    rig.lockstep.drives[0].fail(129)
    with pytest.raises(RigError) as caught, rig:
        pass
    assert "F129" in str(caught.value)
    assert "--reset" in str(caught.value)
    assert "\n" not in str(caught.value)
    rig.reset = True
    with rig:
        assert rig.servos.enabled


def test_a_motor_still_running_out_is_waited_for(rig):
    rig.drives[0].motor.rate = 3.0
    rig.servos.start()
    assert abs(rig.drives[0].rate) < 0.01


def test_a_silent_drive_is_told_with_the_nodes_that_were_heard_not_with_those_spoken_to():
    network = Network(None, 1.0, lambda: 0.0)
    network.identifiers |= {0x080, 0x602, 0x701, 0x703}
    assert "(heard nodes 3)" in absent(network, AxisConfig(name="phi", node=1))
