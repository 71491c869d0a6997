"""`twin.hal.supervisor`: Any sequence of events, against the table read as sentences."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from twin.devices.akd.conditions import DRIVE_CONDITIONS
from twin.devices.common import FaultReports
from twin.devices.lumio.conditions import SCREEN_CONDITIONS, TOUCH_LOST
from twin.hal.interface import Clamp, Condition, Fault, Limits, Severity
from twin.hal.supervisor import (
    BALL_OUTSIDE,
    PLATE_TILTED,
    RIG_CONDITIONS,
    TRANSITIONS,
    Event,
    State,
    Supervisor,
)

PERIOD = 0.002
LIMITS = Limits()
MOVING = {State.RUNNING, State.HOLDING}
numbers = st.floats(-50, 50) | st.sampled_from([np.nan, np.inf, -np.inf])
pairs = st.tuples(numbers, numbers)
WISHES = arrays(float, (20, 2, 2), elements=st.floats(-50, 50))


def fault(severity):
    return Fault(Condition("test", severity, 0.0, "", ""), "device", "detail")


def running(limits=LIMITS, rigs=1, plate=(0.0, 0.0)):
    supervisor = Supervisor(limits, PERIOD, rigs)
    supervisor.handle(Event.INITIALISE)
    supervisor.powered(np.tile(plate, (rigs, 1)))
    supervisor.handle(Event.START)
    return supervisor


class AnyEvents(RuleBasedStateMachine):
    """What may happen to one rig, in any order, with the promises checked after each step."""

    def __init__(self):
        super().__init__()
        self.supervisor = Supervisor(LIMITS, PERIOD)
        self.rate = np.zeros((1, 2))
        self.asked = False
        self.resting = 0

    @property
    def state(self):
        return State(self.supervisor.state[0])

    @rule()
    def initialise(self):
        self.supervisor.handle(Event.INITIALISE)

    @rule(plate=st.tuples(st.floats(-0.17, 0.17), st.floats(-0.17, 0.17)))
    def powered(self, plate):
        if self.state is State.INITIALISING:
            self.rate = np.zeros((1, 2))
        self.supervisor.powered(np.array([plate]))

    @rule()
    def start(self):
        self.asked = self.asked or self.state is State.READY
        self.supervisor.handle(Event.START)

    @rule()
    def switch_off(self):
        self.supervisor.handle(Event.SWITCH_OFF)
        self.asked = self.asked and self.state is State.RUNNING

    @rule(severity=st.sampled_from(Severity))
    def device(self, severity):
        before = self.state
        self.supervisor.report(fault(severity))
        if severity is Severity.STOP and before is not State.OFF:
            assert self.state is State.FAULT
            assert not self.supervisor.clamp(np.full((1, 2), 0.01)).any()
        if severity is Severity.LEVEL and before is State.RUNNING:
            assert self.state is State.HOLDING
        if severity is Severity.WARNING:
            assert self.state is before

    @rule(
        ball=st.tuples(st.floats(-0.4, 0.4), st.floats(-0.25, 0.25)),
        plate=st.tuples(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2)),
        touched=st.booleans(),
    )
    def watch(self, ball, plate, touched):
        y = np.array([[ball[0], plate[0], ball[1], plate[1]]])
        before = self.state
        self.supervisor.watch(y, np.array([touched]))
        outside = abs(ball[0]) > 0.29 or abs(ball[1]) > 0.19
        if before is State.RUNNING and outside:
            assert self.state is State.HOLDING

    @rule(wish=pairs, times=st.integers(1, 30))
    def command(self, wish, times):
        for _ in range(times):
            rate = self.supervisor.clamp(np.array([wish]))
            dead = self.state not in MOVING and self.state is not State.READY
            if dead:
                assert not rate.any()
            else:
                step = LIMITS.acceleration * PERIOD + 1e-12
                assert (np.abs(rate - self.rate) <= step).all()
            assert (np.abs(rate) <= LIMITS.rate + 1e-12).all()
            self.rate = rate

    @precondition(lambda self: self.state is State.HOLDING)
    @rule()
    def hold_long(self):
        for _ in range(1000):
            self.rate = self.supervisor.clamp(np.full((1, 2), np.nan))
        assert np.abs(self.rate).max() < 1e-3

    @invariant()
    def only_an_asked_for_start_lets_the_controller_move_the_plate(self):
        if self.state is State.RUNNING:
            assert self.asked

    @invariant()
    def the_fast_path_is_taken_only_while_running(self):
        assert self.supervisor.all_running == (self.state is State.RUNNING)

    @invariant()
    def a_reason_is_there_whenever_a_rig_was_stopped(self):
        if self.state is State.FAULT:
            assert self.supervisor.reason[0]


TestAnyEvents = AnyEvents.TestCase
TestAnyEvents.settings = settings(max_examples=30, stateful_step_count=30)


def test_every_state_can_be_left_and_every_one_reached():
    assert {before for before, _ in TRANSITIONS} == set(State)
    assert set(TRANSITIONS.values()) == set(State)


@pytest.mark.parametrize("state", [State.HOLDING, State.FAULT])
def test_whoever_was_stopped_can_only_be_switched_off(state):
    ways = {key[1]: after for key, after in TRANSITIONS.items() if key[0] is state}
    ways.pop(Event.STOP, None)
    assert ways == {Event.SWITCH_OFF: State.OFF}


def test_a_new_start_forgets_why_the_last_run_was_stopped():
    supervisor = Supervisor(LIMITS, PERIOD)
    supervisor.handle(Event.INITIALISE)
    supervisor.report(fault(Severity.STOP))
    assert supervisor.reason[0]
    assert supervisor.by_device[0]
    supervisor.handle(Event.SWITCH_OFF)
    supervisor.handle(Event.INITIALISE)
    assert not supervisor.reason[0]
    assert not supervisor.by_device[0]


@pytest.mark.parametrize("condition", [*SCREEN_CONDITIONS, *DRIVE_CONDITIONS], ids=lambda c: c.name)
def test_no_behaviour_hangs_on_the_words_of_a_condition(condition):
    answers = []
    for each in (condition, condition._replace(name="renamed", recovery="", reaction="")):
        supervisor = running()
        supervisor.report(Fault(each, "device", "detail"))
        reports = FaultReports(repeat=1.0)
        reports.report(each, "device", "detail", 0.0)
        answers.append((supervisor.state[0], supervisor.by_device[0], bool(reports.stopping)))
    assert answers[0] == answers[1]
    assert not supervisor.by_device[0] or condition is not TOUCH_LOST


def test_an_event_changes_only_the_rigs_it_is_meant_for():
    supervisor = running(rigs=3)
    supervisor.report(fault(Severity.STOP), rig=1)
    assert supervisor.state.tolist() == [State.RUNNING, State.FAULT, State.RUNNING]
    rate = supervisor.clamp(np.full((3, 2), 0.01))
    assert rate.tolist() == [[0.01, 0.01], [0.0, 0.0], [0.01, 0.01]]


def test_a_ball_no_longer_felt_is_lost_after_a_tenth_of_a_second():
    supervisor = running()
    for _ in range(49):
        supervisor.watch(np.zeros((1, 4)), np.array([False]))
    assert supervisor.state[0] == State.RUNNING
    for _ in range(2):
        supervisor.watch(np.zeros((1, 4)), np.array([False]))
    assert supervisor.state[0] == State.HOLDING
    assert supervisor.lost[0]


@pytest.mark.parametrize(("speed", "state"), [(1.4, State.RUNNING), (1.6, State.HOLDING)])
def test_a_ball_faster_than_the_limit_makes_the_rig_hold(speed, state):
    supervisor = running(Limits(area=(1.0, 1.0)))
    for tick in range(60):
        y = np.array([[0.0, 0.0, speed * PERIOD * tick, 0.0]])
        supervisor.watch(y, np.array([True]))
    assert supervisor.state[0] == state


def test_where_the_ball_was_before_the_rig_was_switched_off_says_nothing_of_its_speed():
    supervisor = running()
    for _ in range(25):
        supervisor.watch(np.array([[0.1, 0.0, 0.0, 0.0]]), np.array([True]))
    supervisor.handle(Event.SWITCH_OFF)
    supervisor.handle(Event.INITIALISE)
    supervisor.powered(np.zeros((1, 2)))
    supervisor.handle(Event.START)
    for _ in range(60):
        supervisor.watch(np.array([[-0.1, 0.0, 0.0, 0.0]]), np.array([True]))
    assert supervisor.notes == []


def test_a_rig_that_begins_anew_among_others_has_lost_no_ball():
    supervisor, unfelt = running(rigs=2), np.zeros(2, bool)
    for _ in range(40):
        supervisor.watch(np.zeros((2, 4)), unfelt)
    supervisor.adopt(np.array([1]), running())
    for _ in range(12):
        supervisor.watch(np.zeros((2, 4)), unfelt)
    assert supervisor.state.tolist() == [State.HOLDING, State.RUNNING]
    for _ in range(40):
        supervisor.watch(np.zeros((2, 4)), unfelt)
    assert supervisor.state[1] == State.HOLDING


def test_the_first_reason_stays_and_what_follows_is_noted():
    supervisor = running()
    for words in ("first", "second"):
        condition = Condition("test", Severity.LEVEL, 0.0, "", "")
        supervisor.report(Fault(condition, "device", words))
    assert supervisor.reason == ["device: test: first"]
    assert [each.text for each in supervisor.notes] == [
        "device: test: first",
        "device: test: second",
    ]


def test_an_encoder_that_jumps_as_levelling_begins_allows_no_tilt_beyond_that_of_braking():
    supervisor = running()
    felt, rate = np.array([True]), float(LIMITS.rate)
    for degrees in (*[0.0] * 5, 5.0):
        supervisor.watch(np.array([[0.0, np.radians(degrees), 0.0, 0.0]]), felt)
    supervisor.handle(Event.LEVEL)
    begun = np.radians(5.0)
    supervisor.watch(np.array([[0.0, begun, 0.0, 0.0]]), felt)
    way = rate * supervisor._late + rate**2 / (2 * LIMITS.acceleration)
    most = begun + way + Supervisor.MAX_FURTHER_TILT_RAD
    for tilt, state in ((most - 1e-6, State.HOLDING), (most + 1e-6, State.FAULT)):
        supervisor.watch(np.array([[0.0, tilt, 0.0, 0.0]]), felt)
        assert supervisor.state[0] == state


@settings(max_examples=60)
@given(WISHES, st.integers(1, 40))
def test_whatever_is_requested_the_commands_keep_angle_rate_and_acceleration_limits(wishes, hold):
    supervisor = running(rigs=2)
    before = np.zeros((2, 2))
    for wish in wishes:
        for _ in range(hold):
            rate = supervisor.clamp(wish)
            assert (np.abs(rate - before) <= LIMITS.acceleration * PERIOD + 1e-12).all()
            assert (np.abs(rate) <= LIMITS.rate + 1e-12).all()
            assert (np.abs(supervisor.angle) <= LIMITS.angle + 1e-9).all()
            before = rate


@settings(max_examples=100)
@given(*[arrays(float, (3, 2), elements=st.floats(-r, r)) for r in (2.0, 0.65, 0.2)])
def test_one_rig_is_clamped_to_the_bits_it_has_among_three(wish, rate, angle):
    clamp = Clamp(LIMITS, PERIOD)
    together = clamp(wish, rate, angle)
    for rig in range(3):
        mine = slice(rig, rig + 1)
        assert np.array_equal(clamp(wish[mine], rate[mine], angle[mine]), together[mine])


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_wish_that_is_no_number_stops_its_rig_and_only_that(bad):
    supervisor = running(rigs=2)
    rate = supervisor.clamp(np.array([[bad, 0.0], [0.01, 0.0]]))
    assert np.isfinite(rate).all()
    assert supervisor.state.tolist() == [State.HOLDING, State.RUNNING]
    assert "controller asked for" in supervisor.reason[0]


@pytest.mark.parametrize(
    ("x", "y", "theta_deg", "state"),
    [
        (0.29, 0.19, 0.0, State.RUNNING),  # on the edge of area and margin
        (0.291, 0.0, 0.0, State.HOLDING),
        (0.0, -0.191, 0.0, State.HOLDING),
        (0.0, 0.0, 11.0, State.HOLDING),
    ],
)
def test_a_ball_or_plate_past_its_limit_stops_the_rig(x, y, theta_deg, state):
    supervisor = running()
    supervisor.watch(np.array([[x, 0.0, y, np.radians(theta_deg)]]), np.array([True]))
    assert supervisor.state[0] == state


@settings(max_examples=6)
@given(st.floats(-0.17, 0.17), st.floats(-0.17, 0.17))
@example(0.17, -0.17)
def test_a_stopped_rig_levels_its_plate_whatever_the_controller_says(phi, theta):
    supervisor = running(plate=(phi, theta))
    supervisor.handle(Event.LEVEL)
    for _ in range(1000):
        supervisor.clamp(np.full((1, 2), 0.5))
    assert np.abs(supervisor.angle).max() < 1e-5
    assert np.abs(supervisor.rate).max() < 1e-3


def test_a_fault_stops_the_plate_at_once_and_a_hold_does_not():
    supervisor = running(rigs=2)
    for _ in range(20):
        supervisor.clamp(np.full((2, 2), 0.2))
    supervisor.handle(Event.STOP, np.array([True, False]))
    supervisor.handle(Event.LEVEL, np.array([False, True]))
    rate = supervisor.clamp(np.full((2, 2), 0.2))
    assert rate[0].tolist() == [0.0, 0.0]
    assert (rate[1] > 0).all()
    supervisor.handle(Event.SWITCH_OFF)
    assert not supervisor.clamp(np.full((2, 2), 0.2)).any()


NAN = np.nan


@pytest.mark.parametrize("at", [1, 3])
def test_a_plate_angle_that_is_no_number_counts_as_past_its_limit(at):
    supervisor = running(rigs=2)
    y = np.zeros((2, 4))
    y[1, at] = NAN
    supervisor.watch(y, np.array([True, True]))
    assert supervisor.state.tolist() == [State.RUNNING, State.HOLDING]
    assert "plate" in supervisor.reason[1]
    assert np.isfinite(supervisor.clamp(np.full((2, 2), 0.1))).all()
    assert np.isfinite(supervisor.angle).all()
    supervisor.watch(y, np.array([True, True]))  # nothing can level what has no angle
    assert supervisor.state.tolist() == [State.RUNNING, State.FAULT]


@pytest.mark.parametrize(("touched", "state"), [(True, State.HOLDING), (False, State.RUNNING)])
@pytest.mark.parametrize("at", [0, 2])
def test_a_ball_that_is_felt_at_no_number_counts_as_outside(at, touched, state):
    supervisor = running()
    y = np.zeros((1, 4))
    y[0, at] = NAN
    supervisor.watch(y, np.array([touched]))
    assert supervisor.state[0] == state


def test_a_ball_that_is_no_longer_felt_outside_of_its_area_has_left_it():
    supervisor = running()
    supervisor.watch(np.array([[0.3, 0.0, 0.0, 0.0]]), np.array([False]))
    assert supervisor.state[0] == State.HOLDING


def test_a_plate_that_is_levelled_and_has_no_angle_any_more_is_stopped():
    supervisor = running(plate=(0.05, 0.0))
    supervisor.handle(Event.LEVEL)
    supervisor.watch(np.array([[0.0, 0.05, 0.0, 0.0]]), np.array([True]))
    assert supervisor.state[0] == State.HOLDING
    supervisor.watch(np.array([[0.0, NAN, 0.0, 0.0]]), np.array([True]))
    assert supervisor.state[0] == State.FAULT


def levelled(late, begin, rate, then):
    """The state after a plate at an angle was asked to level and did what ``then`` says, deg."""
    supervisor = Supervisor(LIMITS, PERIOD, 2, late=late)
    supervisor.handle(Event.INITIALISE)
    supervisor.powered(np.radians([[begin, 0.0], [0.0, 0.0]]))
    supervisor.handle(Event.START)
    supervisor.rate = np.radians([[rate, 0.0], [0.0, 0.0]])
    supervisor.handle(Event.LEVEL)
    for degrees in then:
        y = np.zeros((2, 4))
        y[0, 1] = np.radians(degrees)
        supervisor.watch(y, np.array([True, True]))
    return State(supervisor.state[0]), State(supervisor.state[1])


BRAKED = np.degrees(np.radians(20.0) ** 2 / (2 * LIMITS.acceleration))
"""Way in deg on which a plate brakes from 20 deg/s."""


@pytest.mark.parametrize(
    ("late", "begin", "rate", "then", "state"),
    [
        (0.0, 5.0, 0.0, [5.0, 5.9, 4.0, -4.0, -5.9], State.HOLDING),
        (0.0, 5.0, 0.0, [5.0, 6.1], State.FAULT),
        (0.0, -5.0, 0.0, [-5.0, -6.1], State.FAULT),
        (0.0, 5.0, 0.0, [5.0, 0.0, -6.1], State.FAULT),
        (0.0, 5.0, 20.0, [5.0, 5.9 + BRAKED], State.HOLDING),
        (0.0, 5.0, 20.0, [5.0, 6.1 + BRAKED], State.FAULT),
        (0.1, 5.0, 20.0, [5.0, 7.9 + BRAKED], State.HOLDING),
        (0.1, 5.0, 20.0, [5.0, 8.1 + BRAKED], State.FAULT),
    ],
)
def test_a_plate_that_tilts_further_though_it_is_levelled_is_stopped(
    late, begin, rate, then, state
):
    assert levelled(late, begin, rate, then) == (state, State.HOLDING)


def test_each_levelling_begins_where_the_plate_is_then():
    supervisor = running(plate=(0.1, 0.0))
    for angle in (0.1, 0.02):
        supervisor.handle(Event.LEVEL)
        for each in (angle, angle + 0.015):
            supervisor.watch(np.array([[0.0, each, 0.0, 0.0]]), np.array([True]))
        supervisor.handle(Event.SWITCH_OFF)
        supervisor.watch(np.zeros((1, 4)), np.array([True]))
        supervisor.handle(Event.INITIALISE)
        supervisor.powered(np.array([[0.02, 0.0]]))
        supervisor.handle(Event.START)
    supervisor.handle(Event.LEVEL)
    for each in (0.02, 0.02 + np.radians(1.1)):
        supervisor.watch(np.array([[0.0, each, 0.0, 0.0]]), np.array([True]))
    assert supervisor.state[0] == State.FAULT


def test_rates_are_kept_to_a_narrower_limit_until_it_is_taken_back():
    supervisor = running()
    supervisor.limit_rate(0.1)
    most = [np.abs(supervisor.clamp(np.full((1, 2), 0.5))).max() for _ in range(100)]
    assert max(most) == pytest.approx(0.1)
    supervisor.limit_rate(None)
    supervisor.angle[:] = 0.0
    assert supervisor.clamp(np.full((1, 2), 0.5)) == pytest.approx(0.1 + 7.0 * PERIOD)
    wide = running()
    wide.limit_rate(9.0)  # no wider than the limits
    wide.angle[:] = -0.17
    rates = [wide.clamp(np.full((1, 2), 5.0)).max() for _ in range(60)]
    assert max(rates) == pytest.approx(LIMITS.rate)


@settings(max_examples=100)
@given(*[arrays(float, (3, 2), elements=st.floats(-r, r)) for r in (2.0, 0.6, 0.4)])
def test_from_every_rate_and_angle_the_acceleration_limit_holds(wish, rate, angle):
    step = LIMITS.acceleration * PERIOD
    assert (np.abs(Clamp(LIMITS, PERIOD)(wish, rate, angle) - rate) <= step + 1e-12).all()


def test_a_plate_turned_past_where_it_can_be_braked_is_braked_as_fast_as_it_may_be():
    step = LIMITS.acceleration * PERIOD
    found = Clamp(LIMITS, PERIOD)(
        np.array([[0.5, -0.5]]), np.array([[0.5, -0.5]]), LIMITS.angle * np.array([[1.0, -1.0]])
    )
    assert found == pytest.approx(np.array([[0.5 - step, step - 0.5]]))


@pytest.mark.parametrize("period", [0.001, 0.002, 0.004])
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_the_hardest_wish_ends_at_the_angle_limit_and_not_past_it(period, way):
    supervisor = Supervisor(LIMITS, period)
    supervisor.handle(Event.INITIALISE)
    supervisor.powered(np.zeros((1, 2)))
    supervisor.handle(Event.START)
    for _ in range(round(1.0 / period)):
        supervisor.clamp(np.full((1, 2), 5.0 * way))
        assert np.abs(supervisor.angle).max() <= LIMITS.angle + 1e-9
    assert way * supervisor.angle == pytest.approx(LIMITS.angle, abs=1e-4)


def felt(ticks, speed, gone):
    """The state after a ball that jumps while it is not felt, and rests else."""
    supervisor = running(Limits(area=(1.0, 1.0)))
    place = shown = -0.2
    for tick in range(ticks):
        touched = tick not in gone
        place += 0.0 if touched else speed * PERIOD
        shown = place if touched else shown  # the screen keeps the last it has felt
        supervisor.watch(np.array([[shown, 0.0, 0.0, 0.0]]), np.array([touched]))
    return State(supervisor.state[0])


def test_how_far_a_ball_has_come_while_it_was_not_felt_is_no_speed():
    # by 0.12 m, about the end of the 20 periods of a measurement, and within them
    assert felt(80, 3.0, range(30, 50)) is State.RUNNING
    assert felt(80, 3.0, range(39, 59)) is State.RUNNING
    assert felt(80, 12.0, range(45, 50)) is State.RUNNING
    assert felt(80, 60.0, [39]) is State.RUNNING
    assert felt(80, 3.0, range(39, 59, 2)) is State.RUNNING


@pytest.mark.parametrize("period", [0.001, 0.002, 0.004])
def test_what_the_supervisor_watches_is_detected_within_its_stated_time_at_every_period(period):
    lost = next(each for each in RIG_CONDITIONS if each.name == "ball lost")
    for condition, y, touched in (
        (BALL_OUTSIDE, [0.5, 0.0, 0.0, 0.0], True),
        (PLATE_TILTED, [0.0, 0.5, 0.0, 0.0], True),
        (lost, [0.0, 0.0, 0.0, 0.0], False),
    ):
        supervisor = Supervisor(LIMITS, period)
        supervisor.handle(Event.INITIALISE)
        supervisor.powered(np.zeros((1, 2)))
        supervisor.handle(Event.START)
        periods = 0
        while supervisor.state[0] == State.RUNNING:
            supervisor.watch(np.array([y]), np.array([touched]))
            periods += 1
        assert periods * period <= condition.longest(period) + 1e-9
        assert supervisor.notes[0].condition is condition
        limit = f"past its limit of {np.degrees(LIMITS.angle):.4g} deg"
        assert (limit in supervisor.notes[0].text) == (condition is PLATE_TILTED)
    assert BALL_OUTSIDE.longest(period) == pytest.approx(period)
