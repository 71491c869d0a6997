import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.devices.akd import cia402, frames
from twin.devices.akd.axis import Counter
from twin.devices.akd.cia402 import State, Wish
from twin.devices.akd.config import AkdConfig, AxisConfig, unconfirmed
from twin.devices.akd.enquiry import Enquiry, Question
from twin.devices.akd.scaling import RPM, Scale, difference
from twin.devices.akd.stream import Stream, Tally
from twin.errors import ScenarioError

AXIS = AxisConfig(name="phi", node=1)
UNITS = st.sampled_from([AXIS.position, AXIS.plate, AXIS.velocity, Scale(-AXIS.position.unit)])
INT32 = st.integers(-(2**31), 2**31 - 1)


@given(UNITS, st.floats(-200, 200))
def test_scaling_comes_back_within_half_a_count(scale, value):
    back = scale.value(scale.counts(value))
    assert abs(back - value) <= abs(scale.unit) / 2 * (1 + 1e-9)


@given(UNITS, INT32)
def test_whole_counts_come_back_exactly(scale, counts):
    assert scale.counts(scale.value(counts)) == counts


def test_a_radian_a_second_is_9549_counts_of_velocity():
    assert AXIS.velocity.counts(1.0) == 9549
    assert AXIS.velocity.value(9549297) == pytest.approx(1000.0, rel=1e-7)


def test_a_motor_revolution_is_two_to_the_twentieth_counts():
    assert AXIS.position.counts(2 * math.pi) == 1 << 20


def test_a_gear_and_a_sign_are_taken_in_both_position_and_velocity():
    axis = AxisConfig(name="phi", node=1, gear=3.0, motor_sign=-1)
    assert axis.position.counts(2 * math.pi) == -3 * (1 << 20)
    assert axis.velocity.counts(RPM) == -3000


@given(st.floats(allow_nan=False, allow_infinity=False, min_value=-1e12, max_value=1e12))
def test_a_velocity_always_fits_its_object(value):
    struct.pack("<i", AXIS.velocity.counts32(value))


@given(INT32, st.integers(-(2**31), 2**31 - 1))
def test_a_step_over_the_wrap_is_seen_as_the_step_it_is(start, step):
    wrapped = (start + step + 2**31) % 2**32 - 2**31
    assert difference(wrapped, start) == step


@given(st.lists(st.integers(-1000, 1000), max_size=60), INT32)
def test_a_counter_adds_up_across_wraps(steps, start):
    counter = Counter(AXIS.position, 100.0, 0.01)
    raw = start
    counter.take(raw, 0.002)
    for step in steps:
        raw = (raw + step + 2**31) % 2**32 - 2**31
        counter.take(raw, 0.002)
    assert counter.counts == start + sum(steps)
    assert not counter.jump


def test_a_counter_leaves_out_a_jump_and_the_jump_back():
    counter = Counter(AXIS.position, 10.0, 0.01)
    for raw in (0, 100, 900_000, 200):
        counter.take(raw, 0.002)
    assert counter.counts == 100
    assert counter.jump == 200 - 900_000


@given(st.binary(max_size=12))
def test_decoders_take_any_bytes(data):
    motion = frames.motion(data)
    assert (motion is None) == (len(data) != 7)
    assert (frames.sensors(data, True) is None) == (len(data) != 8)
    assert (frames.sensors(data, False) is None) == (len(data) != 4)
    assert frames.emergency(data).short == (len(data) < 8)
    assert isinstance(frames.emergency(data).words, str)
    assert (frames.nmt_state(data) is None) == (len(data) != 1)


@given(st.binary(max_size=10))
def test_an_enquiry_takes_any_answer(data):
    enquiry = Enquiry(0.1)
    enquiry.ask(Question(1, 0x1016, 1))
    enquiry.next(0.0)
    enquiry.take(1, data)


def test_rpdo1_is_control_word_and_target_velocity():
    assert frames.target(0x0F, -9549) == bytes.fromhex("0f00 b3daffff")


def test_tpdo1_is_status_word_mode_and_position():
    assert frames.motion(bytes.fromhex("3702 03 00001000")) == (0x0237, 3, 1 << 20)


def test_tpdo2_is_velocity_and_plate_encoder():
    assert frames.sensors(bytes.fromhex("4d250000 ffffffff"), True) == (9549, -1)


def test_the_emergency_of_the_manual_is_a_hot_heat_sink():
    message = frames.emergency(bytes.fromhex("1043080100000000"))
    assert (message.code, message.register, message.short) == (0x4310, 0x08, False)
    assert "heat sink hot" in message.words


def test_the_fault_number_in_an_emergency_is_read_as_text():
    assert frames.emergency(b"\x30\x81\x01F129\0").words == "8130h heartbeat or life guard F129"


@given(st.integers(0, 0xFFFF))
def test_every_status_word_has_a_state(status):
    expected = {0x00: State.NOT_READY, 0x40: State.SWITCH_ON_DISABLED}
    expected |= {0x08: State.FAULT, 0x0F: State.FAULT_REACTION}
    narrow = {0x21: State.READY, 0x23: State.SWITCHED_ON}
    narrow |= {0x27: State.OPERATION_ENABLED, 0x07: State.QUICK_STOP}
    truth = expected.get(status & 0x4F, narrow.get(status & 0x6F, State.UNKNOWN))
    assert cia402.state(status) is truth


@pytest.mark.parametrize(
    ("now", "wish", "word"),
    [
        (State.SWITCH_ON_DISABLED, Wish.ON, 0x06),
        (State.READY, Wish.ON, 0x07),
        (State.SWITCHED_ON, Wish.ON, 0x0F),
        (State.OPERATION_ENABLED, Wish.ON, 0x0F),
        (State.OPERATION_ENABLED, Wish.QUICK_STOP, 0x02),
        (State.QUICK_STOP, Wish.QUICK_STOP, 0x02),
        (State.OPERATION_ENABLED, Wish.OFF, 0x07),
        (State.SWITCHED_ON, Wish.OFF, 0x06),
        (State.READY, Wish.OFF, 0x00),
    ],
)
def test_the_control_word_takes_one_transition_towards_the_wish(now, wish, word):
    assert cia402.control(now, wish) == word


@pytest.mark.parametrize("wish", Wish)
@pytest.mark.parametrize("now", State)
def test_no_wish_ever_resets_a_fault(now, wish):
    assert not cia402.control(now, wish) & 0x80


def test_a_frame_each_cycle_is_regular():
    stream = Stream()
    for cycle in range(1, 6):
        stream.arrive(cycle)
        assert stream.close() == Tally(False, 0, 0)


def test_a_frame_that_comes_a_cycle_later_is_late():
    stream = Stream()
    assert stream.close() == Tally(True, 0, 0)
    stream.arrive(2)
    stream.arrive(2)
    assert stream.close() == Tally(False, 1, 0)


def test_a_second_frame_that_nobody_owed_belongs_to_no_cycle():
    stream = Stream()
    stream.arrive(1)
    stream.arrive(1)
    assert stream.close() == Tally(False, 0, 1)


def test_what_is_not_confirmed_is_listed_with_its_source():
    found = unconfirmed(AkdConfig())
    assert {"phi.plate_counts", "theta.motor_sign", "rate_limit"} <= {each.name for each in found}
    assert all(each.source and each.confidence in {"M", "L"} for each in found)


@pytest.mark.parametrize(
    "change",
    [
        {"axes": (AXIS, AxisConfig(name="theta", node=1))},
        {"axes": (AxisConfig(name="theta", node=1), AxisConfig(name="phi", node=2))},
        {"period": 0.0015},
        {"heartbeat": 0.1},
        {"rate_limit": 0.0},
        {"host": 2},
    ],
    ids=str,
)
def test_a_configuration_that_cannot_be_is_refused(change):
    with pytest.raises(ScenarioError):
        AkdConfig(**change)


@pytest.mark.parametrize(
    "change", [{"node": 0}, {"node": 127}, {"motor_sign": 0}, {"gear": 0.0}], ids=str
)
def test_an_axis_that_cannot_be_is_refused(change):
    with pytest.raises(ScenarioError):
        AxisConfig(**{"name": "phi", "node": 1, **change})
