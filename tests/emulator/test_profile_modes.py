"""Tests of `twin.emulator.profile_modes`."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.emulator.profile_modes import (
    Motion,
    Profile,
    Window,
    move_along,
    plan_profile,
    ramp_velocity,
)

POSITIONS = st.floats(-1e6, 1e6)
RATES = st.floats(-1e5, 1e5)
POSITIVE = st.floats(10.0, 1e5)


def duration(pieces):
    return sum(each.duration for each in pieces)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("distance", [1.0, 80.0, 120.0, 1e4])
def test_a_move_from_rest_takes_the_time_of_the_trapezoid(distance, sign):
    speed, up, down = 100.0, 200.0, 50.0
    pieces = plan_profile(Motion(7.0), 7.0 + sign * distance, Profile(speed, up, down))
    if distance >= speed**2 / (2 * up) + speed**2 / (2 * down):
        expected = distance / speed + speed / 2 * (1 / up + 1 / down)
    else:
        expected = math.sqrt(2 * distance * (up + down) / (up * down))
    assert duration(pieces) == pytest.approx(expected, rel=1e-12)


@given(POSITIONS, RATES, POSITIONS, POSITIVE, POSITIVE, POSITIVE)
@settings(max_examples=150)
def test_any_move_ends_at_rest_at_its_goal_within_its_limits(place, rate, goal, speed, up, down):
    start = Motion(place, rate)
    pieces = plan_profile(start, goal, Profile(speed, up, down))
    position, velocity, most = place, rate, max(speed, abs(rate))
    for time, acceleration in pieces:
        assert time >= 0
        after = velocity + acceleration * time
        allowed = up if acceleration * velocity > 0 else down
        if abs(velocity) < 1e-6:
            allowed = max(up, down)
        assert abs(acceleration) <= allowed * (1 + 1e-9)
        position += (velocity + after) / 2 * time
        velocity = after
        assert abs(velocity) <= most * (1 + 1e-9) + 1e-6
    assert velocity == pytest.approx(0, abs=1e-5)
    assert position == pytest.approx(goal, abs=1e-3 + 1e-9 * rate**2)


def test_a_motion_that_cannot_stop_in_time_overshoots_and_returns():
    pieces = plan_profile(Motion(0.0, 100.0), 10.0, Profile(100.0, 50.0, 50.0))
    # 100^2 / (2 * 50) = 100 counts to stop, then back by 90: sqrt(4 * 90 / 50) s
    assert duration(pieces) == pytest.approx(2.0 + math.sqrt(4 * 90 / 50))
    assert move_along(Motion(0.0, 100.0), pieces, 2.0).position == pytest.approx(100.0)


@given(RATES, RATES, POSITIVE, st.floats(1e-4, 2.0))
@settings(max_examples=60)
def test_a_ramp_is_that_of_many_small_steps(rate, target, ramp, time):
    whole = ramp_velocity(Motion(0.0, rate), target, ramp, time)
    small = Motion(0.0, rate)
    for _ in range(16):
        small = ramp_velocity(small, target, ramp, time / 16)
    assert whole.velocity == pytest.approx(small.velocity, rel=1e-9, abs=1e-6)
    assert whole.position == pytest.approx(small.position, rel=1e-9, abs=1e-6)
    assert abs(whole.velocity - rate) <= ramp * time + 1e-6


def test_a_window_counts_only_time_without_interruption():
    window = Window()
    steps = [0.5] * 4 + [2.0] + [0.5] * 5
    found = [window.inside(deviation, 1.0, 5, 0.001) for deviation in steps]
    assert found == [False] * 9 + [True]
