"""`twin.view.summary`: A run is judged only while it was driven, and only by what it shows."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from twin.base.errors import ScenarioError
from twin.hal.supervisor import State
from twin.run.files import STREAM_FILE
from twin.run.finished import run, run_metadata
from twin.run.metrics import Ending, Motion, Outcome, measure
from twin.run.opened import open_run
from twin.run.record import stream
from twin.scenario.derived import cut_short
from twin.scenario.load import load
from twin.shadow.report import sentences
from twin.view.summary import Diagnosis, describe_run, spectrum, summary

CIRCLE = ("plant.kind=lagrange", "plant.step=0.002", "metrics.start=0")


@pytest.fixture(scope="module")
def whole():
    return run(load("circle", [*CIRCLE, "duration=3"]))


@pytest.fixture
def stopped(whole):
    """The same run stopped at 2 s, after which its ball is believed to run away."""
    time = whole.rows["time"]
    away = np.where(time > 2.003, 20.0 * (time - 2.0), 0.0)
    rows = dict(whole.rows)
    rows |= {name: rows[name] + away for name in ("true_x", "estimated_x", "true_y")}
    rows["supervisor"] = np.where(time > 2.0, State.HOLDING, State.RUNNING).astype(float)
    rows["touched"] = np.where(time > 2.0, 0.0, 1.0)
    outcome = Outcome(Ending.ABORTED, 2.0, "ball too fast")
    found = replace(whole, rows=rows, metrics={})
    return replace(found, metrics=measure(found.motion, outcome))


def same_until(whole, end):
    """The numbers of a run that went on to a time only."""
    return measure(whole.motion.until(end), Outcome(Ending.ABORTED, end))


def test_a_stopped_run_is_judged_up_to_its_stop(whole, stopped):
    alone = same_until(whole, 2.0)
    numbers = ("rms_error", "mean_error", "tracking_error_percent", "rms_distance", "u_rms")
    assert [stopped.metrics[each] for each in numbers] == [alone[each] for each in numbers]
    found = Diagnosis.of(stopped)
    assert found.rms == pytest.approx(alone["rms_distance"])
    assert found.untouched == 0.0
    angle = (
        np.abs(whole.rows["true_phi"][:1001]).max(),
        np.abs(whole.rows["true_theta"][:1001]).max(),
    )
    assert found.angle == max(angle) / whole.limits.angle
    assert "stuck" not in " ".join(summary(stopped, found))
    assert spectrum(stopped)[1].max() < 0.2


def test_what_lies_still_after_a_stop_is_no_end_of_an_approach():
    time = 0.002 * np.arange(2000)
    ball = np.where(time < 1.0, 0.05 * time, 0.3)[:, None] * [1.0, 0.0]
    motion = Motion(
        time=time,
        ball=ball,
        plate=np.zeros((2000, 2)),
        u=np.where(time < 1.0, 1.0, 9.0)[:, None] * [1.0, 1.0],
        reference=np.tile([0.1, 0.0], (2000, 1)),
    )
    found = measure(motion, Outcome(Ending.FAULT, 0.998, "drive"))
    assert found["overshoot_percent"] == 0.0
    assert found["steady_error"] == pytest.approx(0.1 - 0.05 * 0.998)
    assert found["u1_max"] == 1.0


def test_a_killed_run_is_judged_up_to_where_its_rig_had_been_stopped(whole, stopped, tmp_path):
    about = run_metadata(whole.scenario)
    with stream([*stopped.rows], tmp_path / STREAM_FILE, whole.units, about) as append:
        append(stopped.rows)
    (found,) = open_run(tmp_path)
    assert found.metrics["reason"].endswith("the rig had been stopped before")
    assert found.metrics["outcome_time"] == pytest.approx(2.002)
    expected = same_until(whole, 2.002)["rms_error"]
    assert found.metrics["rms_error"] == pytest.approx(expected)


def test_a_reason_that_is_a_question_ends_as_one(stopped):
    """The reason of an unplugged screen asks whether it was unplugged."""
    asked = stopped.metrics | {"reason": "screen gone; was it unplugged?"}
    assert describe_run(replace(stopped, metrics=asked)).endswith("was it unplugged?")
    told = stopped.metrics | {"reason": "screen gone"}
    assert describe_run(replace(stopped, metrics=told)).endswith("screen gone.")


@pytest.mark.short("0.3", "1")
@pytest.mark.parametrize("duration", [0.3, 1, 4])
def test_a_part_of_a_round_has_no_lag_and_no_scale(duration):
    short = run(load("circle", [*CIRCLE, f"duration={duration}"]))
    found = Diagnosis.of(short)
    assert (found.lag, found.gain, found.rest) == (None, None, None)
    assert 0.0 < found.turned < 0.75 * duration  # it begins softly
    assert "smaller" not in describe_run(short)
    assert ("less than once round" in describe_run(short)) is (found.rms > 1e-4)


@pytest.mark.long
def test_a_whole_round_has_both():
    fast = ["reference.amplitude=0.05", "reference.omega=3.0", "metrics.start=3"]
    found = Diagnosis.of(run(load("circle", [*CIRCLE[:2], *fast, "duration=6"])))
    assert found.turned == pytest.approx(3 * 3.0, rel=0.01)
    assert found.lag is not None
    assert found.gain is not None


@pytest.mark.parametrize(
    "settings",
    [
        "rig.period=2",
        "rig.period=0.45",
        "rig.limits.acceleration=400000",
        "rig.limits.angle_deg=0.0001",
    ],
)
def test_a_period_in_which_no_plate_can_be_moved_is_refused(settings):
    more = ["plant.step=0.002"] if "period" not in settings else ["plant.step=0.001"]
    with pytest.raises(ScenarioError, match=r"rig\.period: must be less than .* never be moved"):
        load("circle", [settings, *more])


def test_just_below_that_period_a_plate_moves():
    chosen = load("circle", [*CIRCLE, "rig.period=0.4", "plant.step=0.001", "duration=8"])
    assert np.abs(run(chosen).motion.plate).max() > 1e-4


def test_a_run_whose_commands_were_all_cut_to_nothing_says_so(whole):
    rows = dict(whole.rows)
    rows |= {f"applied_{axis}_acc": 0 * rows["time"] for axis in ("phi", "theta")}
    assert "the plate was never moved" in describe_run(replace(whole, rows=rows))
    assert "never moved" not in describe_run(whole)


def test_a_log_that_gaps_cut_up_is_not_called_one_of_a_ball_at_rest():
    seen = {"verdict": "cannot tell", "moved_s": 0.0, "length": 25.0, "taught": "", "alarms": []}
    seen |= {"score_median": None, "inside_band": None, "error_1s": None, "replays": None}
    seen |= {"wall_note": "", "foreign": False, "differences": ()}
    (still,) = sentences(SimpleNamespace(**seen, gaps=np.zeros((0, 2))))
    cut, gaps = sentences(SimpleNamespace(**seen, gaps=np.tile([1.0, 1.1], (263, 1))))
    assert "moved for 0 of the log's 25 usable seconds" in still
    assert "moved for" not in cut
    assert cut.startswith("Cannot tell: gaps cut the log up, and only 0 of its 25 usable seconds")
    assert gaps.startswith("The log has 263 gaps")
    learned = seen | {"taught": "The first 20 s moved the twin to this log."}
    (after,) = sentences(SimpleNamespace(**learned, gaps=np.zeros((0, 2))))
    assert "the first 20 of the log's 25 usable seconds; after them the ball moved for" in after
    seen |= {"taught": "The first 20 s moved the twin to this log.", "moved_s": 4.96}
    (nearly,) = sentences(SimpleNamespace(**seen, gaps=np.zeros((0, 2))))
    assert "less than the 5 s that are needed (4.96 s)" in nearly
    assert "at rest" not in after


@pytest.mark.parametrize(
    ("moved_s", "length_s", "taught", "needed_s"),
    [
        (4.96, 25.0, "The twin learned.", 30),  # 20 s, and 5 s of a ball that moves all the time
        (2.5, 25.0, "The twin learned.", 35),  # of one that moves half of the time
        (2.0, 2.5, "", 10),
        (3.96, 4.0, "", 10),
        (0.5, 25.0, "The twin learned.", None),  # more of a ball that rests shows no more
        (0.0, 60.0, "", None),
    ],
)
def test_a_log_that_is_too_short_for_a_verdict_says_how_long_to_record(
    moved_s, length_s, taught, needed_s
):
    seen = {"verdict": "cannot tell", "moved_s": moved_s, "length": length_s, "taught": taught}
    seen |= {"score_median": None, "inside_band": None, "error_1s": None, "replays": None}
    seen |= {"wall_note": "", "foreign": False, "differences": (), "gaps": (), "alarms": []}
    (said,) = sentences(SimpleNamespace(**seen))
    assert ("Record at least" in said) == (needed_s is not None)
    assert needed_s is None or f" Record at least {needed_s} s (a run: --set duration=" in said


def test_a_twin_that_learned_calls_healthy_only_what_came_later(monkeypatch):
    monkeypatch.setattr("twin.shadow.report.indistinguishable", lambda _: [])
    seen = {"verdict": "healthy", "moved_s": 40.0, "length": 60.0, "alarms": [], "wall_note": ""}
    seen |= {"score_median": None, "inside_band": None, "error_1s": None, "replays": None}
    seen |= {"foreign": False, "differences": ()}
    gaps, moved = np.zeros((0, 2)), "The first 20 s moved the twin to this log."
    (known,) = sentences(SimpleNamespace(**seen, taught="", gaps=gaps))
    assert known.startswith("Healthy as far as the log shows: in 40 of its 60")
    later, how = sentences(SimpleNamespace(**seen, taught=moved, gaps=gaps))
    assert later.startswith("Healthy as far as the log shows after its first 20 s: in 40 of its 60")
    assert how == moved


def test_a_scenario_that_is_cut_short_is_the_beginning_of_the_whole(whole):
    part = run(cut_short(whole.scenario, 0.5))
    assert part.end == pytest.approx(0.5)
    for name, values in part.rows.items():
        assert np.array_equal(values, whole.rows[name][: len(values)], equal_nan=True)
    assert cut_short(whole.scenario, 0.0).duration == 0.002


@pytest.mark.parametrize("seconds", [0.004, 0.1, 0.5])
def test_a_goal_that_has_not_left_the_middle_yet_is_no_measure_of_an_error(seconds):
    told = describe_run(run(load("circle", [*CIRCLE, f"duration={seconds}"])), clean=99.0)
    assert "Tracking error" not in told
    assert "no verdict: its goal was within 0.1 mm of the middle" in told
    assert "no limit was in the way" not in told


def test_of_a_ball_that_no_limit_held_the_sentence_ends_with_its_error():
    told = describe_run(run(load("hold", [*CIRCLE, "duration=0.1"])))
    assert told.endswith(("x and y.", " s on."))
