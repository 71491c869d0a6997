"""`controllers.setpoints`.

Goals one after the other: how smooth the path is, where it stays, and what is refused."""

import numpy as np
import pytest

from controllers.references import Circle
from controllers.setpoints import Setpoints

GOALS = ((1.0, 0.1, 0.05), (1.3, -0.2, 0.1), (1.32, 0.2, -0.1), (2.5, 0.0, 0.0))
CIRCLE = {"kind": "circle", "amplitude": 0.15, "omega": 0.75}
TIMES = np.linspace(0, 5, 5001)


@pytest.mark.parametrize("before", [None, CIRCLE])
def test_each_derivative_is_the_slope_of_the_one_before(before):
    times = np.linspace(0, 5, 20_001)
    motion = Setpoints(points=GOALS, before=before)(times)
    for order in range(4):
        slope = np.gradient(motion[order], times, axis=0)[2:-2]
        scale = np.abs(motion[order + 1]).max()
        assert np.abs(slope - motion[order + 1][2:-2]).max() < 0.01 * scale


def test_the_path_never_leaves_the_hull_of_the_goals():
    x, y = Setpoints(points=GOALS, time_constant=0.05)(TIMES)[0].T
    assert x.min() >= -0.2 - 1e-12
    assert x.max() <= 0.2 + 1e-12
    assert y.min() >= -0.1 - 1e-12
    assert y.max() <= 0.1 + 1e-12


def test_it_rests_on_the_first_goal_until_the_second_and_ends_on_the_last():
    path = Setpoints(points=GOALS)
    assert (path(TIMES[TIMES < 1.3])[0] == [0.1, 0.05]).all()
    assert not path(TIMES[TIMES < 1.3])[1:].any()
    assert np.abs(path(60.0)[0]).max() < 1e-9


def test_a_step_takes_the_time_that_is_said_of_it():
    path = Setpoints(points=((0, 0, 0), (1, 1e-1, 0)), time_constant=0.2)
    assert path(1 + 4.67 * 0.2)[0, 0] == pytest.approx(0.05, rel=0.01)
    assert path(1 + 8.0 * 0.2)[0, 0] == pytest.approx(0.09, rel=0.01)


def test_the_path_before_is_followed_until_the_first_goal():
    path = Setpoints(points=GOALS, before=CIRCLE)
    early = TIMES[TIMES < 1.0]
    assert (path(early) == Circle(amplitude=0.15, omega=0.75)(early)).all()
    assert np.abs(path(60.0)[0]).max() < 1e-9


def test_goals_added_one_by_one_give_the_same_bits():
    grown = Setpoints(points=GOALS[:1], before=CIRCLE)
    for goal in GOALS[1:]:
        grown = grown.then(*goal)
    whole = Setpoints(points=GOALS, before=CIRCLE)
    assert grown == whole
    assert (grown(TIMES) == whole(TIMES)).all()
    each = np.stack([whole(float(t)) for t in TIMES[::50]], axis=1)
    assert (each == whole(TIMES)[:, ::50]).all()


def test_two_ways_to_go_on_know_nothing_of_each_other():
    begun = Setpoints(points=GOALS[:2])
    one, other = begun.then(2.0, 0.1, 0.1), begun.then(2.0, -0.1, 0.1)
    assert one(60.0)[0].tolist() == pytest.approx([0.1, 0.1])
    assert other(60.0)[0].tolist() == pytest.approx([-0.1, 0.1])
    assert begun(60.0)[0].tolist() == pytest.approx([-0.2, 0.1])


def test_many_times_are_worked_out_in_blocks(monkeypatch):
    path = Setpoints(points=GOALS)
    at_once = path(TIMES)
    monkeypatch.setattr("controllers.setpoints.MAX_TIMES_AT_ONCE", 100)
    assert (path(TIMES) == at_once).all()
