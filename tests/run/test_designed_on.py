"""`twin.run.assemble`.

The ball that law, observer and predictor are designed on is the one their designer knows."""

import json
from types import SimpleNamespace

import pyarrow.parquet as pq
import pytest

import ballplate as bp
from controllers.ballplate import BallPlate
from twin.base.shipped import shipped_scenarios
from twin.run.controller_building import build_controller
from twin.run.finished import record_run, run
from twin.run.loop import alike
from twin.run.opened import open_run
from twin.scenario import load
from twin.scenario.changing import at_time
from twin.scenario.schema import Scenario
from twin.study.work import Builder
from twin.tune.report import settings, toml

SOLID, HOLLOW = 5 / 7 * 9.81, 3 / 5 * 9.81
"""k1 of a solid ball and of a thin shell in m/s^2: g / (1 + J / (m r^2))."""
STEEL = "plant.ball.kind=steel"


def k1(scenario):
    """The k1 of law, observer and predictor, which must all have one."""
    controller = build_controller(scenario)
    models = [controller.law.model, controller.observer.model, controller.observer.observer.model]
    assert models[0] == models[1] == models[2]
    return models[0].k1


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        ((), HOLLOW),
        ((STEEL,), SOLID),
        ((STEEL, "controller.model=nominal"), HOLLOW),
        ((STEEL, "controller.model.kind=nominal"), HOLLOW),
        (("controller.model={mass=1.0, radius=0.01, inertia=4e-5}",), SOLID),
        ((STEEL, "controller.model.kind=nominal", "controller.model.inertia=3.84e-6"), SOLID),
        ((STEEL, "controller.model=nominal", "controller.kind=lqr"), HOLLOW),
    ],
    ids=str,
)
def test_a_controller_is_designed_on_the_ball_that_the_scenario_describes(overrides, expected):
    assert k1(load("circle", overrides)) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize(
    "known", ['"scenario"', '"nominal"', "{mass=0.1}", '{kind="nominal", mass=0.1, radius=0.02}']
)
def test_what_is_known_is_written_in_short_and_read_as_it_was(known):
    scenario = load("circle", (f"controller.model={known}",))
    written = json.loads(scenario.model_dump_json())
    assert Scenario.model_validate_json(scenario.model_dump_json()) == scenario
    if known.startswith('"'):
        assert written["controller"]["model"] == json.loads(known)


@pytest.mark.parametrize("known", ['"nominal"', '{kind="nominal", mass=0.1}'])
def test_what_is_known_is_among_the_keys_of_a_tuned_controller(known, tmp_path):
    scenario = load("circle", (f"controller.model={known}", STEEL))
    tune = SimpleNamespace(set=())
    keys = settings(SimpleNamespace(scenario=lambda *_: scenario, tune=tune), {})
    (tmp_path / "tuned.toml").write_text(toml(keys, []), encoding="utf-8")
    again = load("circle", (f"parameters={tmp_path / 'tuned.toml'}", STEEL))
    assert again.designed_on == scenario.designed_on


def test_the_plant_of_a_scenario_has_its_ball_whatever_the_designer_believes():
    plant = bp.model("circle", ["controller.model=nominal"], plant={"ball": {"kind": "steel"}})
    assert plant.k1 == pytest.approx(SOLID, rel=1e-3)


def test_a_change_of_the_ball_is_not_known_to_the_designer():
    scenario = load("circle", ('change=[{at=1, set={"plant.ball.mass"=0.1}}]',))
    assert at_time(scenario, 2.0).plant.ball.mass == 0.1
    assert scenario.designed_on == BallPlate()


def test_what_a_study_or_family_draws_of_the_ball_is_not_known_to_the_designer():
    build = Builder("circle")
    assert build((), {"plant.ball.inertia": 9e-6}).designed_on == BallPlate()
    # what all of its rigs have is known, and what it says of the designer holds
    rig = build((STEEL,), {"plant.ball.mass": 1.2}, {"plant.ball.mass"})
    assert rig.plant.ball.mass == pytest.approx(1.2 * 0.263)
    assert rig.designed_on == load("circle", (STEEL,)).designed_on
    told = {"plant.ball.inertia": 9e-6, "controller.model.inertia": 8e-6}
    assert build((), told).designed_on.inertia == 8e-6
    assert build((), {"plant.plate.height": 0.05}).designed_on == BallPlate()
    assert build(("plant.plate.height=0.05",), {}).designed_on == BallPlate(height=0.05)
    both = build(("plant.plate.height=0.05",), {"plant.ball.mass": 0.03, "plant.plate.height": 0.1})
    assert (both.plant.model.height, both.designed_on.height) == (0.1, 0.05)


def test_no_shipped_scenario_is_designed_on_another_ball_than_the_nominal_one():
    assert {load(name).designed_on for name in shipped_scenarios()} == {BallPlate()}


@pytest.mark.long
def test_a_steel_ball_is_tracked_better_by_what_is_designed_for_it():
    own = (STEEL, "plant.kind=lagrange", "plant.step=0.002", "duration=8", "metrics.start=4")
    told, untold = (
        run(load("circle", (*own, "controller.kind=afl", f"controller.model={known}"))).metrics
        for known in ("scenario", "nominal")
    )
    assert told["tracking_error_percent"] < untold["tracking_error_percent"]


def test_a_record_from_before_the_key_was_designed_on_the_nominal_ball(tmp_path):
    made = run(load("circle", (STEEL, "duration=0.1", "metrics.start=0.0")))
    record_run(made, tmp_path)
    assert open_run(tmp_path)[0].scenario.designed_on.k1 == pytest.approx(SOLID, rel=1e-3)
    file = tmp_path / "run.parquet"
    table = pq.read_table(file)
    metadata = json.loads(table.schema.metadata[b"ballplate"])
    del metadata["scenario"]["controller"]["model"]
    beside = table.schema.metadata | {b"ballplate": json.dumps(metadata).encode()}
    pq.write_table(table.replace_schema_metadata(beside), file)
    assert open_run(tmp_path)[0].scenario.designed_on == BallPlate()


def test_only_rigs_of_one_known_ball_share_a_batch():
    one, other = load("circle"), load("circle", (STEEL, "plant.friction.rolling_mm=0.18"))
    assert alike(one) != alike(other)
    assert alike(one) == alike(load("circle", ("plant.ball.mass=0.05", "controller.model=nominal")))
