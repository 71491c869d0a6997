import json

import pytest
from click.testing import CliRunner

from controllers.classical import SlidingMode
from twin.cli.understand import analyse

pytestmark = pytest.mark.long


def call(*arguments):
    result = CliRunner(env={"COLUMNS": "200"}).invoke(analyse, arguments, catch_exceptions=False)
    assert result.exit_code == 0
    return result.stdout


def test_json_has_poles_and_margins_of_the_loop_at_every_cut():
    content = json.loads(call("sine", "--json"))
    assert set(content) == {"scenario", "loop"}
    loop = content["loop"]
    assert loop["stable"]
    assert all(real < 0 for real, _ in loop["poles"])
    assert set(loop["margins"]) == {"u1", "u2", "x", "y"}
    for cut in loop["margins"].values():
        assert set(cut) >= {"gain_down", "gain_up", "phase", "disk", "delay"}
        assert cut["disk"] > 0


TOLD = {
    "sine": ("delay ms", "u1", "poles in 1/s"),
    f"sine controller.kind={SlidingMode.name}": ("has no linearisation",),
    "hold controller.kind=pole_placement controller.poles=[-30,-31,-32,-33]": (
        "the sampled loop is unstable about the level plate",
    ),
}


@pytest.mark.parametrize("asked", TOLD)
def test_people_get_tables_and_words(asked):
    scenario, *changes = asked.split()
    text = call(scenario, *(part for change in changes for part in ("--set", change)))
    assert all(words in text for words in TOLD[asked])


def test_full_state_feedback_is_analysed_too():
    ideal = ("--set", "observer.kind=ideal", "--set", "sensors.ideal=true")
    found = json.loads(call("sine", *ideal, "--json"))
    assert found["loop"]["observer"] == "ideal"
    assert found["loop"]["stable"]
