"""`twin.study.schema`.

The shipped family of uncertain rigs: what is drawn, and that a batch of them is exact."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from scipy import stats

import ballplate as bp
from ballplate.changes import changes_of, scenario_of
from twin.base.errors import ScenarioError
from twin.cli.studies import study as command
from twin.run.loop import alike, simulate
from twin.scenario.load import load
from twin.study.schema import Parameter, Study, draw_rigs, read_family
from twin.study.work import Builder, points

FAMILY = read_family("uncertain")


def scenarios(kind, rigs):
    build = Builder("circle")
    fixed = [f"plant.kind={kind}", "plant.step=0.002", "duration=0.3", "metrics.start=0.1"]
    fixed += ["plant.start.x_rate=0.05", "plant.start.y_rate=0.05"]  # friction acts at once
    return [build((*fixed, f"seed={rig.seed}"), rig.point) for rig in rigs]


@pytest.mark.long
@pytest.mark.parametrize("kind", ["mujoco", "lagrange"])
def test_whatever_differs_in_the_family_a_rig_gives_the_same_bits_alone_and_in_a_batch(kind):
    rigs = scenarios(kind, draw_rigs(FAMILY, 5, 12))
    assert len({str(alike(each)) for each in rigs}) == 1, "they share a batch"
    whole = simulate(rigs)
    assert len({each["tracking_error_percent"] for each in whole}) == 12
    for some in ([0], [3, 7], [11, 4, 0]):
        assert simulate([rigs[i] for i in some]) == [whole[i] for i in some]


def test_a_rig_does_not_depend_on_how_many_are_drawn_and_no_two_draws_share_one():
    few, many, others = (
        draw_rigs(FAMILY, 1, 8),
        draw_rigs(FAMILY, 1, 200),
        draw_rigs(FAMILY, 2, 200),
    )
    assert few == many[:8]
    points = [tuple(rig.point.values()) for rig in (*many, *others)]
    assert len(set(points)) == 400
    assert len({rig.seed for rig in (*many, *others)}) == 400


def test_rigs_are_distributed_as_the_family_says():
    rigs = draw_rigs(FAMILY, 3, 400)
    columns = {key: np.array([rig.point[key] for rig in rigs]) for key in FAMILY.parameters}
    for key, about in FAMILY.parameters.items():
        if not about.continuous:
            continue
        low, high = about.ends
        shares = (columns[key] - low) / (high - low)
        if about.loguniform is not None:
            shares = np.log(columns[key] / low) / np.log(high / low)
        assert stats.kstest(shares, "uniform").pvalue > 1e-3, key
    assert np.mean(columns["sensors.touch.frame_rate"] == 58) == pytest.approx(0.5, abs=0.1)
    level = stats.pearsonr(columns["plant.level_deg.0"], columns["plant.level_deg.1"])
    assert level.pvalue > 1e-3, "drawn independently"


def test_integers_reach_both_ends_and_nothing_beyond():
    about = Parameter(integers=(3, 5))
    assert about.at(np.array([0.0, 0.34, 0.99, 1.0])).tolist() == [3, 4, 5, 5]


def test_a_grid_over_whole_numbers_has_each_once():
    about = {"title": "t", "scenario": "hold", "method": "grid", "samples": 16}
    study = Study.model_validate({**about, "parameters": {"seed": {"integers": [1, 5]}}})
    assert points(study).columns["seed"].tolist() == [1, 2, 3, 4, 5]


def test_a_study_takes_the_parameters_of_a_family_and_its_own_over_them():
    tables = {"title": "t", "scenario": "circle", "method": "montecarlo", "family": "uncertain"}
    own = {"plant.friction.rolling_mm": {"uniform": [0.3, 0.4]}}
    study = Study.model_validate({**tables, "parameters": own})
    assert study.parameters.keys() == FAMILY.parameters.keys()
    assert study.parameters["plant.friction.rolling_mm"].uniform == (0.3, 0.4)
    assert Study.model_validate(tables).parameters == FAMILY.parameters


STUDY = """
title = "short"
scenario = "circle"
set = ["plant.kind=lagrange", "plant.step=0.002", "duration=0.2", "metrics.start=0.1"]
method = "montecarlo"
samples = 6
family = "uncertain"
"""


@pytest.mark.long
def test_a_study_over_the_family_runs(tmp_path):
    file = tmp_path / "short.toml"
    file.write_text(STUDY)
    arguments = [str(file), "--processes", "1", "--out", str(tmp_path / "out"), "--json"]
    result = CliRunner().invoke(command, arguments)
    assert result.exit_code == 0, result.output
    (found,) = json.loads(result.stdout)["variants"].values()
    assert (found["runs"], found["failed"]) == (6, 0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('title = "t"\n[parameters]\n', "family.toml: parameters: name at least one"),
        ('title = "t"\nrigs = 3\n[parameters]\n', "rigs: unknown key (known: title, parameters)"),
        (
            'title = "t"\n[parameters."duration"]\nunifrom = [1, 2]\n',
            "parameters.duration.unifrom: unknown key; did you mean 'uniform'",
        ),
    ],
)
def test_a_mistake_in_a_family_is_one_line(tmp_path, text, message):
    file = tmp_path / "family.toml"
    file.write_text(text)
    with pytest.raises(ScenarioError) as caught:
        read_family(str(file))
    assert message in str(caught.value)


def test_rigs_from_python_are_those_of_a_draw_as_settings_of_a_run():
    family = read_family("uncertain")
    drawn = draw_rigs(family, 5, 3)
    rigs = bp.family("uncertain", 3, draw=5)
    for rig, settings in zip(drawn, rigs, strict=True):
        assert settings["seed"] == rig.seed
        assert settings["plant.level_deg"] == [
            rig.point["plant.level_deg.0"],
            rig.point["plant.level_deg.1"],
        ]
        chosen = scenario_of("circle", changes_of(settings, {}))
        assert chosen.plant.level_deg == tuple(settings["plant.level_deg"])
        assert chosen.plant.friction.rolling_mm == rig.point["plant.friction.rolling_mm"]
    assert bp.family("uncertain", 1, draw=5) == rigs[:1]
    assert bp.family("uncertain", 1, draw=6) != rigs[:1]


def test_an_entry_that_is_not_drawn_is_the_default_s_and_tables_serve_as_a_family():
    tables = {"title": "tilted", "parameters": {"plant.level_deg.1": {"values": [0.25]}}}
    (rig,) = bp.family(tables, 1)
    assert rig["plant.level_deg"] == [0.0, 0.25]


def test_factors_of_a_family_are_multiplied_out_by_the_scenario():
    tables = {
        "title": "heavy",
        "parameters": {"plant.ball.mass": {"values": [2.0], "relative": True}},
    }
    (rig,) = bp.family(tables, 1)
    assert rig["plant.ball.mass"] == pytest.approx(2 * load("circle").plant.ball.mass)


@pytest.mark.parametrize(
    ("how", "words"),
    [
        (("uncertai", 1), "family 'uncertai': not found; did you mean 'uncertain'?"),
        (("uncertain", 0), "family: count must be a whole number from 1 to 100000, got 0"),
        (("uncertain", 1, -1), "family: draw must be a whole number from 0 to 100000, got -1"),
        (("uncertain", 1.0), "family: count must be a whole number"),
        (({"title": "x"}, 1), "family: parameters: missing"),
    ],
)
def test_a_family_that_cannot_be_drawn_is_one_line(how, words):
    with pytest.raises(bp.TwinError) as caught:
        bp.family(*how[:2], draw=how[2] if len(how) > 2 else 0)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
