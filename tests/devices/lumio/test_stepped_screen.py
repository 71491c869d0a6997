"""`twin.devices.lumio.screen`.

The screen as the loop asks it, in made-up time: what is felt, its age, what is reported."""

import math

import numpy as np
import pytest

from twin.devices.lumio import conditions as c
from twin.devices.lumio.config import LumioConfig, PlausibilityLimits, ScreenError
from twin.devices.lumio.screen import TouchState
from twin.emulator.lockstep import LockstepScreen, LockstepScreenPort
from twin.emulator.screen import Protocol, ScreenFault, ScreenLine

GATE = PlausibilityLimits()
TICK = 0.001


class Stepped:
    """A screen on a line in made-up time, asked once per ms; a ball at ``balls``."""

    def __init__(self, protocol=Protocol.HID_0007):
        self.time, self.balls = 5.0, [(0.1, -0.05)]
        self.line = ScreenLine(lambda: self.balls, protocol=protocol, dead_time=0.01)
        self.port = LockstepScreenPort(self.line, lambda: self.time)
        config = LumioConfig(port="emulated", transport="hidraw", protocol=str(protocol))
        self.screen = LockstepScreen(config, lambda: self.time, port=self.port)
        self.screen.start()
        self.plate, self.seen = np.zeros((1, 2)), []

    def run(self, seconds):
        """Let time pass; what was read last."""
        for _ in range(round(seconds / TICK)):
            self.time += TICK
            touch = self.screen.read()
            self.screen.note_plate(self.plate)
            self.seen += [(self.time, each) for each in self.screen.faults()]
        return touch

    @property
    def conditions(self):
        return [fault.condition for _, fault in self.seen]


@pytest.fixture
def stepped():
    return Stepped()


def test_before_the_first_report_nothing_is_felt_and_its_age_is_infinite(stepped):
    touch = stepped.screen.read()
    assert (touch.age.tolist(), touch.touched.tolist()) == ([math.inf], [False])
    assert stepped.screen.state is TouchState.LOST


def test_a_ball_is_felt_where_it_lies_for_exactly_the_stale_time_after_its_last_report(stepped):
    stepped.run(0.2)
    arrived = stepped.screen.stream.tracker.sample.time
    stepped.balls = []
    stepped.line.damage.inject(ScreenFault.DROPOUT, 1e9)
    while stepped.time - arrived < GATE.stale + 0.05:
        touch = stepped.run(TICK)
        arrived = max(arrived, stepped.screen.stream.tracker.sample.time)
        age = stepped.time - arrived
        assert touch.age[0] == pytest.approx(age)
        assert bool(touch.touched[0]) == (age <= GATE.stale)
        np.testing.assert_allclose(touch.position, [(0.1, -0.05)], atol=3e-4)


@pytest.mark.parametrize("lift", [True, False])
def test_a_ball_that_goes_is_lost_after_the_lost_time_and_reported_once(stepped, lift):
    stepped.run(0.2)
    if not lift:
        stepped.line.damage.inject(ScreenFault.MISSING_PEN_UP, 1e9)
    stepped.balls = []
    stepped.run(0.03)
    last = stepped.screen.stream.tracker.sample.time
    stepped.run(0.5)
    lost = [time for time, fault in stepped.seen if fault.condition is c.TOUCH_LOST]
    assert len(lost) == 1
    assert GATE.lost < lost[0] - last <= GATE.lost + 1.5 * TICK
    stale = [time for time, fault in stepped.seen if fault.condition is c.STALE]
    assert len(stale) == (0 if lift else 1)
    assert lift or GATE.stale < stale[0] - last <= GATE.stale + 1.5 * TICK


@pytest.mark.parametrize("angle", [(0.05, 0.0), (0.0, 0.05), (-0.05, 0.0), (0.0, -0.05)])
def test_a_ball_that_rests_on_a_plate_tilted_either_way_about_either_axis_is_frozen(stepped, angle):
    stepped.run(0.2)
    begin = stepped.time
    stepped.plate = np.array([angle])
    stepped.run(0.6)
    (found,) = [time for time, fault in stepped.seen if fault.condition is c.TOUCH_FROZEN]
    assert GATE.rest < found - begin <= GATE.rest + 2 * TICK


@pytest.mark.parametrize(("deg", "frozen"), [(1.9, False), (2.1, True)])
def test_from_two_degrees_on_no_ball_rests(stepped, deg, frozen):
    stepped.run(0.2)
    stepped.plate = np.radians([[0.0, deg]])
    stepped.run(0.6)
    assert (c.TOUCH_FROZEN in stepped.conditions) == frozen


def test_a_port_that_goes_is_reported_once_and_left_alone_until_it_is_started_anew(stepped):
    stepped.run(0.2)
    stepped.port.plugged = False
    stepped.run(0.01)
    (fault,) = [fault for _, fault in stepped.seen]
    assert (fault.condition, fault.detail) == (c.UNPLUGGED, "hung up; was it unplugged?")
    assert not stepped.screen.connected
    assert stepped.screen.listen() == 0
    stepped.port.plugged = True
    assert not stepped.run(0.3).touched[0]
    assert not stepped.screen.connected
    stepped.screen.start()
    assert stepped.run(0.3).touched[0]


def test_a_port_that_is_absent_refuses_the_start():
    stepped = Stepped()
    stepped.port.plugged = False
    with pytest.raises(ScreenError):
        stepped.screen.start()


def test_listening_says_how_many_bytes_came(stepped):
    counts = []
    for _ in range(200):
        stepped.time += TICK
        counts.append(stepped.screen.listen())
    assert set(counts) == {0, 8}
    assert sum(counts) == stepped.screen.stream.heard


def test_the_newest_bytes_of_a_reading_are_those_that_are_decoded(stepped):
    stepped.run(0.2)
    stream = stepped.screen.stream
    x, y = stream.tracker.calibration.screen(0.105, -0.05)
    newest = b"\x31\x00" + b"".join(round(v * 32767).to_bytes(2, "little") for v in (x, y))
    stream.take(stepped.time, bytes(8 * 100) + newest + b"\x01\x00")
    assert stream.tracker.sample.position == pytest.approx((0.105, -0.05), abs=3e-4)


def test_a_hint_says_what_to_change_as_long_as_there_is_no_position(stepped):
    assert stepped.screen.hint.startswith("nothing heard")
    stepped.screen.stream.take(stepped.time, b"\x31\x00\x80")
    assert stepped.screen.hint.startswith("3 bytes heard, of no known protocol")
    stepped.run(0.2)
    assert stepped.screen.hint == ""
    assert stepped.screen.protocol == "hid"
