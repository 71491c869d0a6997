"""Bytes at made-up times: what counts as the ball, and how soon each fault is noticed."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.devices.lumio.calibration import Calibration
from twin.devices.lumio.conditions import CONDITIONS
from twin.devices.lumio.gate import Gate
from twin.devices.lumio.intake import Intake
from twin.devices.lumio.presence import Presence, TouchState, state
from twin.emulator.screen_bytes import ENCODERS, Protocol, Spot, beyond
from twin.sim.plant.exact import SCREEN

FRAME = 0.01736
CALIBRATION = Calibration.nominal()
PROTOCOLS = list(Protocol)
SINGLE = (Protocol.MICROTOUCH, Protocol.ELO)


class Bench:
    """A screen fed by hand, looked at every 2 ms as a loop does."""

    def __init__(self, protocol=Protocol.HID_0006, capacity=2000.0):
        self.protocol = protocol
        self.gate = Gate()
        self.intake = Intake(protocol.value, capacity, CALIBRATION, self.gate)
        self.presence = Presence(self.gate, self.intake.tell)
        self.time = 0.0
        self.seen = []
        self.tilt = 0.0

    def packet(self, *places, down=True):
        spots = [
            Spot(*CALIBRATION.screen(*place), number, down)
            for number, place in enumerate(places, start=1)
        ]
        return b"".join(ENCODERS[self.protocol](spots))

    def send(self, data):
        self.intake.take(self.time, data)
        self.look()

    def look(self):
        self.presence.look(self.intake.sample, self.time)
        self.presence.lean(self.intake.sample, self.time, self.tilt)
        self.seen += [(self.time, fault.condition.name) for fault in self.intake.faults()]

    def wait(self, seconds):
        for _ in range(round(seconds / 0.002)):
            self.time += 0.002
            self.intake.take(self.time, b"")
            self.look()

    def roll(self, frames, place, speed=0.0):
        """Frames of a ball that rolls along x, the first at a place."""
        for number in range(frames):
            self.send(self.packet((place[0] + number * speed * FRAME, place[1])))
            self.time += FRAME
        return (place[0] + frames * speed * FRAME, place[1])

    @property
    def names(self):
        return [name for _, name in self.seen]

    def first(self, name):
        return next(time for time, seen in self.seen if seen == name)

    @property
    def state(self):
        return state(self.gate, self.intake.sample, self.time)


def within(name):
    return next(condition.within for condition in CONDITIONS if condition.name == name)


@pytest.fixture(params=PROTOCOLS)
def bench(request):
    return Bench(request.param)


def test_every_condition_has_a_name_of_its_own():
    assert len({condition.name for condition in CONDITIONS}) == len(CONDITIONS)


def test_a_rolling_ball_is_followed_without_a_fault(bench):
    bench.roll(40, (-0.15, 0.1), 0.4)
    x, y = bench.intake.sample.position
    assert abs(x - (-0.15 + 39 * 0.4 * FRAME)) < SCREEN[0] / 4095
    assert abs(y - 0.1) < SCREEN[1] / 4095
    assert bench.names == []


def test_a_resting_ball_is_neither_frozen_nor_stale(bench):
    bench.roll(500, (0.02, 0.03))
    assert bench.names == []
    assert bench.state == TouchState.TOUCHING


def test_a_ball_that_slows_down_and_comes_to_rest_is_not_frozen(bench):
    speed, x = 0.3, -0.1
    for _ in range(100):
        bench.send(bench.packet((x, 0.0)))
        bench.time += FRAME
        x += speed * FRAME
        speed = max(0.0, speed - 1.0 * FRAME)
    assert bench.names == []


def test_a_touch_that_stops_dead_is_frozen_within_the_stated_time(bench):
    place = bench.roll(20, (-0.1, 0.05), 0.12)
    begin = bench.time
    bench.roll(20, place)
    assert bench.first("touch frozen") - begin <= 0.1 < within("touch frozen")


def test_no_motion_on_a_tilted_plate_is_frozen_within_the_stated_time(bench):
    bench.roll(30, (0.05, 0.05))
    bench.tilt = math.radians(3)
    begin = bench.time
    bench.roll(40, (0.05, 0.05))
    assert bench.first("touch frozen") - begin <= within("touch frozen")


def test_the_report_rate_leaves_out_pauses_without_a_touch(bench):
    bench.roll(20, (0.0, 0.0))
    bench.wait(1.0)
    bench.roll(20, (0.0, 0.0))
    assert bench.intake.rate == pytest.approx(1 / FRAME)


def test_a_ball_that_rolls_on_a_tilted_plate_is_not_frozen(bench):
    bench.tilt = math.radians(5)
    bench.roll(60, (-0.2, 0.05), 0.1)
    assert bench.names == []


def test_a_ball_that_friction_holds_on_a_slight_tilt_is_not_frozen(bench):
    bench.tilt = math.radians(1.5)
    bench.roll(60, (0.05, 0.05))
    assert bench.names == []


def test_a_lift_off_is_a_state_and_then_a_lost_ball_within_the_stated_time(bench):
    place = bench.roll(10, (0.0, 0.0))
    bench.send(bench.packet(place, down=False))
    begin = bench.time
    assert bench.state == TouchState.LIFTED
    bench.wait(0.2)
    assert bench.state == TouchState.LOST
    assert bench.first("ball lost") - begin <= within("ball lost")
    assert "touch stale" not in bench.names


def test_a_missing_lift_off_is_stale_and_then_lost_within_the_stated_times(bench):
    bench.roll(10, (0.0, 0.0))
    begin = bench.time
    bench.wait(0.2)
    assert bench.first("touch stale") - begin <= within("touch stale")
    assert bench.first("ball lost") - begin <= within("ball lost")


def test_a_brief_dropout_is_bridged_and_told_when_over(bench):
    place = bench.roll(10, (0.0, 0.0), 0.1)
    bench.send(bench.packet(place, down=False))
    bench.wait(0.04)
    bench.roll(10, (place[0] + 0.1 * 0.04, 0.0), 0.1)
    assert bench.names == ["brief dropout"]
    assert bench.state == TouchState.TOUCHING


def test_a_jump_of_one_frame_is_refused_and_told_at_once(bench):
    place = bench.roll(10, (-0.2, 0.0), 0.1)
    before = bench.intake.sample
    bench.send(bench.packet((0.2, 0.1)))
    begin = bench.time
    assert bench.intake.sample == before
    bench.time += FRAME
    bench.roll(10, place, 0.1)
    assert bench.names == ["position jumped"]
    assert bench.first("position jumped") == begin


def test_a_jump_that_stays_is_believed_and_told_within_the_stated_time(bench):
    bench.roll(10, (-0.2, 0.0))
    begin = bench.time
    bench.roll(5, (0.2, 0.1))
    assert bench.first("position jumped and stayed") - begin <= within("position jumped and stayed")
    assert bench.intake.sample.position == pytest.approx((0.2, 0.1), abs=2e-4)


@given(way=st.floats(0.04, 0.3))
def test_a_jump_further_than_a_ball_can_roll_in_a_frame_is_never_believed_silently(way):
    bench = Bench()
    bench.roll(10, (-0.2, 0.0))
    bench.roll(5, (-0.2 + way, 0.0))
    assert bench.names == ["position jumped", "position jumped and stayed"]


@given(angle=st.floats(0, 2 * math.pi), radius=st.floats(0.05, 0.15))
def test_swapped_axes_are_told_wherever_they_move_the_ball_far_enough(angle, radius):
    bench = Bench()
    place = (radius * math.cos(angle), radius * math.sin(angle))
    x, y = CALIBRATION.screen(*place)
    turned = CALIBRATION.plate(y, x)
    bench.roll(10, place)
    bench.roll(5, turned)
    far = math.dist(place, turned) > bench.gate.slack + bench.gate.speed * FRAME + 1e-3
    assert ("axes swapped" in bench.names) or not far


def test_swapped_axes_are_refused_until_someone_asks_to_go_on(bench):
    bench.roll(10, (0.2, 0.0))
    begin = bench.time
    x, y = CALIBRATION.screen(0.2, 0.0)
    turned = CALIBRATION.plate(y, x)
    bench.roll(60, turned)
    assert bench.first("axes swapped") - begin <= within("axes swapped")
    assert bench.names.count("axes swapped") == 1
    assert bench.state == TouchState.LOST
    bench.intake.forget()
    bench.roll(4, turned)
    assert bench.state == TouchState.TOUCHING


@pytest.mark.parametrize("protocol", [Protocol.HID_0006, Protocol.HID_0007])
def test_of_two_contacts_the_one_nearest_the_ball_is_followed(protocol):
    bench = Bench(protocol)
    bench.roll(10, (-0.1, 0.0), 0.1)
    begin = bench.time
    for number in range(10, 30):
        bench.send(bench.packet((-0.1 + 0.1 * number * FRAME, 0.0), (0.3, 0.1)))
        bench.time += FRAME
    assert bench.first("two contacts") - begin <= within("two contacts")
    assert bench.names == ["two contacts"]
    assert bench.intake.sample.position[0] == pytest.approx(-0.1 + 0.1 * 29 * FRAME, abs=2e-4)


def test_the_ball_keeps_being_followed_when_the_other_contact_has_the_lower_number():
    bench = Bench()
    bench.roll(10, (0.1, 0.0))
    for _ in range(10):
        bench.send(bench.packet((-0.3, -0.1), (0.1, 0.0)))
        bench.time += FRAME
    assert bench.intake.sample.position == pytest.approx((0.1, 0.0), abs=2e-4)


@pytest.mark.parametrize("protocol", [p for p in PROTOCOLS if p is not Protocol.MICROTOUCH])
def test_values_out_of_range_are_told_and_never_become_a_position(protocol):
    bench = Bench(protocol)
    bench.roll(10, (0.0, 0.0))
    begin = bench.time
    bench.send(beyond(bench.packet((0.0, 0.0)), protocol))
    assert bench.first("value out of range") == begin
    assert bench.intake.sample.time < begin


def test_a_wrong_checksum_is_told_at_once():
    bench = Bench(Protocol.ELO)
    bench.roll(10, (0.0, 0.0))
    begin = bench.time
    packet = bench.packet((0.0, 0.0))
    bench.send(packet[:-1] + bytes([packet[-1] ^ 1]))
    assert bench.first("checksum error") == begin


@pytest.mark.parametrize("cut", [1, 3])
def test_a_packet_cut_short_is_told_within_the_stated_time(bench, cut):
    place = bench.roll(10, (0.0, 0.0))
    begin = bench.time
    bench.send(bench.packet(place)[:cut])
    bench.time += FRAME
    bench.roll(10, place)
    assert bench.first("bytes not understood") - begin <= within("bytes not understood")
    assert bench.state == TouchState.TOUCHING


def test_the_report_after_one_cut_short_is_taken():
    # Cut to six bytes, a report of product 0007 and the head of the next look like a whole one.
    bench = Bench(Protocol.HID_0007)
    place = bench.roll(10, (0.0, 0.0), 0.1)
    bench.send(bench.packet(place)[:6])
    bench.time += FRAME
    bench.send(bench.packet(place))
    assert bench.intake.sample.time == bench.time


def test_packets_in_parts_or_together_are_understood(bench):
    place = bench.roll(10, (0.0, 0.0), 0.1)
    packet = bench.packet(place)
    bench.send(packet[:2])
    bench.time += 0.003
    bench.send(packet[2:])
    bench.time += FRAME
    bench.send(packet + packet)
    assert bench.names == []


def test_a_flood_is_told_within_the_stated_time_and_costs_bounded_work(bench):
    bench.roll(10, (0.0, 0.0))
    begin = bench.time
    noise = np.random.default_rng(3)
    for _ in range(100):
        bench.send(noise.bytes(1000))
        bench.time += 0.005
    assert bench.first("byte flood") - begin <= within("byte flood")
    assert bench.intake.tally.bytes <= 100 * Intake.MOST + 10 * 25
    assert bench.intake.dropped == 100 * (1000 - Intake.MOST)


def test_bytes_of_no_protocol_are_told_within_the_stated_time():
    intake = Intake("auto", 1e9, CALIBRATION, Gate())
    noise = np.random.default_rng(4)
    times = [0.02 * n for n in range(100)]
    told = None
    for time in times:
        intake.take(time, noise.bytes(10))
        if told is None and any(
            f.condition.name == "protocol not recognised" for f in intake.faults()
        ):
            told = time
    assert told <= within("protocol not recognised")


def test_a_fault_that_lasts_is_told_twice_a_second_not_every_packet():
    bench = Bench(Protocol.ELO)
    bench.roll(3, (0.0, 0.0))
    for _ in range(115):
        packet = bench.packet((0.0, 0.0))
        bench.send(packet[:-1] + bytes([packet[-1] ^ 1]))
        bench.time += FRAME
    assert 3 <= bench.names.count("checksum error") <= 5


def test_a_single_false_position_at_the_start_is_not_believed(bench):
    bench.send(bench.packet((0.3, 0.1)))
    bench.time += FRAME
    assert bench.intake.sample is None
    bench.roll(5, (0.0, 0.0))
    assert bench.intake.sample.position == pytest.approx((0.0, 0.0), abs=2e-4)


def test_false_positions_far_apart_in_time_do_not_confirm_each_other(bench):
    for _ in range(6):
        bench.send(bench.packet((0.3, 0.1)))
        bench.time += 0.08
    assert bench.intake.sample is None


@given(data=st.lists(st.tuples(st.binary(max_size=80), st.floats(0, 0.3)), max_size=12))
@pytest.mark.parametrize("protocol", ["auto", *(p.value for p in PROTOCOLS)])
def test_whatever_bytes_come_no_position_is_off_the_screen(protocol, data):
    intake = Intake(protocol, 1000.0, CALIBRATION, Gate())
    time = 0.0
    for portion, pause in data:
        time += pause
        intake.take(time, portion)
        if intake.sample is not None:
            x, y = intake.sample.position
            assert abs(x) <= SCREEN[0] / 2 + 1e-12
            assert abs(y) <= SCREEN[1] / 2 + 1e-12
    intake.faults()
