"""Tests of `twin.run.metrics`."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.run.indicators import (
    BOARD_INDICATORS,
    INDICATOR_UNITS,
    MOTION_INDICATORS,
    nearest_indicator,
)
from twin.run.metrics import Ending, Motion, Outcome, find_rest, measure, tracking_error

DONE = Outcome(Ending.FINISHED, 10.0)


def motion(ball, reference, time=None, plate=None, u=None):
    count = len(ball)
    return Motion(
        time=np.linspace(0, 10, count) if time is None else time,
        ball=np.asarray(ball, float),
        plate=np.zeros((count, 2)) if plate is None else plate,
        u=np.zeros((count, 2)) if u is None else u,
        reference=np.asarray(reference, float),
    )


@given(st.floats(0.01, 0.5))
def test_a_circle_followed_at_a_share_of_its_radius_misses_by_the_rest(share):
    angle = np.linspace(0, 6, 500)
    circle = 0.15 * np.stack((np.sin(angle), np.cos(angle)), axis=-1)
    found = measure(motion((1 - share) * circle, circle), DONE)
    assert found["tracking_error_percent"] == pytest.approx(100 * share)


@given(st.floats(0.001, 0.5))
def test_a_delayed_circle_misses_by_the_chord_of_the_delay_angle(delay):
    angle = np.linspace(0, 2 * np.pi, 1001)[:-1]
    circle = np.stack((np.sin(angle), np.cos(angle)), axis=-1)
    late = np.stack((np.sin(angle - delay), np.cos(angle - delay)), axis=-1)
    assert tracking_error(circle - late, circle) == pytest.approx(200 * np.sin(delay / 2))


def test_a_reference_resting_at_zero_has_no_relative_error():
    found = measure(motion(np.full((10, 2), 0.01), np.zeros((10, 2))), DONE)
    assert found["tracking_error_percent"] is None
    assert found["rms_error"] == pytest.approx(0.01)


def test_steady_error_is_judged_from_the_start_time_only():
    ball = np.zeros((101, 2))
    ball[:30, 0] = 0.5
    found = measure(motion(ball, np.zeros((101, 2))), DONE, start=5.0)
    assert found["max_steady_error"] == 0.0
    assert found["mean_error"] == pytest.approx(0.5 * 30 / 101)


def test_the_distance_counts_both_axes_from_the_start_time_on():
    ball = np.zeros((101, 2))
    ball[:, 1], ball[:30, 0] = 0.03, 0.5
    ball[50:, 0] = 0.04
    found = measure(motion(ball, np.zeros((101, 2))), DONE, start=5.0)
    assert found["rms_distance"] == pytest.approx(0.05)


def test_a_second_order_step_has_its_textbook_overshoot_and_settling_time():
    damping, frequency = 0.5, 4.0
    time = np.linspace(0, 10, 20001)
    damped = frequency * np.sqrt(1 - damping**2)
    decay = np.exp(-damping * frequency * time)
    step = 1 - decay * (
        np.cos(damped * time) + damping * frequency / damped * np.sin(damped * time)
    )
    ball = np.stack((0.15 * step, np.zeros_like(step)), axis=-1)
    goal = np.tile([0.15, 0.0], (len(time), 1))
    found = measure(motion(ball, goal, time), DONE, band_percent=5)
    expected = 100 * np.exp(-np.pi * damping / np.sqrt(1 - damping**2))
    assert found["overshoot_percent"] == pytest.approx(expected, rel=1e-4)
    outside = time[np.abs(step - 1) > 0.05]
    assert found["settling_time"] == pytest.approx(outside[-1], abs=1e-3)
    assert found["steady_error"] == pytest.approx(0, abs=1e-6)


def test_the_settling_time_ends_with_the_first_period_that_stays_in_the_band():
    ball = np.zeros((101, 2))
    ball[30:, 0] = 0.15
    found = measure(motion(ball, np.tile([0.15, 0.0], (101, 1))), DONE)
    assert found["settling_time"] == pytest.approx(3.0)


def test_a_ball_that_never_settles_has_no_settling_time():
    ball = np.zeros((100, 2))
    ball[1:, 0] = np.linspace(0, 0.1, 99)
    found = measure(motion(ball, np.tile([0.15, 0.0], (100, 1))), DONE)
    assert found["settling_time"] is None
    assert found["steady_error"] == pytest.approx(0.05)


@pytest.mark.parametrize(("way", "expected"), [(0.0009, None), (0.0011, 200.0)])
def test_a_ball_that_begins_at_its_goal_but_for_noise_has_no_overshoot_in_percent(way, expected):
    ball = np.zeros((101, 2))
    ball[50, 0] = 3 * way
    found = measure(motion(ball, np.tile([way, 0.0], (101, 1))), DONE)
    assert found["overshoot_percent"] == (expected and pytest.approx(expected))
    assert found["steady_error"] == pytest.approx(way)


def test_a_moving_reference_has_no_overshoot():
    time = np.linspace(0, 10, 200)
    path = np.stack((np.sin(time), np.cos(time)), axis=-1)
    found = measure(motion(path, path, time), DONE)
    assert found["overshoot_percent"] is None
    assert found["settling_time"] is None


def test_maxima_are_of_magnitude_in_degrees_and_per_axis():
    plate = np.zeros((10, 2))
    plate[3], u = (-0.1, 0.02), np.zeros((10, 2))
    u[4] = (0.5, -2.0)
    found = measure(motion(np.zeros((10, 2)), np.zeros((10, 2)), plate=plate, u=u), DONE)
    assert found["phi_max_deg"] == pytest.approx(np.degrees(0.1))
    assert found["theta_max_deg"] == pytest.approx(np.degrees(0.02))
    assert (found["u1_max"], found["u2_max"]) == (0.5, 2.0)


def test_a_run_that_ended_at_once_still_has_its_outcome():
    found = measure(motion(np.zeros((0, 2)), np.zeros((0, 2))), Outcome(Ending.FELL, 0.0, "gone"))
    assert (found["outcome"], found["reason"], found["rms_error"]) == ("fell", "gone", None)


def test_an_indicator_that_is_no_number_is_told_as_none():
    ball = np.full((10, 2), np.nan)
    found = measure(motion(ball, np.zeros((10, 2))), DONE)
    assert found["rms_error"] is None
    assert found["phi_max_deg"] == 0


def test_every_indicator_has_a_unit():
    step = measure(motion(np.linspace(0, [0.1, 0], 101), np.full((101, 2), 0.1)), DONE, start=1.0)
    late = step.pop("late_percent")  # of a law that takes no time
    assert late is None
    assert None not in step.values(), "of such a motion each has a value"
    assert step.keys() - {"outcome", "reason"} == set(INDICATOR_UNITS) - {
        "judged_from",
        "late_percent",
        "real_time_factor",
        *BOARD_INDICATORS,  # of a controller that is a program
    }


def test_a_ball_at_rest_for_longer_than_a_turn_is_held():
    time = np.arange(0.0, 3.0, 0.002)
    speed = np.zeros((len(time), 2))
    speed[time < 1.0] = 0.05
    speed[(time >= 2.0) & (time < 2.9)] = (0.0, -1.5e-4)
    speed[np.abs(time - 0.5) < 0.02] = 0.0  # turns
    expected = ((time >= 1.0) & (time < 2.0)) | (time >= 2.9)
    # the last interval lasts 98 ms, until the last row: less than is judged
    np.testing.assert_array_equal(find_rest(time, speed), expected & (time < 2.0))


@pytest.mark.parametrize("ending", [Ending.FELL, Ending.LOST, Ending.DIVERGED])
def test_a_ball_that_is_gone_has_no_error_and_one_that_was_stopped_has(ending):
    moved = motion(np.linspace(0, [0.2, 0.1], 101), np.full((101, 2), 0.05))
    gone = measure(moved, Outcome(ending, 1.0, "gone"), start=0.5)
    whole = measure(moved, Outcome(Ending.ABORTED, 1.0, "stopped"), start=0.5)
    errors = ("tracking_error_percent", "rms_error", "mean_error", "rms_distance")
    assert [gone[name] for name in errors] == [None] * 4
    assert None not in [whole[name] for name in errors]
    assert gone["phi_max_deg"] == whole["phi_max_deg"]


def test_a_stopped_run_is_judged_until_it_was_stopped_and_not_at_all_before_it_is_judged():
    away = motion(np.linspace(0, [0.2, 0.1], 101), np.zeros((101, 2)))
    first = motion(away.ball[:11], away.reference[:11], time=away.time[:11])
    stopped = Outcome(Ending.ABORTED, 1.0, "stopped")
    assert measure(away, stopped)["rms_error"] == measure(first, stopped)["rms_error"]
    assert measure(away, stopped, start=2.0)["rms_distance"] is None


def test_the_largest_steady_error_is_not_that_of_a_transient():
    moved = motion(np.linspace([0.2, 0.1], 0, 101), np.zeros((101, 2)))
    assert measure(moved, DONE)["max_steady_error"] is None
    assert measure(moved, DONE, start=5.0)["max_steady_error"] == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("e_tt", "tracking_error_percent"),
        ("effort", "u_rms"),
        ("setling_time", "settling_time"),
        ("rms", "u_rms"),  # a word of three labels: the nearest name
        ("xyz", None),
    ],
)
def test_an_indicator_is_found_by_the_word_that_tables_print(name, meant):
    said = nearest_indicator(name)
    assert said.endswith(f"(known: {', '.join(MOTION_INDICATORS)})")
    assert said.partition(" (")[0] == ("" if meant is None else f"; did you mean '{meant}'?")
