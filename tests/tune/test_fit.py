"""`twin.tune.fit`: Fits of indicators. Runs are of a few seconds on the exact equations."""

import json
import math

import numpy as np
import pytest
from click.testing import CliRunner

from twin.base.errors import ScenarioError
from twin.base.shipped import shipped_in
from twin.cli.understand import fit as command
from twin.run.loop import simulate
from twin.study.experiments import Store
from twin.study.schema import MOTION_INDICATORS
from twin.tune.cells import (
    LOST_RESIDUAL,
    MEASURED_UNITS,
    FitTable,
    FittedParameter,
    Runs,
    cells,
    read,
    round_sample,
)
from twin.tune.fit import bootstrap, correlation, estimates, fit, search_from

GIVEN = """
title = "two numbers"
set = ["plant.kind=lagrange", "plant.step=0.002", "duration=3", "metrics.start=0.0"]
population = 8
generations = 8
restarts = 1

[parameters.friction]
key = "plant.friction.rolling_mm"
low = 0.05
high = 0.4
unit = "mm"

[parameters.play]
key = "plant.servo.backlash_deg"
low = 0.0
high = 1.0
unit = "deg"
"""
EXPERIMENT = """
[[experiments]]
name = "{name}"
scenario = "{scenario}"
group = "{group}"
set = ["{changed}"]
[experiments.measured]
phi_max_deg = {{ value = {phi}, relative = 0.05 }}
u1_max = {{ value = {u1}, relative = 0.1 }}
tracking_error_percent = {{ value = {e_tt}, uncertainty = 0.1 }}
"""
EXPERIMENTS = (
    ("slow", "circle", "a", "reference.omega=0.8"),
    ("fast", "circle", "b", "reference.omega=1.2"),
    ("other law", "circle", "c", "controller.kind=afl"),
)
TRUE = (0.21, 0.3)


def text(values):
    found = GIVEN
    for (name, scenario, group, changed), (phi, u1, e_tt) in zip(EXPERIMENTS, values, strict=True):
        found += EXPERIMENT.format(
            name=name, scenario=scenario, group=group, changed=changed, phi=phi, u1=u1, e_tt=e_tt
        )
    return found


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("fit")


@pytest.fixture(scope="module")
def made(folder):
    """A table of what a rig with known effects would have measured."""
    path = folder / "table.toml"
    path.write_text(text([(1.0, 1.0, 20.0)] * 3))
    about = read(str(path))
    runs = Runs(about, Store(folder / "truth"))
    found = [runs.indicators([(TRUE, i)])[TRUE, i] for i in range(3)]
    path.write_text(text([tuple(v.values()) for v in found]))
    return path


@pytest.mark.long
def test_known_effects_are_found_again_within_their_spread(made, folder):
    about = read(str(made))
    found = fit(about, Runs(about, Store(folder / "runs")))
    for each, true, fine in zip(found.estimates, TRUE, (0.01, 0.1), strict=True):
        assert each.low <= true <= each.high
        assert each.value == pytest.approx(true, abs=fine)
        assert each.verdict == "seen"
    assert found.chi2 < 2
    assert np.isfinite(found.held_out).all()
    assert set(found.folds) == set(found.chi2_without) == {"a", "b", "c"}


@pytest.mark.long
def test_a_fit_without_a_group_never_sees_its_numbers(made, folder):
    about = read(str(made))
    wrong = made.read_text().split("[[experiments]]")
    wrong[2] = wrong[2].replace("value = ", "value = 9")
    path = folder / "wrong.toml"
    path.write_text("[[experiments]]".join(wrong))
    other = read(str(path))
    store = Store(folder / "runs")
    one, two = fit(about, Runs(about, store)), fit(other, Runs(other, store))
    assert [c.measured for c in one.cells if c.group == "b"] != [
        c.measured for c in two.cells if c.group == "b"
    ]
    assert one.folds["b"] == two.folds["b"]
    assert one.folds["a"] != two.folds["a"]
    held = [k for k, c in enumerate(one.cells) if c.group == "b"]
    assert one.held_out[held].tolist() == two.held_out[held].tolist()


@pytest.mark.long
def test_an_interrupted_fit_goes_on_with_the_runs_it_has(made, folder, monkeypatch):
    about = read(str(made))
    first = fit(about, Runs(about, Store(folder / "runs")), leave_out=False)
    monkeypatch.setattr("twin.study.work.simulate", None)  # no finished run is made again
    again = Runs(about, Store(folder / "runs"))
    second = fit(about, again, leave_out=False)
    assert second.chi2 == first.chi2 < 2
    assert second.runs == first.runs > len(about.experiments)


@pytest.mark.long
def test_the_command_writes_a_page_and_prints_json(made, folder):
    out = folder / "out"
    arguments = [str(made), "--out", str(out), "--processes", "1", "--no-leave-out", "--json"]
    result = CliRunner().invoke(command, arguments)
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert [each["name"] for each in found["parameters"]] == ["friction", "play"]
    assert found["cells"][0].keys() >= {"experiment", "measured", "computed", "held_out"}
    assert "friction" in (out / "report.html").read_text()
    assert json.loads((out / "fit.json").read_text()) == found


@pytest.mark.long
@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('scenario = "circle"', 'scenario = "circel"', "scenario 'circel': not found"),
        ("phi_max_deg", "phi_max_dge", "no indicator 'phi_max_dge'; did you mean 'phi_max_deg'"),
        (", relative = 0.05", ', relative = 0.05, unit = "mm"', "cannot be in mm; allowed: deg"),
        ("relative = 0.05", "relative = 0.05, uncertainty = 1", "exactly one of uncertainty"),
        ("low = 0.05", "low = 0.5", "empty range"),
        ('name = "fast"', 'name = "slow"', "two of them are called 'slow'"),
        ('unit = "mm"', 'groups = ["z"]', "no 'z'"),
        ("plant.friction.rolling_mm", "plant.friction.roling_mm", "roling_mm"),
    ],
)
def test_a_mistake_in_a_table_is_one_line(made, folder, old, new, message):
    path = folder / "bad.toml"
    path.write_text(made.read_text().replace(old, new, 1))
    with pytest.raises(ScenarioError) as caught:
        Runs(read(str(path)), Store(folder / "runs"))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_fewer_measurements_than_parameters_are_refused(folder):
    path = folder / "few.toml"
    path.write_text(
        GIVEN + '[[experiments]]\nscenario = "circle"\n'
        "[experiments.measured]\nphi_max_deg = { value = 1.0, relative = 0.1 }\n"
    )
    with pytest.raises(ScenarioError, match="1 measured indicator cannot determine 2 parameters"):
        read(str(path))
    with pytest.raises(ScenarioError, match="not found"):
        read(str(folder / "none.toml"))


def test_every_indicator_of_a_run_can_be_measured_and_in_other_units():
    assert set(MEASURED_UNITS) == set(MOTION_INDICATORS)
    table = FitTable.model_validate(
        {
            "title": "t",
            "parameters": {"a": {"key": "duration", "low": 1, "high": 2}},
            "experiments": [
                {
                    "scenario": "step",
                    "measured": {
                        "steady_error": {"value": 15.0, "uncertainty": 6.0, "unit": "mm"},
                        "phi_max_deg": {"value": 0.05, "relative": 0.1, "unit": "rad"},
                    },
                }
            ],
        }
    )
    error, angle = cells(table)
    assert (error.measured, error.scale) == pytest.approx((0.015, 0.006))
    assert angle.measured == pytest.approx(math.degrees(0.05))
    assert error.residual(0.027) == pytest.approx(2.0)
    assert angle.residual(math.degrees(0.05) * math.exp(0.3)) == pytest.approx(3.0)
    assert error.residual(float("nan")) == LOST_RESIDUAL


@pytest.mark.long
def test_a_factor_acts_on_its_groups_and_on_what_was_fitted_before(made, folder):
    about = read(str(made))
    extra = FittedParameter(
        key="plant.friction.rolling_mm", low=0.5, high=2.0, relative=True, groups=("b",)
    )
    three = about.model_copy(update={"parameters": {**about.parameters, "day": extra}})
    runs = Runs(three, Store(folder / "runs"))
    arms = [
        runs.scenario((0.2, 0.0, 1.5), each).plant.friction.rolling_mm for each in three.experiments
    ]
    assert arms == pytest.approx([0.2, 0.3, 0.2])


@pytest.mark.long
def test_what_the_rigs_computer_sees_is_judged_not_the_truth(made, folder):
    about = read(str(made))
    runs = Runs(about, Store(folder / "runs"))
    scenario = runs.scenario(TRUE, about.experiments[0])
    (true,), (seen,) = simulate([scenario]), simulate([scenario], seen=True)
    judged = runs.indicators([(TRUE, 0)])[TRUE, 0]
    assert judged == {name: seen[name] for name in about.experiments[0].measured}
    error = "tracking_error_percent"
    assert judged[error] != pytest.approx(true[error], rel=1e-3)
    counts = judged["phi_max_deg"] / 360 * scenario.sensors.encoders.counts
    assert counts == pytest.approx(round(counts), abs=1e-6)


class Bowl:
    """Runs of a formula: two indicators that are known functions of two parameters."""

    finished = 0

    def __init__(self, table):
        self.table = table

    def indicators(self, wanted):
        return {
            (x, i): {"phi_max_deg": 1 + x[0] + i * x[1], "u1_max": math.exp(x[1])}
            for x, i in wanted
        }


def bowl(parameters=("p", "q")):
    return FitTable.model_validate(
        {
            "title": "bowl",
            "generations": 60,
            "parameters": {n: {"key": "duration", "low": -1, "high": 3} for n in parameters},
            "experiments": [
                {
                    "scenario": "step",
                    "name": f"{i}",
                    "measured": {
                        "phi_max_deg": {"value": 1.5 + 0.7 * i, "uncertainty": 0.1},
                        "u1_max": {"value": math.exp(0.7), "relative": 0.1},
                    },
                }
                for i in range(3)
            ],
        }
    )


@pytest.mark.parametrize("start", [(1.5, 1.5), (-1.0, 3.0)])
def test_a_search_finds_the_bottom_of_a_formula(start):
    table = bowl()
    chi2, best = search_from(table, cells(table), start, Bowl(table))
    assert best == pytest.approx((0.5, 0.7), abs=0.001)
    assert chi2 < 0.01


def test_a_group_without_which_too_little_is_measured_is_not_left_out():
    table = bowl()
    *most, last = table.experiments
    one = last.model_copy(update={"group": "b", "measured": {"u1_max": last.measured["u1_max"]}})
    most = [each.model_copy(update={"group": "a"}) for each in most]
    table = table.model_copy(update={"experiments": (*most, one)})
    assert set(fit(table, Bowl(table)).folds) == {"b"}


def test_the_shipped_tables_can_be_run(folder):
    for name in shipped_in("fits"):
        about = read(name)
        middle = tuple((p.low + p.high) / 2 for p in about.parameters.values())
        runs = Runs(about, Store(folder / "runs"))
        assert all(runs.scenario(middle, each) for each in about.experiments)
    assert len(shipped_in("fits")) > 0


def test_a_sample_is_rounded_to_what_is_printed():
    table = bowl()
    assert round_sample(np.array([0.5123456, 2.0]), table) == (1.0494, 3.0)


def test_the_spread_is_that_of_least_squares_and_verdicts_follow_it():
    rng = np.random.default_rng(3)
    J = rng.normal(size=(400, 2)) * (3.0, 3.0)
    r = rng.normal(size=400)
    groups = [f"{k // 4}" for k in range(400)]
    moved = bootstrap(J, r, groups)
    expected = np.sqrt(np.diag(np.linalg.inv(J.T @ J)))
    assert moved.std(axis=0) == pytest.approx(expected, rel=0.2)
    table = bowl()
    seen = estimates(table, (1.0, 1.0), J, r, groups, [(0.9, 1.1), (1.2, 0.8)])
    assert [each.verdict for each in seen] == ["seen", "seen"]
    assert (seen[0].fold_low, seen[0].fold_high) == (0.9, 1.2)
    few = ["a"] * 200 + ["b"] * 200
    assert bootstrap(J, r, few).std(axis=0) == pytest.approx(expected, rel=0.1)
    blind = J * (1.0, 1e-3)
    assert estimates(table, (1.0, 1.0), blind, r, groups, [])[1].verdict == "not seen"
    twins = np.column_stack((J[:, 0], J[:, 0] + 1e-2 * J[:, 1]))
    assert abs(correlation(twins)[0, 1]) > 0.99
    assert estimates(table, (1.0, 1.0), twins, r, groups, [])[0].verdict == "confounded with q"
