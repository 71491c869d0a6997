"""Tests of `twin.view.lanes`."""

import numpy as np
import pytest

from twin.hal.supervisor import State
from twin.run.finished import run
from twin.run.metrics import find_rest
from twin.scenario import load
from twin.view.lanes import STATE_COLOURS, RunLanes, changes

PERIOD = 0.002


def rows(count, **columns):
    """Recorded rows of a ball that rolls along x at 0.1 m/s, but for the columns given."""
    names = [f"true_{axis}" for axis in ("x", "y", "phi", "theta")]
    found = {f"{name}{rate}": np.zeros(count) for name in names for rate in ("", "_rate")}
    for axis in ("phi", "theta"):
        found[f"requested_{axis}_acc"] = found[f"applied_{axis}_acc"] = np.zeros(count)
        found[f"wheel_{axis}_N"] = np.ones(count)
    found |= {"time": PERIOD * np.arange(count), "true_x_rate": np.full(count, 0.1)}
    found |= {"touched": np.ones(count), "age": np.full(count, 0.016)}
    found["supervisor"] = np.full(count, float(State.RUNNING))
    return found | columns


def changes_by_lane(scenario, *blocks):
    """All changes of blocks by lane: (time, state) pairs."""
    lanes, found = RunLanes(scenario), {}
    for block in blocks:
        for name, lane in lanes.take(block):
            found.setdefault(name, []).extend(zip(lane.time.tolist(), lane.states, strict=True))
    return found


@pytest.fixture(scope="module")
def circle():
    return load("circle")


def test_changes_are_the_first_sample_of_each_state():
    lane = changes(np.arange(6.0), np.array(["a", "a", "b", "b", "a", "a"]))
    assert lane.time.tolist() == [0.0, 2.0, 4.0]
    assert lane.states == ["a", "b", "a"]
    later = changes(np.arange(2.0), np.array(["a", "b"]), before="a")
    assert (later.time.tolist(), later.states) == ([1.0], ["b"])


def test_each_lane_shows_what_its_columns_say(circle):
    step = np.arange(100) >= 50
    found = changes_by_lane(
        circle,
        rows(
            100,
            supervisor=np.where(step, State.HOLDING, State.RUNNING).astype(float),
            touched=1.0 - step,
            age=np.where(step, 0.5, 0.016),
            requested_phi_acc=3.0 * step,
            wheel_theta_N=1.0 - step,
        ),
    )
    second = {name: states[1] for name, states in found.items()}
    assert second == {
        "supervisor": (0.1, "holding"),
        "ball": (0.1, "not detected"),
        "screen": (0.1, "no new frame"),
        "effort": (0.1, "phi limited"),
        "wheels": (0.1, "theta lifted off"),
    }
    both = rows(10, wheel_phi_N=np.zeros(10), wheel_theta_N=np.zeros(10))
    assert changes_by_lane(circle, both)["wheels"] == [(0.0, "both lifted off")]


def test_every_state_has_a_colour_and_every_state_of_the_supervisor_is_one():
    assert set(STATE_COLOURS["supervisor"]) == {each.name.lower() for each in State}
    assert all(len(set(colours)) == len(colours) for colours in STATE_COLOURS.values())


def test_blocks_of_any_length_give_the_changes_of_the_whole(circle):
    speed = np.where(np.arange(400) // 90 % 2 == 1, 0.0, 0.1)  # 0.18 s each
    whole = rows(400, true_x_rate=speed)
    parts = [
        {name: column[first:end] for name, column in whole.items()}
        for first, end in ((0, 1), (1, 137), (137, 150), (150, 400))
    ]
    assert changes_by_lane(circle, *parts) == changes_by_lane(circle, whole)
    assert len(changes_by_lane(circle, whole)["ball"]) == 5


def test_a_ball_at_rest_is_what_the_indicators_count():
    done = run(load("circle", ("duration=3", "metrics.start=0", "baseline=false")))
    time = done.rows["time"]
    rest = find_rest(time, np.stack((done.rows["true_x_rate"], done.rows["true_y_rate"]), axis=1))
    found = np.full(len(time), "", dtype="U20")
    for at, state in changes_by_lane(done.scenario, done.rows)["ball"]:
        found[time >= at] = state
    assert 0.2 < rest.mean() < 0.8
    assert ((found == "at rest") == rest).all()  # it lay still from the first row on


def test_a_ball_that_stops_is_at_rest_after_a_tenth_of_a_second(circle):
    stopped = np.arange(200) >= 60
    found = changes_by_lane(circle, rows(200, true_x_rate=np.where(stopped, 0.0, 0.1)))
    assert found["ball"] == [(0.0, "rolls"), (pytest.approx(0.218, abs=0.003), "at rest")]
