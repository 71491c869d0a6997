import json
import math
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from controllers.backstepping import Backstepping
from controllers.feedback_linearization import AFL, AFLIntegral
from controllers.references.point import Step
from controllers.references.soft import Circle
from controllers.sliding_mode import SlidingMode
from controllers.state_feedback import LQR
from twin.cli.reproduce import reproduce as command
from twin.errors import ScenarioError
from twin.run.control import build_controller
from twin.scenario import load, shipped
from twin.thesis.experiments.batch import noise, on_rig, rolling, simulate
from twin.thesis.experiments.fit import ARMS, FrictionFit, best, fitted, identified, write
from twin.thesis.experiments.hypotheses import HYPOTHESES, circles, measured, summary
from twin.thesis.experiments.judge import e_tt
from twin.thesis.experiments.predict import goals, rows
from twin.thesis.experiments.tables import EARLY, chosen, tables

KEYS = {
    "table", "row", "column", "thesis", "predicted", "frictionless", "calibration", "note",
    "low", "high",
}  # fmt: skip


LAWS = {
    ("9.1",): LQR(rho=100.0, kappa=0.1),
    ("9.2", "9.3"): AFL(gains=(180.0, 162.0, 66.0, 13.0)),
    ("9.4", "9.5"): AFLIntegral(gains=(200.0, 132.0, 51.0, 12.0, 4.0)),
    ("9.6", "9.7"): Backstepping(c=(2.0, 3.0, 4.0, 5.5)),
    ("9.8", "9.9"): SlidingMode(alpha=1.5, epsilon=0.3, betas=(1.5, 3.0, 5.0)),
}
"""The thesis's laws of chapter 9 by table."""


@pytest.fixture(scope="module")
def stabilised():
    return {row["column"]: row for row in rows(["9.1"], mechanism=False, duration=5.0)}


def test_all_125_numbers_of_the_9_tables_are_there():
    assert list(tables()) == [f"9.{number}" for number in range(1, 10)]
    assert sum(len(experiment.cells) for experiment in chosen()) == 5 + 8 * 15


def test_a_table_that_does_not_exist_is_refused_by_name():
    with pytest.raises(ScenarioError, match=r"no table '9\.10'.*9\.1, 9\.2"):
        chosen(["9.10"])


def test_every_experiment_has_a_scenario_with_its_law_path_and_predictor():
    found = {name for name in shipped() if name.startswith("thesis/9_")}
    assert found == {experiment.scenario for experiment in chosen()}
    assert len(found) == 25
    laws = {name: law for names, law in LAWS.items() for name in names}
    for experiment in chosen():
        scenario = load(experiment.scenario)
        controller = build_controller(scenario)
        assert controller.law == laws[experiment.table]
        if experiment.table == "9.1":
            path = Step(end=(0.15, 0.15))
        else:
            path = Circle(amplitude=0.15, omega=float(experiment.name.split()[-1]))
        assert controller.reference.original == path
        assert (scenario.predictor is not None) == (experiment.table in EARLY)
        assert scenario.predictor is None or scenario.predictor.delay == 0.042
        assert scenario.plant.kind == "mujoco"
        assert scenario.plant.friction.rolling_mm / 1000 == pytest.approx(identified().rolling)


@pytest.mark.long
def test_only_the_three_tracking_errors_of_table_9_3_are_calibration(stabilised):
    assert set(stabilised["e_ss"]) == KEYS
    assert not any(row["calibration"] for row in stabilised.values())
    cells = [("9.3", "e_tt")] * 3
    marked = [
        (experiment.table, column)
        for experiment in chosen()
        for column in experiment.cells
        if experiment.table == "9.3" and column == "e_tt"
    ]
    assert marked == cells


@pytest.mark.long
def test_friction_leaves_the_ball_short_of_its_goal_as_on_the_rig(stabilised):
    assert stabilised["overshoot"]["predicted"] == stabilised["overshoot"]["thesis"] == 0
    assert stabilised["e_ss"]["frictionless"] < 0.001
    assert stabilised["e_ss"]["predicted"] == pytest.approx(0.015, abs=0.010)


def test_the_fit_finds_the_arm_that_made_the_errors_and_its_interval_is_students():
    arms = np.array(ARMS)
    slopes, truth = np.array([1e5, 0.9e5, 0.8e5]), 0.171e-3
    errors = slopes[:, None] * arms
    exact = fitted(errors, list(slopes * truth), "estimate", 0.0)
    assert exact.rolling == pytest.approx(truth, rel=1e-6)
    off = np.array([0.3, -0.2, 0.1])
    noisy = fitted(errors, list(slopes * truth + off), "estimate", 0.0)
    # closed form of linear least squares through the origin
    arm = truth + (slopes * off).sum() / (slopes**2).sum()
    left = slopes * (truth - arm) + off
    half = 4.302652729911275 * np.sqrt((left**2).sum() / 2 / (slopes**2).sum())
    assert noisy.rolling == pytest.approx(arm, rel=1e-6)
    assert noisy.high - noisy.low == pytest.approx(2 * half, rel=1e-5)
    assert noisy.spread == pytest.approx(np.sqrt((left**2).sum() / 2), rel=1e-5)


def test_the_choice_of_reading_never_falls_on_the_truth_no_rig_knows():
    one = identified()
    tempting = replace(one, reading="truth", residual=(0.0, 0.0, 0.0))
    worse = replace(one, residual=(1.0, -1.0, 1.0))
    assert best([tempting, worse, one]) == one


def test_a_written_fit_reads_back_as_it_was(tmp_path):
    import tomllib

    write(identified(), tmp_path / "fit.toml")
    data = tomllib.loads((tmp_path / "fit.toml").read_text())
    assert FrictionFit(**{**data, "residual": tuple(data["residual"])}) == identified()


@pytest.mark.long
def test_experiments_side_by_side_go_as_each_does_alone():
    pair = [next(row for row in chosen([name])) for name in ("9.3", "9.4")]
    rigs = [{**rolling(arm), **noise(0.0)} for arm in (0.1e-3, 0.2e-3)]
    together = simulate(pair, rigs, mechanism=False, duration=0.6)
    for i, experiment in enumerate(pair):
        for k, rig in enumerate(rigs):
            ((alone,),) = simulate([experiment], [rig], mechanism=False, duration=0.6)
            np.testing.assert_allclose(together[i][k].state, alone.state, atol=1e-9)
            np.testing.assert_allclose(together[i][k].estimate, alone.estimate, atol=1e-9)


def test_what_is_peculiar_to_a_rig_lies_over_the_scenario_and_an_epsilon_only_over_sliding_modes():
    rig = {**rolling(0.15e-3), **noise(10.0), "controller.epsilon": 0.15}
    sliding, other = (
        on_rig(name, rig, mechanism=False, duration=3.0)
        for name in ("thesis/9_8_050", "thesis/9_2_050")
    )
    assert build_controller(sliding).law == replace(LAWS["9.8", "9.9"], epsilon=0.15)
    assert build_controller(other).law == LAWS["9.2", "9.3"]
    for scenario in (sliding, other):
        assert scenario.plant.friction.rolling_mm == pytest.approx(0.15)
        assert scenario.sensors.touch.variance == pytest.approx((7.2538e-6, 1.7721e-6))
        assert (scenario.plant.kind, scenario.duration) == ("lagrange", 3.0)
    with pytest.raises(ScenarioError, match="unknown key"):
        on_rig("thesis/9_1", {"plant.servo.lag": 0.05}, mechanism=False, duration=3.0)


def test_a_run_that_ended_early_has_no_tracking_error():
    experiment = chosen(["9.8"])[0]
    ((trace,),) = simulate(
        [experiment], [{"plant.level_deg": (5.0, 5.0)}], mechanism=False, duration=4.0
    )
    assert math.isnan(e_tt(trace))


def test_a_perfect_prediction_reaches_every_goal_but_what_the_thesis_itself_breaks():
    perfect = [
        {
            "table": experiment.table, "row": experiment.name, "column": column,
            "thesis": value, "predicted": value,
        }
        for experiment in chosen()
        for column, value in experiment.cells.items()
    ]  # fmt: skip
    assert [goal.sentence for goal in goals(perfect) if not goal.reached] == []


def test_the_measured_errors_lie_two_points_higher_without_predictor():
    result = summary(HYPOTHESES[0], 0.0, measured())
    assert result.mean == result.worst == result.sliding == result.calibration == 0
    assert result.gap == pytest.approx(2.4, abs=0.5)
    assert len(circles()) == 24


def test_the_command_prints_one_json_list_with_the_promised_keys(monkeypatch):
    made = [dict.fromkeys(KEYS, 1.0)]
    monkeypatch.setattr("twin.thesis.experiments.predict.rows", lambda *_: made)
    result = CliRunner().invoke(command, ["9.1", "--json"], standalone_mode=False)
    assert set(json.loads(result.stdout)[0]) == KEYS


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["9.10"], "no table '9.10'; there are 8.1 to 8.21 and 9.1 to 9.9"),
        (["8.1", "--fit"], "--fit belongs to chapter 9"),
        (["9", "--out", "x.toml"], "--out belongs to --fit"),
        (["9.1", "--doc", "x.md"], "--doc of chapter 9 needs all its tables"),
        (["8.1", "9", "--doc", "x.md"], "--doc of chapter 9 needs all its tables"),
    ],
)
def test_a_request_that_makes_no_sense_is_refused_in_one_line(arguments, says):
    result = CliRunner().invoke(command, arguments, standalone_mode=False)
    assert isinstance(result.exception, ScenarioError)
    assert says in str(result.exception)
    assert "\n" not in str(result.exception)
