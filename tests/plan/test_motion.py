"""`twin.plan.motion`: An optimised motion is a scenario, keeps its ball, and tells more."""

import math
from dataclasses import replace

import numpy as np
import pytest

from twin.base.errors import ScenarioError
from twin.identify.logs import Log
from twin.plan.experiment import RigChoice, forecast_motion
from twin.plan.motion import (
    MOTION_SEARCH,
    Motion,
    ScoredMotion,
    format_table,
    keeps_ball,
    optimise_motion,
    write_motion,
)
from twin.scenario.load import load
from twin.scenario.rig_tables import RigLimitsTable

AREA = np.array(RigLimitsTable().area)


def motion(reach=0.5):
    return Motion(np.array([[1.0, -1.0], [0.0, 0.5], [-1.0, 1.0]]), 1.5, 0.1, reach)


def test_the_ball_rests_at_the_centre_before_the_first_goal_one_in_each_interval():
    points = np.array(replace(motion(), rest=0.8).points(4.0))
    assert points[:, 0] == pytest.approx([0, 0.8, 2.3, 3.8])
    assert points[0, 1:] == pytest.approx(0)
    assert points[1:, 1:] == pytest.approx(0.5 * AREA * motion().goals, abs=1e-4)
    assert len(motion().points(2.0)) == 2


@pytest.mark.parametrize("rig", ["", "course", "hobby", "three_legs"])
def test_the_scenario_stays_within_the_area_of_any_rig(tmp_path, rig):
    file = tmp_path / "motion.toml"
    file.write_text(motion(1.0).text("excite", 4.0))
    scenario = load(str(file), [f"parameters={rig}"] if rig else [])
    assert scenario.controller.kind == "afl"
    table = np.loadtxt(format_table(scenario).splitlines()[1:], delimiter=",")
    area = np.array(scenario.rig.limits.area)
    farthest = np.abs(table[:, 1:3]).max(axis=0)
    assert (farthest <= area + 1e-9).all()
    assert (farthest > 0.5 * area.min()).any()
    # the velocities are the slopes of the places
    slopes = np.gradient(table[:, 1:3], table[:, 0], axis=0)
    assert table[5:-5, 3:] == pytest.approx(slopes[5:-5], abs=0.02 * np.abs(slopes).max())


def test_random_motions_and_changed_ones_stay_within_their_ranges():
    random, how = np.random.default_rng(4), replace(MOTION_SEARCH, change=0.8)
    one = Motion.draw(6.0, random, how)
    assert len(one.goals) * one.interval >= 6.0
    # each stroke leads to the other side
    assert (one.goals[1:, 0] * one.goals[:-1, 0] < 0).all()
    # the first stroke is a short one
    assert np.hypot(*one.goals.T) == pytest.approx([how.first_share, *[1.0] * (len(one.goals) - 1)])
    changed = [one.change(random, MOTION_SEARCH) for _ in range(20)]
    assert max(np.hypot(*each.goals[0]) for each in changed) < 0.5
    for _ in range(20):
        one = one.change(random, how)
        assert np.abs(one.goals).max() <= 1
        for value, (low, high) in (
            (one.interval, how.intervals_s),
            (one.time_constant, how.time_constants_s),
            (one.reach, how.reaches),
        ):
            assert low <= value <= high


def log(last, touched):
    time = np.arange(0, last, 0.01)
    both = np.zeros((len(time), 2))
    fields = dict.fromkeys(("command", "model", "own_lag", "grips"))
    on = np.full(len(time), fill_value=True)
    on[-1] = touched
    return Log(source="", time=time, ball=both, plate=both, age=time, touched=on, **fields)


def test_a_ball_that_is_not_on_the_plate_at_the_end_has_left_it():
    assert keeps_ball(log(5.0, touched=True), 5.0)
    assert not keeps_ball(log(5.0, touched=False), 5.0)
    assert not keeps_ball(log(4.0, touched=True), 5.0)


def test_a_motion_tells_more_by_its_score_and_of_those_that_lose_the_ball_by_less_reach():
    far, near = motion(0.9), motion(0.4)
    assert min([ScoredMotion(0.3, near), ScoredMotion(0.2, far)]).motion is far
    lost = [ScoredMotion(math.inf, far), ScoredMotion(math.inf, near)]
    assert min(lost).motion is near
    lost.remove(lost[1])
    assert [each.motion for each in lost] == [far]


def test_a_file_of_another_ending_is_refused(tmp_path):
    with pytest.raises(ScenarioError, match=r"must end in \.toml for a scenario, or \.csv"):
        write_motion(tmp_path / "motion.txt", None)
    assert not list(tmp_path.iterdir())


@pytest.mark.long
def test_every_rig_shows_its_breakaway_as_the_ball_rests_first(tmp_path):
    file = tmp_path / "motion.toml"
    file.write_text(Motion.draw(12.0, np.random.default_rng(5), MOTION_SEARCH).text("excite", 12.0))
    names = ("rolling", "breakaway", "delay", "level")
    told = forecast_motion(file, 12.0, RigChoice(rigs=3, draw=64), names)
    for rig in told.every:
        assert rig.verdict("breakaway").low is not None


SMALL = replace(MOTION_SEARCH, first=3, parents=1, children=1, rounds=1, rigs=0, tested_rigs=3)


@pytest.mark.long
def test_the_motion_found_tells_no_less_than_the_first_one_drawn():
    choice, names = RigChoice(rigs=0), ("rolling", "delay", "level")
    found = optimise_motion("excite", 12.0, choice, names, how=SMALL)
    alone = replace(SMALL, first=1, rounds=0)
    first = optimise_motion("excite", 12.0, choice, names, how=alone)
    assert found.forecast.score < first.forecast.score
    assert found.kept == found.tested == 3


@pytest.mark.long
def test_a_law_under_which_the_ball_falls_is_refused():
    how, rig = replace(SMALL, first=2, rounds=0, tests=3), RigChoice(on="three_legs", rigs=0)
    with pytest.raises(ScenarioError, match="no motion was found that keeps the ball"):
        optimise_motion("excite", 6.0, rig, ("delay",), how=how)
