"""Tests of `twin.emulator.profile_drive`: canopen's own master drives it through all modes."""

import math
import struct

import canopen
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from stepped_canopen import TURN, SteppedNetwork

from twin.emulator.drive_objects import Frame
from twin.emulator.load import InertiaLoad, ShaftLoad
from twin.emulator.power_stage import Power
from twin.emulator.profile_drive import ProfileDrive, register_bits

NODE = 5
REACHED, BIT_12, BIT_13, LIMIT = 1 << 10, 1 << 12, 1 << 13, 1 << 11
ENABLED, SET_POINT, AT_ONCE, RELATIVE, HALT = 0x0F, 0x10, 0x20, 0x40, 0x100
ON, QUICK_STOP = 0x0F, 0x0B


class Master:
    """One drive and its master, which uses SDO only."""

    def __init__(self):
        self.network = SteppedNetwork(NODE)
        self.node, self.drive = self.network[NODE], self.network.drives[0]

    def __getattr__(self, name):
        return getattr(self.node, name)

    def get(self, index, sub=None):
        entry = self.node.sdo[index]
        return (entry if sub is None else entry[sub]).raw

    def set(self, index, value):
        self.node.sdo[index].raw = value

    def control(self, *words):
        for word in words:
            self.set(0x6040, word)

    def run(self, seconds):
        self.network.run(seconds)

    @property
    def status(self):
        return self.get(0x6041)

    def start(self, mode):
        self.node.op_mode = mode
        self.node.state = "OPERATION ENABLED"
        return self

    def move(self, goal, *bits):
        self.set(0x607A, goal)
        self.control(ON | SET_POINT | sum(bits), ON | sum(bits))

    def arrive(self, most=5.0):
        begin = self.network.emulated.time
        while not self.status & REACHED:
            assert self.network.emulated.time - begin < most
            self.run(0.001)
        return self.network.emulated.time - begin


@pytest.fixture
def master():
    return Master()


def test_canopen_takes_it_through_every_state(master):
    node = master.node
    assert node.state == "SWITCH ON DISABLED"
    for state in ("READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED"):
        node.state = state
        assert node.state == state
    node.state = "SWITCH ON DISABLED"
    assert node.state == "SWITCH ON DISABLED"


@pytest.mark.parametrize(
    "mode",
    [
        "PROFILED POSITION",
        "PROFILED VELOCITY",
        "HOMING",
        "CYCLIC SYNCHRONOUS POSITION",
        "CYCLIC SYNCHRONOUS VELOCITY",
    ],
)
def test_canopen_finds_each_mode_supported_and_confirmed(master, mode):
    assert master.node.is_op_mode_supported(mode)
    master.start(mode)
    assert master.node.op_mode == mode


def test_a_mode_that_it_lacks_is_refused(master):
    assert not master.node.is_op_mode_supported("PROFILED TORQUE")
    with pytest.raises(canopen.SdoAbortedError) as caught:
        master.set(0x6060, 4)
    assert caught.value.code == 0x06090030


def test_a_profile_to_a_position_takes_the_time_of_its_trapezoid(master):
    master.start("PROFILED POSITION")
    master.move(10 * TURN)
    # 10 turns at 10 turns/s with ramps of 100 turns/s^2; then 5 ms within the window
    assert master.arrive() == pytest.approx(1.1 + 0.005, abs=0.01)
    assert master.get(0x6064) == pytest.approx(10 * TURN, abs=64)


def test_a_set_point_is_acknowledged_by_bit_12_until_bit_4_is_taken_back(master):
    master.start("PROFILED POSITION")
    master.set(0x607A, TURN)
    assert not master.status & BIT_12
    master.control(ON | SET_POINT)
    assert master.status & BIT_12
    assert not master.status & REACHED
    master.set(0x607A, 5 * TURN)
    master.control(ON | SET_POINT)  # no rising edge: nothing new
    master.control(ON)
    assert not master.status & BIT_12
    master.arrive()
    assert master.get(0x6064) == pytest.approx(TURN, abs=64)


def test_a_second_set_point_waits_and_a_third_is_not_acknowledged(master):
    master.start("PROFILED POSITION")
    master.move(TURN)
    master.move(2 * TURN)
    assert master.status & BIT_12  # the buffer is full
    master.move(7 * TURN)
    master.arrive()
    assert master.get(0x6064) == pytest.approx(2 * TURN, abs=64)
    assert not master.status & BIT_12


def test_a_set_point_at_once_replaces_the_one_under_way(master):
    master.start("PROFILED POSITION")
    master.move(20 * TURN)
    master.run(0.3)
    assert master.get(0x6064) > TURN
    master.move(TURN, AT_ONCE)
    master.run(0.15)  # it brakes 10 turns/s in 0.1 s, and is on its way back
    assert master.get(0x606C) < 0
    master.arrive()
    assert master.get(0x6064) == pytest.approx(TURN, abs=64)


def test_a_set_point_is_under_way_from_the_moment_it_is_accepted(master):
    master.start("PROFILED POSITION")
    master.run(0.1)
    drive = master.drive
    assert drive.status & REACHED
    drive.store.set(0x607A, 0, TURN)
    drive.receive(Frame(0x600 + NODE, struct.pack("<BHBI", 0x2B, 0x6040, 0, ON | SET_POINT)))
    assert not drive.status & REACHED


def test_a_bit_4_left_from_homing_starts_no_move(master):
    master.start("HOMING")
    master.control(ON | SET_POINT)
    master.node.op_mode = "PROFILED POSITION"
    master.set(0x607A, TURN)
    master.control(ON | SET_POINT)
    assert not master.status & BIT_12
    master.run(0.2)
    assert master.get(0x6064) == pytest.approx(0, abs=64)


def test_a_relative_set_point_counts_from_the_target_before(master):
    master.start("PROFILED POSITION")
    master.move(3 * TURN)
    master.arrive()
    master.move(-TURN, RELATIVE)
    master.arrive()
    assert master.get(0x6064) == pytest.approx(2 * TURN, abs=64)


def test_halt_interrupts_a_move_which_goes_on_afterwards(master):
    master.start("PROFILED POSITION")
    master.move(10 * TURN)
    master.run(0.3)
    master.control(ON | HALT)
    master.run(0.3)
    assert master.status & REACHED  # with halt: it stands
    assert abs(master.drive.rate) < 0.05
    assert master.get(0x6064) < 9 * TURN
    master.control(ON)
    master.arrive()
    assert master.get(0x6064) == pytest.approx(10 * TURN, abs=64)


@pytest.mark.parametrize(("option", "ramp"), [(1, 100), (2, 300)])
def test_halt_brakes_on_the_ramp_of_its_option(master, option, ramp):
    master.set(0x605D, option)
    master.start("PROFILED VELOCITY")
    master.set(0x60FF, 20 * TURN)
    master.run(0.5)
    master.control(ON | HALT)
    master.run(10 / ramp - 0.001)
    assert master.drive.rate / (2 * math.pi) == pytest.approx(10, abs=0.5)
    assert master.drive.enabled


def test_a_goal_beyond_the_software_limits_is_cut_and_reported(master):
    master.node.sdo[0x607D][2].raw = TURN
    master.start("PROFILED POSITION")
    master.move(5 * TURN)
    assert master.status & LIMIT
    master.arrive()
    assert master.get(0x6064) == pytest.approx(TURN, abs=64)


def test_a_velocity_is_reached_on_its_ramps(master):
    master.start("PROFILED VELOCITY")
    master.run(0.01)
    assert master.status & BIT_12  # speed is zero
    master.set(0x6083, 20 * TURN)
    master.set(0x6084, 50 * TURN)
    master.set(0x60FF, 10 * TURN)
    master.run(0.2 - 0.001)
    assert master.get(0x606C) / TURN == pytest.approx(20 * 0.2, abs=0.1)
    assert master.arrive() == pytest.approx(0.3 + 0.005, abs=0.02)
    assert not master.status & BIT_12
    master.set(0x60FF, 0)
    master.run(0.1 - 0.001)
    assert master.get(0x606C) / TURN == pytest.approx(10 - 50 * 0.1, abs=0.1)


def test_a_velocity_beyond_the_largest_is_cut_and_reported(master):
    master.start("PROFILED VELOCITY")
    master.set(0x607F, 5 * TURN)
    master.set(0x60FF, 50 * TURN)
    master.run(0.3)
    assert master.get(0x606C) / TURN == pytest.approx(5, abs=0.05)
    assert master.status & LIMIT
    assert not master.status & REACHED


def test_a_motor_that_turns_on_and_on_counts_round(master):
    master.start("PROFILED VELOCITY")
    master.drive._set_position(2**31 - TURN)
    master.set(0x60FF, 10 * TURN)
    master.run(0.5)
    place = master.get(0x6064)
    assert -(2**31) <= place < -(2**31) + 5 * TURN
    assert master.get(0x606C) / TURN == pytest.approx(10, abs=0.05)
    master.set(0x60FF, 0)
    master.run(0.2)
    master.node.op_mode = "PROFILED POSITION"
    master.move(place + 5 * TURN)
    assert master.arrive() < 2.0


def test_a_motor_held_fast_in_a_velocity_mode_leaves_no_way_to_make_up_for(master):
    master.start("PROFILED VELOCITY")
    master.drive.motor.jammed = True
    master.set(0x60FF, 5 * TURN)
    master.run(0.5)
    assert master.get(0x6062) == master.get(0x6064) == 0
    master.set(0x60FF, 0)
    master.run(0.2)
    master.node.op_mode = "PROFILED POSITION"
    master.drive.motor.jammed = False
    master.run(0.2)
    assert master.get(0x6064) == pytest.approx(0, abs=64)


@pytest.mark.parametrize("method", [35, 37])
def test_homing_gives_the_present_place_the_home_offset(master, method):
    master.start("PROFILED POSITION")
    master.move(2 * TURN + 17)
    master.arrive()
    master.set(0x6098, method)
    master.set(0x607C, -1234)
    assert not master.node.is_homed()
    assert master.node.homing()
    assert master.get(0x6064) == pytest.approx(-1234, abs=16)
    assert master.node.is_homed()
    assert master.drive.motor.angle / (2 * math.pi) == pytest.approx(2 + 17 / TURN, abs=64 / TURN)


def test_homing_of_a_motor_that_turns_is_an_error(master):
    master.start("PROFILED VELOCITY")
    master.set(0x60FF, 10 * TURN)
    master.run(0.3)
    master.node.op_mode = "HOMING"
    master.control(ON | SET_POINT)
    assert master.status & BIT_13
    assert not master.status & BIT_12


def test_cyclic_positions_are_interpolated_and_followed(master):
    period, speed = 0.01, 4 * TURN
    master.start("CYCLIC SYNCHRONOUS POSITION")
    master.node.sdo[0x60C2][1].raw = 10
    master.set(0x607A, 0)
    master.node.nmt.state = "OPERATIONAL"
    errors = []
    for step in range(1, 40):
        master.network.send_message(
            0x400 + NODE, struct.pack("<Hi", ON, round(speed * period * step))
        )
        master.run(period - 0.001)
        if step > 20:
            errors.append(master.drive.following_error)
            assert master.drive.rate == pytest.approx(8 * math.pi, rel=0.02)
    assert max(map(abs, errors)) < 100
    assert master.status & BIT_12
    master.run(0.2)
    assert master.get(0x6064) == pytest.approx(speed * period * 39, abs=64)


def test_a_cyclic_velocity_is_held_at_once(master):
    master.start("CYCLIC SYNCHRONOUS VELOCITY")
    master.set(0x60FF, 3 * TURN)
    master.run(0.05)
    assert master.get(0x606C) / TURN == pytest.approx(3, rel=0.02)
    assert master.status & BIT_12


@pytest.mark.parametrize(
    ("option", "ramp", "ends"), [(1, 100, True), (2, 300, True), (5, 100, False), (6, 300, False)]
)
def test_a_quick_stop_brakes_on_the_ramp_of_its_option(master, option, ramp, ends):
    master.set(0x605A, option)
    master.start("PROFILED VELOCITY")
    master.set(0x60FF, 20 * TURN)
    master.run(0.5)
    master.control(QUICK_STOP)
    time = 20 / ramp
    master.run(time / 2 - 0.001)
    assert master.drive.state is Power.QUICK_STOP
    assert master.drive.rate / (2 * math.pi) == pytest.approx(10, abs=0.5)
    master.run(time / 2 + 0.05)
    assert master.drive.state is (Power.SWITCH_ON_DISABLED if ends else Power.QUICK_STOP)
    assert abs(master.drive.rate) < 0.05
    master.control(ON)
    assert master.drive.enabled is not ends


def test_a_quick_stop_without_braking_leaves_the_motor_to_friction(master):
    master.set(0x605A, 0)
    master.start("PROFILED VELOCITY")
    master.set(0x60FF, 20 * TURN)
    master.run(0.5)
    before = master.drive.rate
    master.control(QUICK_STOP)
    assert master.drive.state is Power.SWITCH_ON_DISABLED
    master.run(0.5)
    coulomb, viscous = 50.0, 0.1  # per inertia: J w' = -Mc - d w
    expected = (before + coulomb / viscous) * math.exp(-viscous * 0.5) - coulomb / viscous
    assert master.drive.rate == pytest.approx(expected, rel=0.01)


def test_a_motion_abandoned_by_a_quick_stop_is_not_taken_up_again(master):
    master.set(0x605A, 6)
    master.start("PROFILED POSITION")
    master.move(20 * TURN)
    master.run(0.5)
    master.control(QUICK_STOP)
    master.run(0.2)
    place = master.get(0x6064)
    master.control(ON)
    master.run(0.5)
    assert master.get(0x6064) == pytest.approx(place, abs=64)
    assert master.status & REACHED


def test_a_jammed_motor_is_a_following_error(master):
    master.start("PROFILED POSITION")
    master.drive.motor.jammed = True
    master.move(10 * TURN)
    master.run(0.5)
    assert master.node.state == "FAULT"
    assert master.status & BIT_13
    assert [each.code for each in master.node.emcy.active] == [0x8611]
    assert (master.get(0x603F), master.get(0x1003, 1), master.get(0x1003, 0)) == (0x8611, 0x8611, 1)
    assert master.get(0x1001) == 1 | 1 << 5
    master.drive.motor.jammed = False
    master.node.reset_from_fault()
    assert master.node.state == "OPERATION ENABLED"
    assert not master.node.emcy.active
    assert not master.status & BIT_13
    master.node.sdo[0x1003][0].raw = 0
    assert master.get(0x1003, 0) == 0


def test_a_following_error_is_not_made_up_for_while_the_drive_brakes(master):
    master.start("PROFILED POSITION")
    master.drive.motor.jammed = True
    master.move(10 * TURN)
    for _ in range(1000):
        if master.drive.power.faults:
            break
        master.run(0.0005)
    assert master.drive.power.faults
    assert abs(master.drive.following_error) < 64


def test_a_following_error_is_ignored_where_its_window_is_off(master):
    master.set(0x6065, 0xFFFFFFFF)
    master.start("PROFILED POSITION")
    master.drive.motor.jammed = True
    master.move(10 * TURN)
    master.run(1.0)
    assert master.drive.enabled


@pytest.mark.parametrize(("option", "rate"), [(0, 120.7), (1, 62.8), (2, 0.0)])
def test_a_fault_is_answered_by_its_reaction_option(master, option, rate):
    master.set(0x605E, option)
    master.start("PROFILED VELOCITY")
    master.set(0x60FF, 20 * TURN)
    master.run(0.5)
    master.drive.fail(0x4310)
    master.run(0.1)
    assert master.drive.rate == pytest.approx(rate, abs=2.0)
    assert master.drive.state is (Power.FAULT if option != 1 else Power.FAULT_REACTION)


def test_open_sto_takes_the_torque_and_cannot_be_reset_until_it_is_closed(master):
    master.start("PROFILED VELOCITY")
    master.drive.open_sto()
    master.run(0.001)
    assert master.get(0x60FD) == 1 << 3
    assert master.node.emcy.log[-1].code == 0xFF01
    master.control(0x00, 0x80)
    assert master.node.state == "FAULT"
    master.drive.power.sto_closed = True
    master.control(0x00, 0x80)
    assert master.node.state == "SWITCH ON DISABLED"


@pytest.mark.parametrize(
    ("option", "state"),
    [
        (0, Power.OPERATION_ENABLED),
        (1, Power.FAULT),
        (2, Power.SWITCH_ON_DISABLED),
        (3, Power.SWITCH_ON_DISABLED),  # a quick stop that ends so
    ],
)
def test_a_silent_master_is_answered_by_the_abort_connection_option(master, option, state):
    master.set(0x6007, option)
    master.node.sdo[0x1016][1].raw = 127 << 16 | 50
    master.start("PROFILED VELOCITY")
    master.network.send_message(0x700 + 127, b"\5")
    master.run(0.1)
    assert (master.node.emcy.log[-1].code, master.node.emcy.log[-1].register) == (0x8130, 0x11)
    assert master.drive.state is state


@pytest.mark.parametrize(
    ("code", "bits"),
    [
        (0x2310, 0x03),
        (0x3210, 0x05),
        (0x4310, 0x09),
        (0x8130, 0x11),
        (0x8611, 0x21),
        (0xFF01, 0x81),
    ],
)
def test_the_error_register_shows_the_kind_of_a_fault(code, bits):
    assert register_bits(code) == bits


def test_a_plant_s_shaft_is_led_to_a_position_by_rates():
    drive = ProfileDrive(NODE, ShaftLoad())
    drive.store.set(0x6060, 0, 1)
    drive._written(0x6060, 0)
    for word in (0x06, 0x07, 0x0F):
        drive.store.set(0x6040, 0, word)
        drive._written(0x6040, 0)
    drive.store.set(0x607A, 0, TURN)
    drive.store.set(0x6040, 0, 0x1F)
    drive._written(0x6040, 0)
    angle = 0.0
    for _ in range(1000):
        drive.step(0.001)
        angle += drive.rate * 0.001
        drive.motor.sense(angle, 0.0)
    assert drive.store.get(0x6064) == pytest.approx(TURN, abs=64)


FRAMES = st.lists(
    st.tuples(
        st.one_of(
            st.integers(0, 0x7FF),
            st.sampled_from([0x000, 0x080, 0x605, 0x205, 0x305, 0x405, 0x505, 0x185]),
        ),
        st.binary(max_size=8),
        st.booleans(),
    ),
    max_size=30,
)


@given(FRAMES)
@settings(max_examples=60)
def test_any_frames_at_all_are_borne(frames):
    drive = ProfileDrive(NODE, InertiaLoad())
    drive.receive(Frame(0, bytes((1, NODE))))
    for cob_id, data, remote in frames:
        for answer in [*drive.receive(Frame(cob_id, data, remote)), *drive.step(0.002)]:
            assert len(answer.data) <= 8
            assert not answer.extended
