"""`twin.devices.lumio.scan_time`.

Scan times: reports that are no new ones, and reports that come ever later."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.devices.lumio import conditions as c
from twin.devices.lumio.config import Calibration, LumioConfig
from twin.devices.lumio.protocols import HidDecoder, TouchLayout, decoder_of
from twin.devices.lumio.scan_time import ScanClock, ScanTime
from twin.devices.lumio.screen import TouchStream
from twin.emulator.screen import Spot, hid_timed

FRAME, WRAP = 0.01736, 6.5536
CALIBRATION = Calibration.nominal()


class Panel:
    """A stream fed by hand with a ball that rolls to and fro, and what it has reported."""

    def __init__(self, start=0.0):
        self.stream = TouchStream(
            LumioConfig(port="", transport="hidraw", protocol="hid-timed", calibration=CALIBRATION)
        )
        self.time, self.x, self.seen = start, 0.0, []

    def send(self, scan, *, ids=(1,), down=True):
        """A report now, scanned at a time in s."""
        x, y = CALIBRATION.screen(self.x, 0.0)
        data = hid_timed([Spot(x, y, each, down) for each in ids], round(scan / 1e-4))
        self.stream.take(self.time, b"".join(data))
        self.stream.tracker.watch(self.time)
        self.seen += [(self.time, each.condition, each.detail) for each in self.stream.faults()]

    def roll(self, seconds, scan=lambda now: now, frame=FRAME):
        """Frames for some time; scan: when that of a time was scanned."""
        for _ in range(round(seconds / frame)):
            self.send(scan(self.time))
            self.time += frame
            self.x = 0.2 * math.sin(0.5 * self.time)

    @property
    def names(self):
        return {condition.name for _, condition, _ in self.seen}


@pytest.fixture
def panel():
    return Panel()


def test_the_field_is_found_by_its_usage_and_read_in_the_unit_that_the_descriptor_gives():
    ((first,),) = decoder_of("hid-timed").feed(b"".join(hid_timed([Spot(0.5, 0.5)], 43_210)))
    assert first.down
    (report,) = decoder_of("hid-timed").feed(b"".join(hid_timed([Spot(0.5, 0.5)], 43_210)))
    assert report.scan == pytest.approx((4.3210, WRAP))


@pytest.mark.parametrize(
    ("replaced", "by", "tick"),
    [
        ("550c660110", "550d660110", 1e-3),  # 10^-3 s
        ("550c660110", "5500650000", 1e-4),  # no unit: 100 us, as the usage tables have it
    ],
)
def test_another_unit_is_another_tick(descriptors, replaced, by, tick):
    other = descriptors["hid-timed"].replace(bytes.fromhex(replaced), bytes.fromhex(by))
    assert other != descriptors["hid-timed"]
    (report,) = HidDecoder(TouchLayout.of(other)).feed(b"".join(hid_timed([Spot(0, 0)], 1000)))
    assert report.scan == pytest.approx((1000 * tick, 65536 * tick))


@pytest.mark.parametrize("name", ["hid-0006", "hid-0007"])
def test_a_panel_without_a_scan_time_has_none(descriptors, name):
    assert TouchLayout.of(descriptors[name]).scan is None


def test_the_reports_that_go_on_with_a_frame_have_no_scan_time_of_their_own():
    spots = [Spot(0.1, 0.1, each) for each in (1, 2, 3)]
    first, second = decoder_of("hid-timed").feed(b"".join(hid_timed(spots, 7)))
    assert (len(first), first.scan.time) == (2, pytest.approx(7e-4))
    assert (len(second), second.scan) == (1, None)


def test_a_healthy_panel_says_nothing_over_several_wraps(panel):
    panel.roll(4 * WRAP)
    assert panel.seen == []
    assert panel.stream.tracker.state(panel.time) == "touching"


def test_a_counter_that_begins_anywhere_is_no_fault():
    for start in (0.0, 6.55, 3.0):
        panel = Panel()
        panel.roll(1.5 * WRAP, lambda now, start=start: now + start)
        assert panel.seen == []


def test_reports_of_one_scan_time_are_refused_and_named_after_three_repeats(panel):
    panel.roll(2.0)
    still = panel.time - FRAME
    at = panel.stream.tracker.sample.position
    begin = panel.time
    panel.roll(0.09, lambda _: still)
    when, condition, detail = panel.seen[0]
    assert condition is c.SCAN_STILL
    assert float(detail.split()[0]) == pytest.approx(still, abs=1e-4)
    assert when - begin == pytest.approx(2 * FRAME)  # the third repeat
    assert panel.stream.tracker.sample.position == at
    assert panel.stream.tracker.sample.time == pytest.approx(begin - FRAME)


def test_one_report_that_comes_twice_is_refused_and_no_fault(panel):
    panel.roll(1.0)
    taken = panel.stream.tracker.sample
    panel.send(panel.time - FRAME)
    assert panel.stream.tracker.sample == taken
    panel.roll(0.5)
    assert panel.seen == []


@pytest.mark.parametrize("length", [2, 3, 10, 100])
def test_the_last_reports_sent_again_in_turn_are_refused_and_named(panel, length):
    panel.roll(3.0)
    begin = panel.time
    old = [begin - FRAME * (length - number) for number in range(length)]
    for number in range(12):
        panel.roll(FRAME, lambda _, number=number: old[number % length])
    when, condition, _ = panel.seen[0]
    assert condition is c.SCAN_STILL
    assert when - begin <= c.SCAN_STILL.within
    assert panel.stream.tracker.sample.time == pytest.approx(begin - FRAME)


def test_a_counter_that_begins_anew_after_a_lift_off_is_followed(panel):
    panel.roll(1.0)
    panel.time += 0.065
    begin = panel.time
    panel.roll(1.0, lambda now: now - begin)
    assert c.SCAN_STILL.name not in panel.names
    assert panel.stream.tracker.sample.time == pytest.approx(panel.time - FRAME)


def test_a_counter_that_counts_down_is_no_clock(panel):
    panel.roll(1.0, lambda now: 5.0 - now)
    assert panel.seen == []
    assert panel.stream.tracker.sample.time == pytest.approx(panel.time - FRAME)


def test_a_counter_that_never_counts_is_no_clock(panel):
    panel.roll(2.0, lambda _: 1.0)
    assert panel.seen == []
    assert panel.stream.tracker.sample.time == pytest.approx(panel.time - FRAME)


def test_a_lift_off_is_taken_whatever_its_scan_time(panel):
    panel.roll(1.0)
    panel.send(panel.time - FRAME, down=False)
    assert panel.stream.tracker.sample.lifted


def test_contacts_of_one_frame_in_reports_of_their_own_are_all_new():
    clock = ScanClock(0.03)
    assert clock.is_new(0.00, ScanTime(0.00, WRAP), {1})
    assert clock.is_new(0.00, ScanTime(0.00, WRAP), {2})
    assert clock.is_new(0.02, ScanTime(0.02, WRAP), {1})
    assert clock.is_new(0.02, ScanTime(0.02, WRAP), {2})
    assert not clock.is_new(0.02, ScanTime(0.02, WRAP), {1})


@pytest.mark.parametrize("growth", [0.1, 0.2, 0.5, 2.0])
def test_reports_that_come_ever_later_are_noticed(panel, growth):
    """Seconds per second; scanned when they should have been, they arrive later and later."""
    panel.roll(2.0)
    begin, behind = panel.time, []

    def scan(now):
        behind.append((now - begin) * growth / (1 + growth))
        return now - behind[-1]

    panel.roll(1.5, scan)
    when = next(time for time, condition, _ in panel.seen if condition is c.TOUCH_LATE)
    shows = begin + 0.03 * (1 + growth) / growth
    # the growth that a counter is allowed, two hundredths, delays it
    allowed = c.TOUCH_LATE.within + FRAME + 0.03 * 0.02 / growth**2
    assert 0.1 <= when - shows + FRAME <= allowed


@pytest.mark.parametrize("drift", [-0.02, 0.018])
def test_a_counter_that_is_as_inexact_as_allowed_is_never_late(panel, drift):
    panel.roll(20.0, lambda now: now * (1 + drift))
    assert panel.seen == []


@pytest.mark.parametrize("factor", [0.1, 0.5, 10.0])
def test_a_counter_in_another_unit_than_it_says_is_not_used_for_lateness(panel, factor):
    panel.roll(5.0, lambda now: now * factor)
    assert panel.seen == []


def test_a_hiccup_of_the_host_is_not_lateness(panel):
    panel.roll(2.0)
    scans = [panel.time + number * FRAME for number in range(4)]
    panel.time += 0.08  # reports have waited meanwhile, and come at once
    for scan in scans:
        panel.send(scan)
    panel.time += 0.01
    panel.roll(1.0)
    assert c.TOUCH_LATE.name not in panel.names


def test_reports_that_stay_late_for_less_than_the_time_are_no_fault(panel):
    panel.roll(2.0)
    panel.roll(0.08, lambda now: now - 0.05)
    panel.roll(1.0)
    assert c.TOUCH_LATE.name not in panel.names


def test_a_panel_may_count_anew_after_a_pause(panel):
    panel.roll(2.0)
    panel.time += 0.3
    begin = panel.time
    panel.roll(2.0, lambda now: now - begin)
    assert panel.names <= {c.STALE.name, c.TOUCH_LOST.name}


@given(st.lists(st.tuples(st.floats(0, 0.5), st.floats(0, WRAP), st.integers(0, 3)), max_size=60))
def test_any_scan_times_are_taken(steps):
    clock, time = ScanClock(0.03), 0.0
    for passed, scan, contact in steps:
        time += passed
        clock.is_new(time, ScanTime(scan, WRAP), {contact})
        assert clock.excess >= 0
        assert clock.stands_still in {True, False}


def test_a_counter_that_stands_still_during_a_pause_is_not_late_afterwards(panel):
    panel.roll(3.0)
    panel.time += 0.3
    panel.roll(3.0, lambda now: now - 0.3)
    assert panel.names <= {c.STALE.name, c.TOUCH_LOST.name}


@pytest.mark.parametrize("drift", [-0.015, 0.015])
def test_lateness_is_noticed_by_a_counter_that_is_as_inexact_as_allowed(panel, drift):
    panel.roll(3.0, lambda now: now * (1 + drift))
    begin = panel.time
    panel.roll(1.0, lambda now: (now - 0.3 * (now - begin)) * (1 + drift))
    assert c.TOUCH_LATE in [condition for _, condition, _ in panel.seen]
