"""`twin.devices.lumio.screen`.

Bytes at made-up times: what counts as the ball, and how soon each fault is noticed."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.devices.lumio.conditions import SCREEN_CONDITIONS
from twin.devices.lumio.config import Calibration, LumioConfig, PlausibilityLimits
from twin.devices.lumio.screen import TouchState, TouchStream
from twin.emulator.screen import PACKET_ENCODERS, Protocol, Spot, beyond
from twin.sim.plant.exact import SCREEN_SIZE_M

FRAME = 0.01736
CALIBRATION = Calibration.nominal()
PROTOCOLS = list(Protocol)
SERIAL = [Protocol.MICROTOUCH, Protocol.ELO]


def settings(protocol, capacity=1e9, calibration=CALIBRATION):
    """Those of a line of so many bytes per second, beyond which it is flooded."""
    baud = math.ceil(capacity / 0.09)
    return LumioConfig(port="", protocol=str(protocol), baud=baud, calibration=calibration)


class FedScreen:
    """A screen fed by hand, looked at every 2 ms as a loop does."""

    def __init__(self, protocol=Protocol.HID_0006):
        self.protocol = protocol
        self.limits = PlausibilityLimits()
        self.stream = TouchStream(settings(protocol, 2000.0))
        self.time = 0.0
        self.seen = []
        self.tilt = 0.0

    def packet(self, *places, down=True):
        spots = [
            Spot(*CALIBRATION.screen(*place), number, down)
            for number, place in enumerate(places, start=1)
        ]
        return b"".join(PACKET_ENCODERS[self.protocol](spots))

    def send(self, data):
        self.stream.take(self.time, data)
        self.look()

    def look(self):
        self.stream.tracker.watch(self.time)
        self.stream.tracker.note_tilt(self.time, self.tilt)
        self.seen += [
            (self.time, each.condition.name, each.detail) for each in self.stream.faults()
        ]

    def wait(self, seconds):
        for _ in range(round(seconds / 0.002)):
            self.time += 0.002
            self.stream.take(self.time, b"")
            self.look()

    def roll(self, frames, place, speed=0.0):
        """Frames of a ball that rolls along x, the first at a place."""
        for number in range(frames):
            self.send(self.packet((place[0] + number * speed * FRAME, place[1])))
            self.time += FRAME
        return (place[0] + frames * speed * FRAME, place[1])

    @property
    def names(self):
        return [name for _, name, _ in self.seen]

    def first(self, name):
        return next(time for time, seen, _ in self.seen if seen == name)

    @property
    def state(self):
        return self.stream.tracker.state(self.time)


WITHIN = {condition.name: condition.within for condition in SCREEN_CONDITIONS}


@pytest.fixture(params=PROTOCOLS)
def screen(request):
    return FedScreen(request.param)


def test_a_rolling_ball_is_followed_without_a_fault(screen):
    screen.roll(40, (-0.15, 0.1), 0.4)
    x, y = screen.stream.tracker.sample.position
    assert abs(x - (-0.15 + 39 * 0.4 * FRAME)) < SCREEN_SIZE_M[0] / 4095
    assert abs(y - 0.1) < SCREEN_SIZE_M[1] / 4095
    assert screen.names == []


@pytest.mark.parametrize(
    ("frames", "speed", "tilt"),
    [(500, 0.0, 0.0), (60, 0.1, 5.0), (60, 0.0, 1.5)],
    ids=["rests", "rolls on a tilted plate", "is held by friction on a slight tilt"],
)
def test_a_ball_that_moves_as_it_may_is_neither_frozen_nor_stale(screen, frames, speed, tilt):
    screen.tilt = math.radians(tilt)
    screen.roll(frames, (-0.2, 0.05), speed)
    assert screen.names == []
    assert screen.state == TouchState.TOUCHING


def test_a_ball_that_slows_down_and_comes_to_rest_is_not_frozen(screen):
    speed, x = 0.3, -0.1
    for _ in range(100):
        screen.send(screen.packet((x, 0.0)))
        screen.time += FRAME
        x += speed * FRAME
        speed = max(0.0, speed - 1.0 * FRAME)
    assert screen.names == []


def test_a_touch_that_stops_dead_is_frozen_within_the_stated_time(screen):
    place = screen.roll(20, (-0.1, 0.05), 0.12)
    begin = screen.time
    screen.roll(20, place)
    assert screen.first("touch frozen") - begin <= 0.1 < WITHIN["touch frozen"]


def test_no_motion_on_a_tilted_plate_is_frozen_within_the_stated_time(screen):
    screen.roll(30, (0.05, 0.05))
    screen.tilt = math.radians(3)
    begin = screen.time
    screen.roll(40, (0.05, 0.05))
    assert screen.first("touch frozen") - begin <= WITHIN["touch frozen"]


def test_the_report_rate_leaves_out_pauses_without_a_touch(screen):
    screen.roll(20, (0.0, 0.0))
    screen.wait(1.0)
    screen.roll(20, (0.0, 0.0))
    assert screen.stream.rate == pytest.approx(1 / FRAME)


def test_a_lift_off_is_a_state_and_then_a_lost_ball_within_the_stated_time(screen):
    place = screen.roll(10, (0.0, 0.0))
    screen.send(screen.packet(place, down=False))
    begin = screen.time
    assert screen.state == TouchState.LIFTED
    screen.wait(0.2)
    assert screen.state == TouchState.LOST
    assert screen.first("ball lost") - begin <= WITHIN["ball lost"]
    assert "touch stale" not in screen.names


def test_a_missing_lift_off_is_stale_and_then_lost_within_the_stated_times(screen):
    screen.roll(10, (0.0, 0.0))
    begin = screen.time
    screen.wait(0.2)
    assert screen.first("touch stale") - begin <= WITHIN["touch stale"]
    assert screen.first("ball lost") - begin <= WITHIN["ball lost"]


def test_a_brief_dropout_is_bridged_and_told_when_over(screen):
    place = screen.roll(10, (0.0, 0.0), 0.1)
    screen.send(screen.packet(place, down=False))
    screen.wait(0.04)
    screen.roll(10, (place[0] + 0.1 * 0.04, 0.0), 0.1)
    assert screen.names == ["brief dropout"]
    assert screen.state == TouchState.TOUCHING


def test_a_jump_of_one_frame_is_refused_and_told_at_once(screen):
    place = screen.roll(10, (-0.2, 0.0), 0.1)
    before = screen.stream.tracker.sample
    screen.send(screen.packet((0.2, 0.1)))
    begin = screen.time
    assert screen.stream.tracker.sample == before
    screen.time += FRAME
    screen.roll(10, place, 0.1)
    assert screen.names == ["position jumped"]
    assert screen.first("position jumped") == begin


def test_a_jump_that_stays_is_believed_and_told_within_the_stated_time(screen):
    screen.roll(10, (-0.2, 0.0))
    begin = screen.time
    screen.roll(5, (0.2, 0.1))
    assert (
        screen.first("position jumped and stayed") - begin <= WITHIN["position jumped and stayed"]
    )
    assert screen.stream.tracker.sample.position == pytest.approx((0.2, 0.1), abs=2e-4)


@given(way=st.floats(0.04, 0.3))
def test_a_jump_further_than_a_ball_can_roll_in_a_frame_is_never_believed_silently(way):
    screen = FedScreen()
    screen.roll(10, (-0.2, 0.0))
    screen.roll(5, (-0.2 + way, 0.0))
    assert screen.names == ["position jumped", "position jumped and stayed"]


@given(angle=st.floats(0, 2 * math.pi), radius=st.floats(0.05, 0.15))
def test_swapped_axes_are_told_wherever_they_move_the_ball_far_enough(angle, radius):
    screen = FedScreen()
    place = (radius * math.cos(angle), radius * math.sin(angle))
    x, y = CALIBRATION.screen(*place)
    turned = CALIBRATION.plate(y, x)
    screen.roll(10, place)
    screen.roll(5, turned)
    far = math.dist(place, turned) > screen.limits.slack + screen.limits.speed * FRAME + 1e-3
    assert ("axes swapped" in screen.names) or not far


def test_swapped_axes_are_told_once_and_refused(screen):
    screen.roll(10, (0.2, 0.0))
    begin = screen.time
    x, y = CALIBRATION.screen(0.2, 0.0)
    turned = CALIBRATION.plate(y, x)
    screen.roll(60, turned)
    assert screen.first("axes swapped") - begin <= WITHIN["axes swapped"]
    assert screen.names.count("axes swapped") == 1
    assert screen.state == TouchState.LOST


@pytest.mark.parametrize(
    ("protocol", "order"), [(Protocol.HID_0006, 1), (Protocol.HID_0006, -1), (Protocol.HID_0007, 1)]
)
def test_of_two_contacts_the_one_nearest_the_ball_is_followed(protocol, order):
    screen = FedScreen(protocol)
    screen.roll(10, (-0.1, 0.0), 0.1)
    begin = screen.time
    for number in range(10, 30):
        both = (-0.1 + 0.1 * number * FRAME, 0.0), (0.3, 0.1)
        screen.send(screen.packet(*both[::order]))
        screen.time += FRAME
    assert screen.first("two contacts") - begin <= WITHIN["two contacts"]
    assert screen.names == ["two contacts"]
    assert screen.stream.tracker.sample.position[0] == pytest.approx(
        -0.1 + 0.1 * 29 * FRAME, abs=2e-4
    )


@pytest.mark.parametrize("protocol", [p for p in PROTOCOLS if p is not Protocol.MICROTOUCH])
def test_values_out_of_range_are_told_and_never_become_a_position(protocol):
    screen = FedScreen(protocol)
    screen.roll(10, (0.0, 0.0))
    begin = screen.time
    screen.send(beyond(screen.packet((0.0, 0.0)), protocol))
    assert screen.first("value out of range") == begin
    assert screen.stream.tracker.sample.time < begin


def test_a_wrong_checksum_is_told_at_once():
    screen = FedScreen(Protocol.ELO)
    screen.roll(10, (0.0, 0.0))
    begin = screen.time
    packet = screen.packet((0.0, 0.0))
    screen.send(packet[:-1] + bytes([packet[-1] ^ 1]))
    assert screen.first("checksum error") == begin


@pytest.mark.parametrize("cut", [1, 3])
def test_a_packet_cut_short_is_told_within_the_stated_time(screen, cut):
    place = screen.roll(10, (0.0, 0.0))
    begin = screen.time
    screen.send(screen.packet(place)[:cut])
    screen.time += FRAME
    screen.roll(10, place)
    assert screen.first("bytes not understood") - begin <= WITHIN["bytes not understood"]
    assert screen.state == TouchState.TOUCHING


def test_a_pause_between_two_bursts_is_no_flood():
    stream = TouchStream(settings("microtouch", 1000.0, None))
    for time in (84_372.1, 84_372.2, 84_373.9, 84_374.0):  # 250 bytes a window are allowed
        stream.take(time, bytes(100))
    assert "byte flood" not in [fault.condition.name for fault in stream.faults()]
    stream.take(84_374.1, bytes(100))
    (told,) = [fault for fault in stream.faults() if fault.condition.name == "byte flood"]
    assert told.detail == "300 bytes within 0.25 s"


def test_a_flood_is_told_within_the_stated_time_and_costs_bounded_work(screen):
    screen.roll(10, (0.0, 0.0))
    begin = screen.time
    noise = np.random.default_rng(3)
    for _ in range(100):
        screen.send(noise.bytes(1000))
        screen.time += 0.005
    assert screen.first("byte flood") - begin <= WITHIN["byte flood"]
    assert screen.stream.stats.bytes <= 100 * TouchStream.MOST + 10 * 25
    assert screen.stream.heard - screen.stream.stats.bytes == 100 * (1000 - TouchStream.MOST)


@pytest.mark.parametrize("protocol", ["auto", "elo", "hid-0006"])
def test_bytes_of_no_protocol_are_told_within_the_stated_time(protocol):
    screen, noise = FedScreen(protocol), np.random.default_rng(4)
    for _ in range(100):
        screen.send(noise.bytes(10))
        screen.time += 0.02
    assert screen.first("protocol not recognised") <= WITHIN["protocol not recognised"]


@pytest.mark.parametrize("spoken", SERIAL)
@pytest.mark.parametrize("set_to", PROTOCOLS)
def test_a_protocol_set_wrongly_is_told_with_the_one_that_is_spoken(set_to, spoken):
    screen = FedScreen(spoken)
    screen.stream = TouchStream(settings(set_to))
    screen.roll(30, (0.0, 0.05), 0.003 / FRAME)
    told = [each for each in screen.seen if each[1] == "protocol not recognised"]
    if set_to is spoken:
        assert told == []
    else:
        assert told[0][0] <= WITHIN["protocol not recognised"]
        assert told[0][2] == f"the bytes are of {spoken}, not of {set_to}"


def test_a_fault_that_lasts_is_told_twice_a_second_not_every_packet():
    screen = FedScreen(Protocol.ELO)
    screen.roll(3, (0.0, 0.0))
    for _ in range(115):
        packet = screen.packet((0.0, 0.0))
        screen.send(packet[:-1] + bytes([packet[-1] ^ 1]))
        screen.time += FRAME
    assert 3 <= screen.names.count("checksum error") <= 5


def test_a_single_false_position_at_the_start_is_not_believed(screen):
    screen.send(screen.packet((0.3, 0.1)))
    screen.time += FRAME
    assert screen.stream.tracker.sample is None
    screen.roll(5, (0.0, 0.0))
    assert screen.stream.tracker.sample.position == pytest.approx((0.0, 0.0), abs=2e-4)


def test_false_positions_far_apart_in_time_do_not_confirm_each_other(screen):
    for _ in range(6):
        screen.send(screen.packet((0.3, 0.1)))
        screen.time += 0.08
    assert screen.stream.tracker.sample is None


@pytest.mark.short("auto", "elo", "hid-timed")
@given(data=st.lists(st.tuples(st.binary(max_size=80), st.floats(0, 0.3)), max_size=12))
@pytest.mark.parametrize("protocol", ["auto", *PROTOCOLS])
def test_whatever_bytes_come_no_position_is_off_the_screen(protocol, data):
    stream = TouchStream(settings(protocol, 1000.0))
    time = 0.0
    for portion, pause in data:
        time += pause
        stream.take(time, portion)
        if stream.tracker.sample is not None:
            x, y = stream.tracker.sample.position
            assert abs(x) <= SCREEN_SIZE_M[0] / 2 + 1e-12
            assert abs(y) <= SCREEN_SIZE_M[1] / 2 + 1e-12
    stream.faults()


def test_two_contacts_are_told_with_the_second_report_of_them_and_again_when_they_come_again():
    screen = FedScreen()
    screen.roll(10, (0.0, 0.0))
    for _ in range(2):
        begin, before = screen.time, screen.names.count("two contacts")
        for number in range(2):
            screen.send(screen.packet((0.0, 0.0), (0.3, 0.1)))
            assert screen.names.count("two contacts") == before + number
            screen.time += FRAME
        assert screen.seen[-1][0] == pytest.approx(begin + FRAME)
        # the finger goes without a lift-off: after the stale time it no longer counts
        screen.roll(8, (0.0, 0.0))
    assert set(screen.names) == {"two contacts"}


@pytest.mark.parametrize(("beyond_mm", "refused"), [(-1.0, False), (1.0, True)])
def test_a_ball_moves_by_its_slack_and_its_fastest_speed_and_not_a_millimetre_further(
    beyond_mm, refused
):
    screen = FedScreen()
    screen.roll(10, (-0.2, 0.0))
    way = screen.limits.slack + screen.limits.speed * FRAME + 1e-3 * beyond_mm
    screen.send(screen.packet((-0.2 + way, 0.0)))
    assert ("position jumped" in screen.names) == refused


def test_half_a_packet_is_given_up_after_the_decoder_s_patience_without_another_byte():
    screen = FedScreen(Protocol.ELO)
    screen.roll(10, (0.0, 0.0))
    begin = screen.time
    screen.send(screen.packet((0.0, 0.0))[:4])
    screen.wait(0.08)
    patience = screen.stream.decoder.patience
    assert patience < screen.first("bytes not understood") - begin <= patience + 0.0021


def test_a_ball_is_believed_with_its_third_report_in_a_row():
    screen = FedScreen()
    for _ in range(3):
        assert screen.stream.tracker.sample is None
        screen.roll(1, (0.1, 0.0))
    assert screen.stream.tracker.sample.position == pytest.approx((0.1, 0.0), abs=2e-4)


def test_a_ball_that_comes_back_under_another_number_is_the_ball():
    screen = FedScreen()
    screen.roll(10, (0.0, 0.0))
    screen.wait(0.08)  # gone without a lift-off
    x, y = CALIBRATION.screen(0.0, 0.0)
    for _ in range(3):
        screen.send(b"".join(PACKET_ENCODERS[screen.protocol]([Spot(x, y, 7)])))
        screen.time += FRAME
    assert screen.names == ["touch stale", "brief dropout"]
    assert screen.stream.tracker.sample.time == pytest.approx(screen.time - FRAME)


def test_a_jump_to_a_place_that_is_a_little_nearer_with_its_axes_swapped_is_a_jump():
    screen = FedScreen()
    here, turned = (0.07, 0.0), (0.14, 0.0)
    x, y = CALIBRATION.screen(*turned)
    there = CALIBRATION.plate(y, x)
    assert math.dist(here, there) / 2 < math.dist(here, turned) < math.dist(here, there)
    screen.roll(10, here)
    screen.roll(5, there)
    assert "position jumped and stayed" in screen.names
    assert "axes swapped" not in screen.names


def test_the_lift_off_of_another_contact_is_not_that_of_the_ball():
    screen = FedScreen()
    screen.roll(10, (0.0, 0.0))
    x, y = CALIBRATION.screen(0.0, 0.0)
    finger = CALIBRATION.screen(0.3, 0.1)
    for down in (True, True, False):
        screen.send(
            b"".join(PACKET_ENCODERS[screen.protocol]([Spot(x, y, 1), Spot(*finger, 2, down)]))
        )
        screen.time += FRAME
    screen.send(b"".join(PACKET_ENCODERS[screen.protocol]([Spot(*finger, 2, False)])))
    assert screen.state == TouchState.TOUCHING
    screen.roll(5, (0.0, 0.0))
    assert screen.names == ["two contacts"]


def test_axes_that_were_swapped_for_a_moment_leave_nothing_behind(screen):
    screen.roll(10, (0.2, 0.0))
    x, y = CALIBRATION.screen(0.2, 0.0)
    screen.roll(4, CALIBRATION.plate(y, x))
    screen.roll(10, (0.2, 0.0))
    screen.wait(0.2)
    screen.roll(10, (0.1, 0.0))
    assert screen.state == TouchState.TOUCHING
    screen.roll(4, CALIBRATION.plate(*CALIBRATION.screen(0.1, 0.0)[::-1]))
    assert screen.names.count("axes swapped") == 2
