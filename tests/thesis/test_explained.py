import math

import numpy as np
import pytest
from click.testing import CliRunner

from twin.cli.reproduce import reproduce as command
from twin.fit.misfit import cells
from twin.fit.runs import Runs
from twin.study.store import Store
from twin.thesis.experiments.deciding import oscillation
from twin.thesis.experiments.explained import goals, rows, sample, stored
from twin.thesis.experiments.explanation import INDICATORS, PARAMETERS, table
from twin.thesis.experiments.ingredients import VARIANTS, _side_by_side
from twin.thesis.experiments.tables import LATE, chosen

KEYS = ["table", "row", "column", "thesis", "predicted", "explained", "held_out", "note"]


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    return Runs(table(), Store(tmp_path_factory.mktemp("explained")))


def made(error=0.0, late=0.0, angle=1.0):
    """Rows of every cell whose held-out values are off by known amounts."""
    found = []
    for experiment in chosen():
        for column, value in experiment.cells.items():
            if column not in INDICATORS:
                continue
            if column == "e_tt":
                held = value + error + (late if experiment.table in LATE else 0.0)
            else:
                held = angle * value
            row = (experiment.table, experiment.name, column, value, None, value, held, "")
            found.append(dict(zip(KEYS, row, strict=True)))
    return found


def test_the_fit_has_all_124_numbers_and_leaves_out_table_by_table():
    numbers = cells(table())
    assert len(numbers) == 124
    assert table().groups == tuple(f"9.{k}" for k in range(1, 10))
    (error,) = [c for c in numbers if c.label.startswith("9.1") and c.indicator == "steady_error"]
    assert (error.measured, error.scale) == (0.015, 0.006)
    circle = [c for c in numbers if c.label == "9.8, omega 1"]
    assert {c.indicator: (c.scale, c.logarithmic) for c in circle} == {
        "tracking_error_percent": (2.0, False),
        **dict.fromkeys(("phi_max_deg", "theta_max_deg", "u1_max", "u2_max"), (0.35, True)),
    }


def test_each_number_acts_where_it_should(runs):
    values = {"friction": 0.2, "without_predictor": 1.1, "start": 2.5, "play": 0.3}
    for each in table().experiments:
        scenario = runs.scenario(sample(values), each)
        late = each.own_group in LATE
        assert scenario.plant.friction.rolling_mm == pytest.approx(0.22 if late else 0.2)
        assert scenario.plant.servo.backlash_deg == 0.3
        assert scenario.reference.settings.get("start") == (
            None if each.own_group == "9.1" else 2.5
        )
        assert scenario.sensors.encoders.counts == 245760
        assert scenario.disturbance.variance == (0.0, 0.0)
        if each.own_group in {"9.8", "9.9"}:
            assert scenario.controller.settings["epsilon"] == 0.1


def test_goals_are_judged_by_what_was_held_out():
    perfect = goals(made(late=0.0))
    assert [goal.reached for goal in perfect] == [True] * 9
    far = {goal.sentence.split(":")[0]: goal for goal in goals(made(error=1.7, angle=1.2))}
    assert not far["24 tracking errors"].reached
    assert far["24 tracking errors"].found == "1.700"
    assert not far["plate angles"].reached
    every, aside = goals(made(late=1.0))[-2:]
    assert (every.found, aside.found) == ("+3.39", "+3.17")
    assert not every.reached
    assert not aside.reached
    assert "(measured +2.39)" in every.sentence
    assert "(measured +2.17)" in aside.sentence
    assert all(goal.reached for goal in goals(made(error=1.7, angle=1.2), "explained")[:3])


def test_the_stored_numbers_lie_in_their_ranges_and_every_table_was_left_out():
    known = stored()
    assert set(known["without"]) == {f"9.{k}" for k in range(1, 10)}
    for values in (known["all"], *known["without"].values()):
        for name, about in PARAMETERS.items():
            assert about.low < values[name] < about.high


@pytest.mark.long
def test_a_table_explained_has_the_keys_and_its_own_fold():
    found = rows([], ["9.1"])
    assert [list(row) for row in found] == [KEYS] * 4
    assert [row["column"] for row in found] == ["phi_max", "u1_max", "e_ss", "overshoot"]
    assert all(row["predicted"] is None for row in found)
    same = {**stored(), "without": dict.fromkeys(stored()["without"], stored()["all"])}
    again = rows([], ["9.1"], fitted=same)
    assert [row["explained"] for row in again] == [row["explained"] for row in found]
    assert [row["held_out"] for row in again] == [row["explained"] for row in again]


def test_variants_side_by_side_leave_out_what_they_say(tmp_path):
    about = _side_by_side()
    runs = Runs(about, Store(tmp_path))
    values = (0.2, 1.1, 2.5, 0.3)
    for index, variant in enumerate(VARIANTS):
        (late,) = [e for e in about.experiments if e.label == f"{index}: 9.8, omega 1"]
        scenario = runs.scenario(values, late)
        assert scenario.plant.friction.rolling_mm == pytest.approx(
            0.2 if "without_predictor" in variant.without else 0.22
        )
        assert scenario.plant.servo.backlash_deg == (0.0 if "play" in variant.without else 0.3)
        assert ("start" in scenario.reference.settings) == ("start" not in variant.without)
        assert scenario.controller.settings["epsilon"] == (0.1 if variant.case_2 else 0.3)


def test_the_oscillation_is_found_beside_the_reference():
    time = np.arange(0, 25, 0.01)
    angle = 0.02 * np.sin(0.75 * time) + 0.004 * np.sin(2 * math.pi * 0.8 * time)
    frequency, amplitude = oscillation(time, angle, 0.75)
    assert frequency == pytest.approx(0.8, abs=0.07)
    assert amplitude == pytest.approx(0.004 / math.sqrt(2), rel=0.1)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["8", "--explained"], "--explained belongs to chapter 9"),
        (["9.3", "--explained", "--fit"], "needs all tables of chapter 9"),
        (["9", "--explained", "--out", "x.toml"], "--out belongs to --fit"),
    ],
)
def test_options_that_do_not_go_together_are_refused(arguments, message):
    result = CliRunner().invoke(command, arguments)
    assert result.exit_code
    assert message in str(result.exception)
