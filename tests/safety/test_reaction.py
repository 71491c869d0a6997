"""`twin.safety.reaction`: Who stopped a rig and when it stood, from motions written down here."""

import numpy as np
import pytest

from twin.emulator.lockstep import PowerChange, TrueMotion
from twin.emulator.power_stage import MASTER_SILENT, STO_FAULT, UNDERVOLTAGE_FAULT, Power
from twin.safety.limits import LEVEL_RAD, Stopper
from twin.safety.reaction import reaction

ENABLED, QUICK, OFF = Power.OPERATION_ENABLED, Power.QUICK_STOP, Power.SWITCH_ON_DISABLED
TIME = np.arange(1.0, 3.0, 0.0005)


class Seen:
    """A motion and what the power stages did, in place of a trace."""

    def __init__(self, plate, rate, changes=(), *, live=False):
        columns = np.zeros((len(TIME), 2))
        self.live = live
        self.changes = [PowerChange(*each) for each in changes]
        self._plate, self._rate = columns + plate[:, None], columns + rate[:, None]
        self._ball = columns + np.linspace(0.0, 0.2, len(TIME))[:, None]

    def between(self, begin, end):
        at = (begin <= TIME) & (end >= TIME)
        parts = (TIME, self._plate, self._rate, self._ball)
        return TrueMotion(*(part[at] for part in parts))

    def state(self, axis, time):
        return ENABLED


def change(time, axis, before, after, *, lost=False, fault=0, injected=False):
    return time, axis, before, after, lost, fault, injected


def both(time, before, after, **more):
    return [change(time, axis, before, after, **more) for axis in (0, 1)]


def react(seen, *, ended=True, level=False, within=np.inf):
    return reaction(seen, 1.0, 3.0, within=within, ended=ended, level=level)


def moving(until):
    """Tilted by 0.03 rad, turning by 0.05 rad/s until a time."""
    return np.full_like(TIME, 0.03), np.where(until > TIME, 0.05, 0.0)


def test_standstill_is_the_end_of_the_last_motion_not_of_the_first():
    plate, rate = moving(1.1)
    rate = np.where((TIME > 1.7) & (TIME < 1.8), -0.05, rate)
    assert react(Seen(plate, rate)).standstill == pytest.approx(0.8, abs=0.001)


def test_a_plate_that_moves_to_the_end_does_not_stand():
    assert react(Seen(*moving(9.0))).standstill is None


def test_a_plate_at_rest_but_tilted_does_not_stand_where_it_must_be_level():
    seen = Seen(*moving(1.1))
    assert react(seen).standstill == pytest.approx(0.1, abs=0.001)
    assert react(seen, level=True).standstill is None


def test_a_plate_that_is_level_while_its_drives_have_torque_was_levelled():
    plate = np.where(TIME < 1.3, 0.03, LEVEL_RAD / 2)
    stops = both(1.5, ENABLED, QUICK) + both(1.5, QUICK, OFF, lost=True)
    found = react(Seen(plate, np.zeros_like(TIME), stops), level=True)
    assert found.stopped_by == (Stopper.LEVELLING, Stopper.LEVELLING)
    assert found.state == ("operation enabled", "operation enabled")
    assert found.standstill == pytest.approx(0.3, abs=0.001)
    assert found.torque_off == pytest.approx(0.5, abs=0.001)


def test_a_plate_level_only_after_its_torque_went_was_not_levelled():
    plate = np.where(TIME < 1.3, 0.03, 0.0)
    stops = both(1.2, ENABLED, QUICK) + both(1.2, QUICK, OFF, lost=True)
    found = react(Seen(plate, np.zeros_like(TIME), stops))
    assert found.stopped_by == (Stopper.QUICK_STOP, Stopper.QUICK_STOP)
    assert found.state == ("switch on disabled", "switch on disabled")


@pytest.mark.parametrize(
    ("changes", "stopper"),
    [
        ([(ENABLED, QUICK, {}), (QUICK, OFF, {"lost": True})], Stopper.QUICK_STOP),
        ([(ENABLED, QUICK, {"injected": True})], Stopper.DRIVE),
        ([(ENABLED, OFF, {"lost": True, "injected": True})], Stopper.LOST_TORQUE),
        ([(ENABLED, Power.FAULT, {"lost": True, "fault": MASTER_SILENT})], Stopper.HEARTBEAT),
        ([(ENABLED, Power.FAULT, {"lost": True, "fault": STO_FAULT})], Stopper.STO),
        (
            [(ENABLED, Power.FAULT, {"lost": True, "fault": UNDERVOLTAGE_FAULT})],
            Stopper.LOST_TORQUE,
        ),
        ([(ENABLED, Power.FAULT_REACTION, {"fault": 235, "injected": True})], Stopper.DRIVE),
        ([], Stopper.NOBODY),
        # what stops it counts, not what comes of it later
        (
            [
                (ENABLED, QUICK, {}),
                (QUICK, OFF, {"lost": True}),
                (OFF, Power.FAULT, {"fault": 129}),
            ],
            Stopper.QUICK_STOP,
        ),
    ],
)
def test_an_axis_is_stopped_by_whoever_takes_its_drive_out_of_operation(changes, stopper):
    steps = [change(1.1, 1, before, after, **more) for before, after, more in changes]
    assert react(Seen(*moving(1.1), steps)).stopped_by == (Stopper.NOBODY, stopper)


def test_the_torque_is_gone_when_the_last_drive_has_lost_it():
    plate, rate = moving(1.1)
    one = change(1.1, 0, QUICK, OFF, lost=True)
    assert react(Seen(plate, rate, [one])).torque_off is None
    other = change(1.4, 1, QUICK, OFF, lost=True)
    assert react(Seen(plate, rate, [one, other])).torque_off == pytest.approx(0.4)


def test_nobody_levels_a_run_that_goes_on():
    seen = Seen(np.zeros_like(TIME), np.zeros_like(TIME), live=True)
    assert react(seen, ended=False).stopped_by == (Stopper.NOBODY, Stopper.NOBODY)
    assert react(seen, ended=False).torque


def test_the_ball_is_followed_as_far_as_is_asked_and_to_the_end():
    found = react(Seen(*moving(1.1)), within=0.5)
    assert found.ball == pytest.approx((0.05, 0.05), abs=1e-3)
    assert found.ball_later == pytest.approx((0.2, 0.2), abs=1e-3)
