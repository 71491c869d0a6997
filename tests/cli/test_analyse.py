import json

import pytest
from click.testing import CliRunner

from controllers.nonlinear import SlidingMode
from twin.cli.analyse import analyse

SHORT = ("--set", "duration=0.5", "--set", "metrics.start=0.0")


def call(*arguments):
    result = CliRunner(env={"COLUMNS": "200"}).invoke(analyse, arguments, catch_exceptions=False)
    assert result.exit_code == 0
    return result.stdout


@pytest.fixture(scope="module")
def content():
    return json.loads(call("sine", *SHORT, "--json"))


@pytest.fixture
def quick(monkeypatch, content):
    """The same command with the slow, scenario-independent part remembered."""
    monkeypatch.setattr("controllers.analysis.designs.design_rows", lambda *_: content["designs"])


@pytest.mark.long
def test_json_is_one_object_with_every_part(content):
    parts = {"scenario", "designs", "neglected", "loop"}
    assert set(content) == parts


@pytest.mark.long
def test_thesis_poles_stand_beside_the_ones_found(content):
    rows = [row for row in content["designs"] if row["thesis_poles"]]
    assert len(rows) == 9
    for row in rows:
        found = row["poles_flat_model" if row["thesis_model"] == "flat" else "poles_linear_model"]
        thesis = sorted(real for real, _ in row["thesis_poles"])
        assert sorted(real for real, _ in found) == pytest.approx(thesis, rel=1e-4)


@pytest.mark.long
def test_every_design_has_all_margins_at_every_cut(content):
    for row in content["designs"]:
        for cut in row["margins"].values():
            assert set(cut) >= {"gain_down", "gain_up", "phase", "disk", "delay"}
            assert cut["disk"] > 0


@pytest.mark.long
def test_the_neglected_terms_are_small_beside_the_main_ones(content):
    rows = [row for row in content["neglected"]["whole"] if row["terms"] == "neglected"]
    assert len(rows) == 2
    assert all(0 < row["rms_ratio"] < 0.05 for row in rows)


@pytest.mark.long
def test_people_get_tables_with_equation_numbers_and_both_values(monkeypatch, content):
    monkeypatch.setattr("controllers.analysis.designs.design_rows", lambda *_: content["designs"])
    text = call("sine", *SHORT)
    for words in ("thesis", "flat (6.44)", "(6.42a)", "delay ms", "8.1"):
        assert words in text


@pytest.mark.long
@pytest.mark.usefixtures("quick")
def test_a_law_without_linearisation_is_said_to_have_none():
    text = call("sine", *SHORT, "--set", f"controller.kind={SlidingMode.name}")
    assert "has no linearisation" in text


@pytest.mark.long
@pytest.mark.usefixtures("quick")
def test_an_unstable_loop_is_called_unstable():
    text = call(
        *("hold", "--set", "duration=0.1", "--set", "controller.kind=pole_placement"),
        *("--set", "controller.poles=[-30, -31, -32, -33]"),
    )
    assert "this loop is unstable" in text


@pytest.mark.long
@pytest.mark.usefixtures("quick")
def test_full_state_feedback_is_analysed_too():
    ideal = ("--set", "observer.kind=ideal", "--set", "sensors.ideal=true")
    found = json.loads(call("sine", *SHORT, *ideal, "--json"))
    assert found["loop"]["observer"] == "ideal"
    assert found["loop"]["stable"]


@pytest.mark.long
@pytest.mark.usefixtures("quick")
def test_a_ball_that_rests_has_no_ratio_but_an_answer():
    found = json.loads(
        call("hold", "--set", "duration=0.1", "--set", "plant.start.x=0.0", "--json")
    )
    assert found["neglected"]["whole"][0]["equation"] == "6.42a"
