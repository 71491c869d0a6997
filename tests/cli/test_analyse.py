import json

import pytest
from click.testing import CliRunner

from controllers.classical import SlidingMode
from twin.cli.analyse import analyse

SHORT = ("--set", "duration=0.5", "--set", "metrics.start=0.0")

pytestmark = pytest.mark.long


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
    monkeypatch.setattr("controllers.analysis.design_rows", lambda *_: content["designs"])


def test_json_has_designs_beside_those_of_the_thesis_their_margins_and_what_is_left_out(content):
    assert set(content) == {"scenario", "designs", "neglected", "loop"}
    rows = [row for row in content["designs"] if row["thesis_poles"]]
    assert len(rows) == 9
    for row in rows:
        found = row["poles_flat_model" if row["thesis_model"] == "flat" else "poles_linear_model"]
        thesis = sorted(real for real, _ in row["thesis_poles"])
        assert sorted(real for real, _ in found) == pytest.approx(thesis, rel=1e-4)
    for cut in (cut for row in content["designs"] for cut in row["margins"].values()):
        assert set(cut) >= {"gain_down", "gain_up", "phase", "disk", "delay"}
        assert cut["disk"] > 0
    rows = [row for row in content["neglected"]["whole"] if row["terms"] == "neglected"]
    assert len(rows) == 2
    assert all(0 < row["rms_ratio"] < 0.05 for row in rows)


TOLD = {
    "sine": ("thesis", "flat (6.44)", "(6.42a)", "delay ms", "8.1"),
    f"sine controller.kind={SlidingMode.name}": ("has no linearisation",),
    "hold controller.kind=pole_placement controller.poles=[-30,-31,-32,-33]": (
        "this loop is unstable",
    ),
}


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("asked", TOLD)
def test_people_get_tables_and_words(asked):
    scenario, *changes = asked.split()
    text = call(scenario, *SHORT, *(part for change in changes for part in ("--set", change)))
    assert all(words in text for words in TOLD[asked])


@pytest.mark.usefixtures("quick")
def test_full_state_feedback_is_analysed_too():
    ideal = ("--set", "observer.kind=ideal", "--set", "sensors.ideal=true")
    found = json.loads(call("sine", *SHORT, *ideal, "--json"))
    assert found["loop"]["observer"] == "ideal"
    assert found["loop"]["stable"]


@pytest.mark.usefixtures("quick")
def test_a_ball_that_rests_has_no_ratio_but_an_answer():
    found = json.loads(call("hold", *SHORT, "--set", "plant.start.x=0.0", "--json"))
    assert found["neglected"]["whole"][0]["equation"] == "6.42a"
