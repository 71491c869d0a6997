import struct

import pytest

from twin.devices.lumio.calibration import Calibration
from twin.devices.lumio.evdev import Evdev
from twin.devices.lumio.gate import Gate
from twin.devices.lumio.intake import Intake
from twin.devices.lumio.presence import TouchState, state

# Codes of linux/input-event-codes.h.
SYN, ABS = 0, 3
SLOT, X, Y, TRACKING = 0x2F, 0x35, 0x36, 0x39


def events(*triples):
    return b"".join(struct.pack("@llHHi", 12, 340_000, *triple) for triple in triples)


TOUCH = events((ABS, TRACKING, 7), (ABS, X, 16384), (ABS, Y, 8192), (SYN, 0, 0))


def test_a_touch_is_reported_when_its_frame_ends():
    ((contact,),) = Evdev().feed(TOUCH)
    assert (contact.x, contact.y, contact.down) == (16384 / 32767, 8192 / 32767, True)


def test_a_value_that_is_not_sent_again_has_not_changed():
    decoder = Evdev()
    decoder.feed(TOUCH)
    ((contact,),) = decoder.feed(events((ABS, X, 0), (SYN, 0, 0)))
    assert (contact.x, contact.y) == (0.0, 8192 / 32767)


def test_a_tracking_id_of_minus_one_is_a_lift_off():
    decoder = Evdev()
    decoder.feed(TOUCH)
    ((contact,),) = decoder.feed(events((ABS, TRACKING, -1), (SYN, 0, 0)))
    assert not contact.down


def test_two_slots_are_two_contacts():
    decoder = Evdev()
    second = ((ABS, SLOT, 1), (ABS, TRACKING, 8), (ABS, X, 1), (ABS, Y, 2), (SYN, 0, 0))
    decoder.feed(TOUCH)
    ((contact,),) = decoder.feed(events(*second))
    assert contact.id == 2


def test_a_value_beyond_the_range_is_counted_and_refused():
    decoder = Evdev()
    assert decoder.feed(events((ABS, TRACKING, 7), (ABS, X, -5), (ABS, Y, 0), (SYN, 0, 0))) == []
    assert decoder.tally.outside == 1


@pytest.mark.parametrize(("lift", "then"), [(False, "touching"), (True, "lost")])
def test_a_ball_at_rest_that_sends_nothing_still_touches_until_it_is_lifted_off(lift, then):
    gate = Gate()
    intake = Intake("evdev", 1e5, Calibration.nominal(), gate)
    for frame in range(5):
        move = events((ABS, X, 16384 + 8 * frame), (SYN, 0, 0))
        intake.take(0.017 * frame, TOUCH + move)
    if lift:
        intake.take(0.09, events((ABS, TRACKING, -1), (SYN, 0, 0)))
    assert state(gate, intake.sample, 5.0, silent=True) == TouchState(then)
