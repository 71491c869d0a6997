"""`twin.play.session`.

A driven rig: events act at once, nothing else differs from a run, going back is exact."""

import json
from pathlib import Path

import numpy as np
import pytest

from twin.play.driven import MAX_PUSH_M_S, MAX_SNAPSHOTS, Driven, Kept, States
from twin.play.session import PICTURE_COLUMNS, Back, End, Goal, Pause, Push, Save, Settings
from twin.run.finished import run
from twin.run.opened import open_run
from twin.scenario.load import load
from twin.whatif.futures import branch, future, moment_of

FRICTION = "plant.friction.rolling_mm"


def rows(session):
    """What was recorded, all columns side by side."""
    return np.column_stack([values for _, _, values in session.record.columns()])


@pytest.fixture(scope="module")
def played(driven, tmp_path_factory):
    """A rig on the mechanism: goal, friction, push, another law, saved."""
    folder = tmp_path_factory.mktemp("runs") / "play"
    script = {
        100: [Goal(0.05, 0.02)],
        150: [Settings({FRICTION: 0.3})],
        250: [Push(0.05, -0.02)],
        # soon after the state that is kept of the push, which must not know of it
        300: [Goal(0.05, 0.0)],
        350: [Settings({"controller.kind": "pole_placement"})],
        560: [Goal(-0.05, 0.0)],
        700: [Save(folder)],
    }
    return driven(load("hold"), script, 700), folder


@pytest.mark.long
def test_goals_and_changes_of_the_rig_are_a_scenario_that_runs_to_the_same_bits(driven, tmp_path):
    script = {
        50: [Goal(0.1, 0.05)],
        120: [Goal(-0.05, 0.0), Settings({FRICTION: 0.02})],
        160: [Settings({"plant.level_deg": [0.5, -0.2], "sensors.touch.dead_time": 0.06})],
        300: [Save(tmp_path / "run")],
    }
    session = driven(load("circle"), script, 300)
    (saved,) = open_run(tmp_path / "run")
    again = run(saved.scenario).record
    assert again.length == 300
    for name, _, values in again.columns():
        if name in saved.rows:
            assert np.array_equal(saved.rows[name], values), name
    assert session.driven.scenario.change


@pytest.mark.parametrize(
    ("event", "channel"),
    [
        # the path leaves the old goal smoothly: its fourth derivative rises from 0
        (Goal(0.1, 0.0), "applied"),
        (Settings({"plant.level_deg": [0.5, 0.0]}), "state"),
    ],
)
def test_an_event_acts_in_the_period_in_which_it_comes(driven, event, channel):
    scenario = load("hold", ["plant.kind=lagrange", f"{FRICTION}=0"])
    without, given = (driven(scenario, script, 60) for script in ({}, {50: [event]}))
    differ = (without.record[channel] != given.record[channel]).any(axis=(1, 2))
    assert np.flatnonzero(differ)[0] == 51


def test_going_back_undoes_and_goes_on_to_the_same_bits(driven):
    calm = driven(load("circle"), {}, 900)
    script = {
        600: [Goal(0.1, 0.1), Settings({FRICTION: 0.5, "plant.level_deg": [1.0, 0.0]})],
        610: [Settings({"controller.kind": "lqr"})],
        700: [Back(0.3)],
    }
    # turn 611 is the one after the law was changed; the state kept at 500 is gone back to
    session = driven(load("circle"), script, 1100)
    assert session.driven == Driven.begun(load("circle"))
    common = min(session.record.length, calm.record.length)
    assert common > 850
    assert np.array_equal(rows(session)[:common], rows(calm)[:common])


def test_a_push_changes_the_ball_and_nothing_else(driven):
    session = driven(load("hold"), {50: [Push(0.1, -0.05)]}, 60)
    state = session.record["state"][:, 0]
    jump = state[50] - state[49]
    assert jump[[1, 5]] == pytest.approx([0.1, -0.05], abs=2e-3)
    assert np.abs(jump[[0, 2, 4, 6]]).max() < 1e-3


@pytest.mark.long
def test_another_law_goes_on_from_this_moment(played):
    session, _ = played
    assert session.driven.scenario.controller.kind == "pole_placement"
    assert len(session.driven.controllers) == 2
    assert np.abs(np.diff(session.record["state"][:, 0, 0])).max() < 5e-4
    assert np.isfinite(rows(session)).all()


@pytest.mark.parametrize("values", [{"controller.rho": 300.0}, {"observer.kind": "luenberger"}])
def test_what_is_chosen_again_as_it_was_changes_no_bit(driven, values):
    calm = driven(load("hold"), {20: [Goal(0.1, 0)]}, 200)
    session = driven(load("hold"), {20: [Goal(0.1, 0)], 100: [Settings(values)]}, 200)
    assert len(session.driven.controllers) == 2
    common = session.record.length
    assert common > 190
    assert np.array_equal(rows(session), rows(calm)[:common])


def test_of_two_states_at_one_moment_the_later_counts_and_what_follows_one_goes_with_it():
    states = States()
    for second in (*range(400), 399):
        states.keep(Kept(float(second), len(states.all), None, None, None))
    assert [each.time for each in states.all] == [0, *range(400 - MAX_SNAPSHOTS, 400)]
    assert not states.due(399.5)
    assert states.due(400.0)
    assert states.back_to(142.5).time == 142.0
    assert states.all[-1].time == 142.0
    assert states.back_to(5.0).time == 0.0


def test_a_saved_run_is_a_run_that_says_it_was_driven(played):
    _, folder = played
    (saved,) = open_run(folder)
    assert saved.metrics["outcome"] == "finished"
    assert saved.driven["pushes"] == [[0.5, 0.05, -0.02]]
    assert [each["controller"]["kind"] for each in saved.driven["controllers"]] == [
        "lqr",
        "pole_placement",
    ]
    metrics = json.loads((folder / "metrics.json").read_text())
    assert metrics["driven"]["goals"] == 3
    assert (folder / "picture.png").stat().st_size > 10_000


@pytest.mark.short("0.65-lqr")
@pytest.mark.parametrize(("at", "law"), [(0.65, "lqr"), (1.3, "pole_placement")])
def test_whatif_goes_on_from_it_with_the_law_of_the_moment(played, at, law):
    _, folder = played
    moment = moment_of(folder, at)
    assert not moment.exact  # no scenario says that it was pushed
    assert moment.scenario.controller.kind == law
    found = future(moment, branch(moment.scenario, at, at + 0.06, ()), ())
    assert found.max_difference < 1e-3


def test_what_cannot_be_is_said_in_a_line_and_changes_nothing(driven):
    told = []
    script = {
        0: [Save(Path("nowhere"))],
        20: [Settings({FRICTION: -1.0})],
        30: [Settings({"rig.period": 0.001})],
        40: [Settings({"controller.kind": "stable_inversion"})],
        50: [Settings({"controller.kind": "no_such"})],
    }
    session = driven(load("hold"), script, 60, tell=told.append)
    wrong = [each.message for each in told if each.wrong]
    assert wrong[0] == "the run has not started yet"
    assert FRICTION in wrong[1]
    assert wrong[2] == "rig.period: cannot be changed while a rig runs"
    assert "needs a path that is known ahead" in wrong[3]
    assert "no_such" in wrong[4]
    assert not Path("nowhere").exists()
    assert not any("\n" in each for each in wrong)
    calm = driven(load("hold"), {}, 60)
    assert np.array_equal(rows(session), rows(calm))


def test_a_ball_that_is_off_the_plate_ends_the_run_until_one_goes_back(driven):
    told = []
    # after the fall the loop stands still and asks on; the numbers are those of its questions
    script = {20: [Push(1.4, 0.0)], 1700: [Goal(0, 0)], 1701: [Back(np.inf)]}
    session = driven(load("hold"), script, 1800, tell=told.append)
    ended = next(each for each in told if each.ended)
    assert ended.ended.startswith(("fell", "aborted", "lost"))
    assert "the run has ended; go back first" in [each.message for each in told if each.wrong]
    assert told[-1].ended.startswith("finished")
    assert session.driven.pushes == ()
    assert 90 < session.record.length < 110


def test_however_hard_it_is_pushed_at_the_start_one_can_go_back_to_before_that(driven):
    told = []
    script = {0: [Push(1e308, -1e308)] * 3, 1700: [Back(np.inf)]}
    session = driven(load("hold"), script, 1800, tell=told.append)
    assert any(each.ended for each in told[:-1])
    assert f"pushed by {1000 * np.hypot(MAX_PUSH_M_S, MAX_PUSH_M_S):.0f} mm/s" in [
        each.message for each in told
    ]
    assert told[-1].ended.startswith("finished")
    assert session.driven.pushes == ()
    assert np.array_equal(rows(session), rows(driven(load("hold"), {}, session.record.length)))


def test_time_stands_still_while_it_is_paused(driven):
    pictures = []
    session = driven(
        load("hold"), {50: [Pause(True)], 500: [Pause(False)]}, 540, show=pictures.append
    )
    assert 85 <= session.record.length <= 95
    times = [each[0] for each in pictures]
    assert times == sorted(times)


@pytest.mark.long
def test_the_clean_model_goes_beside_without_friction(driven):
    pictures = []
    driven(load("circle"), {}, 1500, show=pictures.append)
    last = dict(zip(PICTURE_COLUMNS, pictures[-1], strict=True))
    assert last["time"] > 2.9
    assert last["ghost_error"] < 0.1 * last["error"]


@pytest.mark.long
def test_the_cure_follows_a_path_that_is_known_and_a_goal_that_nobody_knew_of(driven, tmp_path):
    told = []
    script = {
        20: [Settings({"controller.preview": 0.5})],
        100: [Goal(0.2, 0.0)],
        300: [Back(0.2)],
        502: [Goal(0.05, 0.0)],
        700: [Goal(-0.05, 0.02)],
        2600: [Save(tmp_path / "run")],
    }
    session = driven(load("cure"), script, 2600, tell=told.append)
    state = session.record["state"][:, 0]
    alone = run(load("cure", ["duration=0.4", "baseline=false"])).record["state"][:, 0]
    assert np.array_equal(state[:200], alone)
    assert [goal[1:] for goal in session.driven.goals.points] == [(0.05, 0.0), (-0.05, 0.02)]
    assert state[-1, 0::4] == pytest.approx([-0.05, 0.02], abs=2e-3)
    (wrong,) = [each.message for each in told if each.wrong]
    assert "which is laid from the start of a scenario that has it" in wrong
    (saved,) = open_run(tmp_path / "run")
    assert "laid_x" not in saved.rows  # what would have been laid if the goals had been known
    moment = moment_of(tmp_path / "run", 2.0)
    assert not moment.exact  # no scenario says when a goal was known


def test_a_plan_that_is_not_laid_anew_is_given_no_goal(driven):
    told = []
    lqr = {"controller.kind": "lqr", "observer.kind": "luenberger"}
    script = {5: [Goal(0.05, 0.0)], 8: [Settings(lqr), Goal(0.04, 0.0)]}
    session = driven(load("circle", ["controller.kind=tvlqr"]), script, 20, tell=told.append)
    assert [goal[1:] for goal in session.driven.goals.points] == [(0.04, 0.0)]
    (wrong,) = {each.message for each in told if each.wrong}
    assert "needs a path that is known ahead, which is no goal's" in wrong
    assert "stable_inversion" in wrong


@pytest.mark.parametrize(
    ("script", "last", "saved"),
    [
        ({}, 40, []),  # untouched: any run of the scenario is the same
        ({10: [Goal(0.05, 0.0)]}, 40, ["end"]),
        ({10: [Goal(0.05, 0.0)], 30: [Save(Path("asked"))]}, 40, ["asked", "end"]),
        ({10: [Goal(0.05, 0.0)], 30: [Pause(True)], 31: [Save(Path("asked"))]}, 40, ["asked"]),
        ({0: [Pause(True)], 1: [Settings({"plant.friction.rolling_mm": 0.1})]}, 3, []),
    ],
)
def test_what_is_not_saved_when_it_ends_is_saved_then(driven, script, last, saved):
    written = []
    script = {**script, last: [End(Path("end"))]}
    driven(load("hold"), script, last + 99, write=lambda _, folder: written.append(folder.name))
    assert written == saved
