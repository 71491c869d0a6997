"""Tests of `twin.devices.akd.protocol`."""

import inspect
import itertools
import re
import struct

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from twin.base.errors import ScenarioError
from twin.devices.akd import conditions as c
from twin.devices.akd import protocol
from twin.devices.akd.axis import Axis, EncoderCounter, PdoTracker, difference
from twin.devices.akd.config import AkdConfig, AxisConfig, DriveSettings, counts32, list_unconfirmed
from twin.devices.akd.protocol import AxisRequest, DriveState
from twin.devices.akd.servos import SdoPolling
from twin.devices.common import FaultReports

AXIS = AxisConfig(name="phi", node=1)
UNITS = st.sampled_from([AXIS.position, AXIS.plate, AXIS.velocity, -AXIS.position])
INT32 = st.integers(-(2**31), 2**31 - 1)


@given(UNITS, INT32)
def test_whole_counts_come_back_exactly(unit, counts):
    assert counts32(counts * unit, unit) == counts


@given(st.floats(allow_nan=False, allow_infinity=False, min_value=-1e12, max_value=1e12))
def test_a_velocity_always_fits_its_object(value):
    struct.pack("<i", counts32(value, AXIS.velocity))


@given(INT32, st.integers(-(2**31), 2**31 - 1))
def test_a_step_over_the_wrap_is_seen_as_the_step_it_is(start, step):
    wrapped = (start + step + 2**31) % 2**32 - 2**31
    assert difference(wrapped, start) == step


@given(st.lists(st.integers(-1000, 1000), max_size=60), INT32)
def test_a_counter_adds_up_across_wraps(steps, start):
    counter = EncoderCounter(AXIS.position, 100.0, 0.01)
    raw = start
    counter.update(raw, 0.002)
    for step in steps:
        raw = (raw + step + 2**31) % 2**32 - 2**31
        counter.update(raw, 0.002)
    assert counter.counts == start + sum(steps)
    assert not counter.jump


def test_a_counter_leaves_out_a_jump_and_the_jump_back():
    counter = EncoderCounter(AXIS.position, 10.0, 0.01)
    for raw in (0, 100, 900_000, 200):
        counter.update(raw, 0.002)
    assert counter.counts == 100
    assert counter.jump == 200 - 900_000


def test_late_answers_that_come_at_once_are_a_period_apart_and_one_too_many_is_not():
    config = AkdConfig()
    axis, T = Axis(config.axes[0], config, FaultReports(1.0), at=0.0), config.period
    step = round(6.0 * T / abs(config.axes[0].position))  # 6 rad/s: 12 mrad a period

    def sampled(position, cycle):
        data = struct.pack("<Hbi", 0x1237, 3, position)
        axis.receive(0x180, data, cycle, cycle * T, cycle * T)

    sampled(0, 1)
    axis.motor.pdo.close()
    for _ in range(4):  # an adapter keeps them back
        axis.motor.pdo.close()
    for number in range(1, 6):
        sampled(number * step, 6)
        assert not axis.motor.jump
    assert axis.motor.counts == 5 * step
    axis.motor.pdo.close()
    sampled(6 * step, 7)
    sampled(7 * step, 7)
    assert axis.motor.jump == step  # nothing was owed: two steps in one period


@given(st.binary(max_size=12))
def test_decoders_take_any_bytes(data):
    assert (protocol.decode_tpdo(protocol.TPDO1, data) is None) == (len(data) != 7)
    assert (protocol.decode_tpdo(protocol.TPDO2, data) is None) == (len(data) != 8)
    assert protocol.decode_emergency(data).short == (len(data) < 8)
    assert (protocol.decode_nmt_state(data) is None) == (len(data) != 1)


@given(st.binary(max_size=12))
def test_the_words_of_an_emergency_are_one_printable_line_that_begins_with_its_code(data):
    words = protocol.decode_emergency(data).words
    code = f"{int.from_bytes(data[:2], 'little'):04X}h" if len(data) >= 2 else "no code"
    assert words.startswith(code)
    assert words.isprintable()


def test_a_warning_is_told_again_after_a_while_with_how_often_it_was_seen_and_a_stop_once():
    reports = FaultReports(1.0)
    for at in (0.0, 0.3, 0.9, 1.1, 1.5, 3.0):
        reports.report(c.PDO_LATE, "drive phi", "late", at)
        reports.report(c.MOTOR_FROZEN, "drive phi", f"seen at {at} s", at)
        assert reports.stopping[0].at == 0.0
    told = [(each.at, each.detail) for each in reports.take()]
    assert told == [
        (0.0, "late"),
        (0.0, "seen at 0.0 s"),
        (1.1, "late (2 more before)"),
        (3.0, "late (1 more before)"),
    ]
    assert not reports.take()


def reading():
    """Polling whose request for 1016h:1 of node 2 is on the wire since 0.6 s, and its reports."""
    reports = FaultReports(1.0)
    polling = SdoPolling(AkdConfig(), reports, 0.0)
    assert polling.next_frame(0.4) is None
    assert polling.next_frame(0.6) == (0x602, bytes.fromhex("4016100100000000"))
    return polling, reports


HEADERS = st.builds(
    lambda command, sub: bytes((command, 0x16, 0x10, sub)),
    st.sampled_from([0x43, 0x47, 0x4B, 0x4F, 0x80, 0x40, 0x41, 0x60]) | st.integers(0, 255),
    st.sampled_from([1, 1, 1, 0, 2]),
)
ANSWERS = st.builds(bytes.__add__, HEADERS, st.binary(min_size=4, max_size=4))


@given(ANSWERS | st.binary(max_size=10))
@example(bytes.fromhex("4316100100000000"))
@example(bytes.fromhex("431610013c007f00"))
def test_any_answer_ends_the_request_and_one_to_something_else_is_named(data):
    polling, reports = reading()
    polling.receive(2, data, 0.65)
    whole = len(data) == 8
    right = whole and data[1:4] == b"\x16\x10\x01" and data[0] in {0x43, 0x80}
    if not (whole and data[0] == 0x60):  # of a write; nobody has asked for one
        value = int.from_bytes(data[4:8], "little")
        said = [(each.condition, f"{value:08X}h" in each.detail) for each in reports.take()]
        if not right:
            assert said[0][0] is c.SDO_WRONG
        elif data[0] == 0x80:
            assert said == [(c.SDO_ABORT, True)]
        else:
            assert said == ([] if value == 127 << 16 | 60 else [(c.MONITORING_OFF, True)])
        assert polling.next_frame(0.75) is None
        assert not reports.take()
    else:
        assert polling.next_frame(0.7) is None
        assert not reports.take()
        assert polling.next_frame(0.71) is None
        (late,) = reports.take()
        assert (late.condition, late.detail) == (c.SDO_TIMEOUT, "reading 1016h:1")


def test_an_answer_of_another_node_answers_nothing():
    polling, reports = reading()
    polling.receive(1, bytes.fromhex("431610013c007f00"), 0.65)
    polling.next_frame(0.71)
    assert [each.condition for each in reports.take()] == [c.SDO_TIMEOUT]


def test_one_request_is_on_the_wire_at_a_time():
    polling, reports = reading()
    reports.report(c.DRIVE_FAULT, AkdConfig().axes[0].where, "", 0.6)
    assert polling.next_frame(0.61) is None
    polling.receive(2, bytes.fromhex("431610013c007f00"), 0.62)
    assert polling.next_frame(0.63) == (0x601, bytes.fromhex("4001200100000000"))


def test_frames_are_laid_out_as_mapped_and_as_the_manual_prints_them():
    assert protocol.encode_rpdo1(0x0F, -9549) == bytes.fromhex("0f00 b3daffff")
    assert protocol.decode_tpdo(protocol.TPDO1, bytes.fromhex("3702 03 00001000")) == (
        0x0237,
        3,
        1 << 20,
    )
    assert protocol.decode_tpdo(protocol.TPDO2, bytes.fromhex("4d250000 ffffffff")) == (9549, -1)
    hot = protocol.decode_emergency(bytes.fromhex("1043080100000000"))
    assert (hot.code, hot.short, "heat sink hot" in hot.words) == (0x4310, False, True)
    silent = protocol.decode_emergency(b"\x30\x81\x01F129\0")
    assert silent.words == "8130h heartbeat or life guard F129"


@pytest.mark.parametrize(
    ("now", "request_", "word"),
    [
        (DriveState.SWITCH_ON_DISABLED, AxisRequest.ENABLE, 0x06),
        (DriveState.READY, AxisRequest.ENABLE, 0x07),
        (DriveState.SWITCHED_ON, AxisRequest.ENABLE, 0x0F),
        (DriveState.OPERATION_ENABLED, AxisRequest.ENABLE, 0x0F),
        (DriveState.OPERATION_ENABLED, AxisRequest.QUICK_STOP, 0x02),
        (DriveState.QUICK_STOP, AxisRequest.QUICK_STOP, 0x02),
        (DriveState.OPERATION_ENABLED, AxisRequest.DISABLE, 0x07),
        (DriveState.SWITCHED_ON, AxisRequest.DISABLE, 0x06),
        (DriveState.READY, AxisRequest.DISABLE, 0x00),
    ],
)
def test_the_control_word_takes_one_transition_towards_the_request(now, request_, word):
    assert protocol.control_word(now, request_) == word


@pytest.mark.parametrize("request_", AxisRequest)
@pytest.mark.parametrize("now", DriveState)
def test_no_request_ever_resets_a_fault(now, request_):
    assert not protocol.control_word(now, request_) & 0x80


@pytest.mark.parametrize(
    ("arrivals", "early", "judged"),
    [
        ((1, 1, 1), "", [(False, 0, 0)] * 3),
        ((0, 2), "", [(True, 0, 0), (False, 1, 0)]),  # the first comes a cycle later
        ((2,), "", [(False, 0, 1)]),  # nobody owed the second one
        ((0, 2, 1), "1", [(False, 0, 0)] * 3),  # judged before an answer can be there: waited for
        ((0, 1, 2), "12", [(False, 0, 0)] * 3),  # and again
        ((0, 1), "1", [(False, 0, 0), (True, 0, 0)]),  # the one that was waited for never came
        ((0, 0, 0), "1", [(False, 0, 0), (True, 0, 0), (True, 0, 0)]),
        ((0, 0), "12", [(False, 0, 0), (True, 0, 0)]),  # waited for once only
        ((0, 3), "1", [(False, 0, 0), (False, 0, 1)]),
    ],
)
def test_frames_are_counted_per_sync_as_regular_late_or_of_no_cycle(arrivals, early, judged):
    pdo, found = PdoTracker(), []
    for cycle, count in enumerate(arrivals, 1):
        for _ in range(count):
            pdo.arrive(cycle)
        found.append(pdo.close(early=str(cycle) in early))
    assert found == judged


def test_a_silent_drive_is_stale_one_cycle_later_at_most_however_its_host_is_late():
    for early in itertools.product((False, True), repeat=12):
        pdo = PdoTracker()
        for each in early:
            pdo.close(early=each)
        assert pdo.missed >= len(early) - 1


@pytest.mark.parametrize("rate", [0.5, -0.5, 0.0])
def test_a_quick_stop_lasts_until_the_motor_stands(rate):
    axis = Axis(AXIS, AkdConfig(), FaultReports(1.0), at=0.0)
    axis.request, axis.state, axis.rate = AxisRequest.QUICK_STOP, DriveState.QUICK_STOP, rate
    axis.finish_quick_stop()
    assert axis.request is (AxisRequest.QUICK_STOP if rate else AxisRequest.DISABLE)


def test_what_is_not_confirmed_is_listed_and_documented_with_its_source():
    attribute = re.compile(r"^    (\w+): (.*(?:\n     +.*)*)", re.MULTILINE)
    docs = (inspect.cleandoc(each.__doc__) for each in (DriveSettings, AxisConfig))
    known = dict(itertools.chain.from_iterable(map(attribute.findall, docs)))
    assert {"plate_counts", "motor_sign", "rate_limit"} <= set(list_unconfirmed())
    sourced = {name for name, text in known.items() if re.search(r";\s.+\s\([ML]\)\.$", text, re.S)}
    assert sourced == set(list_unconfirmed())


@pytest.mark.parametrize(
    "change",
    [
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
