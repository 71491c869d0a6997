"""`twin.devices.akd.agreement`.

What a drive says against what else it says: velocity with position, heartbeats, SDO answers."""

import math

import pytest
from stepped import SteppedDrives, refused

from twin.devices.akd import conditions as c
from twin.devices.akd.agreement import HeartbeatCount, MotionAgreement
from twin.devices.akd.protocol import SdoAnswer, answers_otherwise
from twin.emulator.can_bus import Towards
from twin.emulator.drive_objects import Frame

T = 0.002


def turn(time):
    return 1.2 * math.cos(6 * time), -1.2 * math.sin(6 * time)


@pytest.fixture
def rig():
    with SteppedDrives() as rig:
        rig.enabled()
        rig.run(0.6, turn)
        assert not rig.seen
        yield rig


def followed(seconds, angle, rate, shaft_lag=0.0):
    """The time at which a motion with a position and a velocity of time is found out, if it is."""
    agreement = MotionAgreement(0.01, shaft_lag)
    for number in range(round(seconds / T)):
        time = number * T
        if agreement.take(time, angle(time), rate(time)) > 0:
            return time
    return None


@pytest.mark.parametrize("lag", [-0.02, 0.0, 0.002, 0.005, 0.02])
def test_a_velocity_that_is_filtered_agrees_with_its_position(lag):
    # as fast as a plate is turned with cams of ratio 5: 3 rad/s, 35 rad/s^2
    angle, rate = (lambda t: 0.257 * math.sin(11.7 * t)), (lambda t: 3 * math.cos(11.7 * (t - lag)))
    assert followed(5.0, angle, rate) is None


@pytest.mark.parametrize("turned", [0.1, -0.1, 0.5, 3.0])
@pytest.mark.parametrize("said", [0.0, 2.0, -1.0, 0.5])
def test_a_velocity_that_is_another_share_of_that_of_the_position_is_found_within_its_time(
    turned, said
):
    found = followed(1.0, lambda t: turned * t, lambda _: said * turned)
    assert found <= c.CONTRADICTION.within


@pytest.mark.parametrize("lag", [0.06, 0.11, 0.16])
def test_a_shaft_that_follows_with_a_known_lag_agrees_and_without_it_does_not(lag):
    # a velocity of 2 rad/s from 0.2 s to 0.6 s: T x' = integral of v - x, solved by hand
    def rate(time):
        return 2.0 * (0.2 <= time < 0.6)

    def ramp(time):
        since = max(time, 0.0)
        return 2.0 * (since - lag * (1 - math.exp(-since / lag)))

    def angle(time):
        return ramp(time - 0.2) - ramp(time - 0.6)

    assert followed(2.0, angle, rate, lag) is None
    assert followed(2.0, angle, rate) is not None
    assert followed(2.0, lambda t: -angle(t), rate, lag) is not None
    assert followed(2.0, lambda t: 0.4 * angle(t), rate, lag) is not None


@pytest.mark.parametrize("share", [0.9, 1.1, 1.2])
def test_a_velocity_a_little_off_is_none(share):
    assert followed(5.0, lambda t: 2.0 * t, lambda _: 2.0 * share) is None


def test_a_position_that_stands_while_the_velocity_does_not_disagrees_only_beyond_the_slack():
    agreement = MotionAgreement(0.01)
    assert agreement.take(0.0, 0.0, 1.0) == pytest.approx(-0.01)
    # one period at 1 rad/s: 2 mrad, of which a quarter is allowed besides
    assert agreement.take(T, 0.0, 1.0) == pytest.approx(0.002 - 0.01 - 0.0005)
    assert agreement.take(T, 0.5, 1.0) < 0  # the same sample again
    agreement.restart()
    assert agreement.take(2 * T, 0.5, 1.0) == pytest.approx(-0.01)


def test_what_is_long_past_is_forgotten():
    agreement = MotionAgreement(0.01)
    for number in range(2000):
        time = number * T
        # 15 mrad/s of difference for good: 7.5 mrad within the window, 60 mrad in all
        assert agreement.take(time, 0.015 * time, 0.0) < 0


def test_missing_samples_are_bridged():
    agreement = MotionAgreement(0.01)
    for number in (0, 1, 2, 10, 11, 12):
        assert agreement.take(number * T, number * T * 3.0, 3.0) < 0


def test_a_single_wrong_velocity_stops_under_its_own_name(rig):
    rig.bus.faults.flip(0x281, at=3, bits=0x40, lasting=0.002, towards=Towards.HOST)
    seen = rig.run(0.05)
    stops = [each.condition for each in seen]
    assert stops[0] is c.CONTRADICTION
    assert c.PLATE_FROZEN not in stops


@pytest.mark.short("0.02")
@pytest.mark.parametrize("every", [0.005, 0.02, 0.05])
def test_heartbeats_of_a_second_node_with_the_id_are_found(rig, every):
    rig.bus.foreign_frames.append((Frame(0x701, b"\5"), every))
    begin = rig.bus.time
    seen = rig.run(0.4, turn)
    first = seen[0]
    assert first.condition is c.DUPLICATE_ID
    assert first.where == rig.config.axes[0].where
    assert first.at - begin <= c.DUPLICATE_ID.within


@pytest.mark.short("1795")
@pytest.mark.parametrize("node", [0x702, 0x703, 0x77E])
def test_heartbeats_of_nodes_that_are_not_watched_or_of_the_other_s_own_are_no_fault(rig, node):
    if node != 0x702:
        rig.bus.foreign_frames.append((Frame(node, b"\5"), 0.02))
    assert rig.run(0.6, turn) == []


def test_heartbeats_that_a_host_that_stalled_finds_at_once_are_no_second_node():
    count, period = HeartbeatCount(0.02), 0.02
    for number in range(100):
        time = number * period
        waits = 40 <= number < 43  # three wait for the stall to end
        assert not count.too_many(43 * period if waits else time)
    assert any(count.too_many(100 * period + number * period / 2) for number in range(60))


def test_heartbeats_that_waited_for_a_host_that_hung_are_those_of_one_node():
    count, period = HeartbeatCount(0.02), 0.02
    assert not any(count.too_many(number * period) for number in range(30))
    assert not any(count.too_many(2.0) for _ in range(70))  # all at once, after 1.4 s
    assert not any(count.too_many(2.0 + number * period) for number in range(1, 60))
    assert any(count.too_many(3.2 + number * period / 2) for number in range(60))


@pytest.mark.short("127")
@pytest.mark.parametrize("state", [0, 4, 127])
def test_a_heartbeat_of_another_node_that_is_not_operational_is_no_fault_of_this_one(rig, state):
    rig.bus.from_other(Frame(0x701, bytes((state,))))
    (found, *_) = rig.run(0.05, turn)
    assert found.condition is c.DUPLICATE_ID
    assert "while a second one with its id runs" in found.detail


@pytest.mark.short("4-*")
@pytest.mark.parametrize(("nmt", "condition"), [(4, c.NMT_LEFT), (127, c.NMT_LEFT)])
def test_a_drive_that_leaves_the_operational_state_is_named_as_that(rig, nmt, condition):
    rig.drives[0].nmt = nmt
    stops = [each.condition for each in rig.run(0.06, turn) if each.condition is not c.PDO_MISSING]
    assert condition in stops
    assert c.DUPLICATE_ID not in stops


def test_a_drive_that_boots_is_named_as_that(rig):
    rig.drives[0].reboot()
    stops = [each.condition for each in rig.run(0.02, turn)]
    assert c.DRIVE_REBOOTED in stops
    assert c.DUPLICATE_ID not in stops


KEY = (0x1016, 1)


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (None, "cannot be read"),
        (SdoAnswer((0x1017, 0), bytes(2), False), "1017h:0 instead"),
        (SdoAnswer((0x1016, 2), bytes(4), False), "1016h:2 instead"),
        (SdoAnswer((0x1017, 0), bytes(4), True), "1017h:0 instead"),
        (SdoAnswer(KEY, bytes(3), False), "3 bytes, an AKD has 4"),
        (SdoAnswer(KEY, bytes(4), False), ""),
        (SdoAnswer(KEY, bytes(2), True), ""),
    ],
)
def test_what_does_not_answer_the_request_is_said_in_words(answer, words):
    assert words in answers_otherwise(KEY, answer)
    assert bool(words) == bool(answers_otherwise(KEY, answer))


FLIPS = [(1, 0x01, "1017h:1"), (2, 0x80, "9016h:1"), (3, 0x02, "1016h:3"), (0, 0x04, "3 bytes")]


@pytest.mark.short("1-1-1017h:1")
@pytest.mark.parametrize(("at", "bits", "words"), FLIPS)
def test_an_sdo_answer_to_something_else_is_named_in_mid_run(rig, at, bits, words):
    rig.bus.faults.flip(0x581, at=at, bits=bits)
    begin = rig.bus.time
    found = next(each for each in rig.run(1.3, turn) if each.condition is not c.SDO_TIMEOUT)
    assert found.condition is c.SDO_WRONG
    assert words in found.detail
    assert found.at - begin <= c.SDO_WRONG.within


def test_an_sdo_answer_to_something_else_refuses_the_start_and_is_named():
    with SteppedDrives() as rig:
        rig.bus.faults.flip(0x581, at=1, bits=0x01)
        assert "answered for 1001h:0 instead" in refused(rig, c.SDO_WRONG)


@pytest.mark.long
def test_a_velocity_that_is_always_zero_is_found_in_time_while_the_motor_turns_slowly(rig):
    rig.run(0.6, lambda _: (0.1, 0.1))
    rig.bus.faults.overwrite(0x281, at=0, data=bytes(4), towards=Towards.HOST)
    begin = rig.bus.time
    (found, *_) = rig.run(0.4, lambda _: (0.1, 0.1))
    assert found.condition is c.CONTRADICTION
    assert found.at - begin <= c.CONTRADICTION.within
