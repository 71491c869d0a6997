import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from twin.hal.interface import Clamp, Limits
from twin.hal.supervisor import Event, State, Supervisor

PERIOD = 0.002
LIMITS = Limits()
FELT = np.array([True])
WISHES = arrays(float, (20, 2, 2), elements=st.floats(-50, 50))


def running(rigs=2, limits=LIMITS):
    supervisor = Supervisor(limits, PERIOD, rigs)
    supervisor.handle(Event.INITIALISE)
    supervisor.powered(np.zeros((rigs, 2)))
    supervisor.handle(Event.START)
    return supervisor


def measured(ball, plate=(0.0, 0.0)):
    return np.array([[ball[0], plate[0], ball[1], plate[1]]])


@settings(max_examples=60)
@given(WISHES, st.integers(1, 40))
def test_whatever_is_requested_the_commands_keep_angle_rate_and_acceleration_limits(wishes, hold):
    supervisor = running()
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
    supervisor = running()
    rate = supervisor.clamp(np.array([[bad, 0.0], [0.01, 0.0]]))
    assert np.isfinite(rate).all()
    assert supervisor.state.tolist() == [State.HOLDING, State.RUNNING]
    assert "controller asked for" in supervisor.reason[0]


@pytest.mark.parametrize(
    ("ball", "plate"),
    [((0.291, 0.0), (0.0, 0.0)), ((0.0, -0.191), (0.0, 0.0)), ((0.0, 0.0), (0.0, np.radians(11)))],
)
def test_a_ball_or_plate_past_its_limit_stops_the_rig(ball, plate):
    supervisor = running(1)
    supervisor.watch(measured(ball, plate), FELT)
    assert supervisor.state[0] == State.HOLDING


def test_a_ball_on_the_edge_of_area_and_margin_is_allowed():
    supervisor = running(1)
    supervisor.watch(measured((0.29, 0.19)), FELT)
    assert supervisor.state[0] == State.RUNNING


@settings(max_examples=6)
@given(st.floats(-0.17, 0.17), st.floats(-0.17, 0.17))
@example(0.17, -0.17)
def test_a_stopped_rig_levels_its_plate_whatever_the_controller_says(phi, theta):
    supervisor = Supervisor(LIMITS, PERIOD, 1)
    supervisor.handle(Event.INITIALISE)
    supervisor.powered(np.array([[phi, theta]]))
    supervisor.handle(Event.START)
    supervisor.handle(Event.LEVEL)
    for _ in range(1000):
        supervisor.clamp(np.full((1, 2), 0.5))
    assert np.abs(supervisor.angle).max() < 1e-5
    assert np.abs(supervisor.rate).max() < 1e-3


def test_a_fault_stops_the_plate_at_once_and_a_hold_does_not():
    supervisor = running()
    for _ in range(20):
        supervisor.clamp(np.full((2, 2), 0.2))
    supervisor.handle(Event.STOP, np.array([True, False]))
    supervisor.handle(Event.LEVEL, np.array([False, True]))
    rate = supervisor.clamp(np.full((2, 2), 0.2))
    assert rate[0].tolist() == [0.0, 0.0]
    assert (rate[1] > 0).all()
    supervisor.handle(Event.SWITCH_OFF)
    assert not supervisor.clamp(np.full((2, 2), 0.2)).any()
