"""`twin.cli.planning`: The options of `identify --plan`, and their mistakes in one line."""

import json

import pytest

from twin.base.page import round_plainly
from twin.cli import main
from twin.plan.experiment import EXCITATIONS, RigChoice, axes_settings
from twin.plan.motion import describe_work

MISTAKES = {
    "identify": "LOG: give a log, or --plan",
    "identify --plan no.csv": "no.csv: --plan takes no LOG",
    "identify no.csv --seconds 30": "--seconds: needs --plan",
    "identify no.csv --scenario sine": "--scenario: needs --plan",
    "identify --plan --seconds 1": "--seconds: must be 5 to 600, got 1",
    "identify --plan --rigs 1000": "--rigs: must be 0 to 200, got 1000",
    "identify --plan --scenario cirle": "--scenario: scenario 'cirle': not found",
    "identify --plan --on no": "--on: rig 'no': not found",
    "identify --plan --parameters spring": "--parameters: cannot be forecast: spring",
    "identify --plan --ball hollow": "--ball: not allowed with --plan",
    "identify --plan --hold-out log.csv": "--hold-out: with --plan give one share",
    "identify no.csv --optimise": "--optimise: needs --plan",
    "identify --plan --table motion.csv": "--table: needs --optimise",
    "identify --plan --optimise --table motion.txt": "--table motion.txt: must end in .toml or",
    "identify no.csv --axes 1": "--axes: needs --plan",
    "identify --plan --axes 3": "Invalid value for '--axes': 3 is not in the range 1<=x<=2",
    "identify --plan --hold-out 0.9": "--hold-out: must be 0 to 0.8, got 0.9",
}


@pytest.mark.parametrize("line", MISTAKES)
def test_a_mistake_is_one_line(line, capsys):
    with pytest.raises(SystemExit) as ended:
        main(line.split())
    assert ended.value.code == 2
    (told,) = (each for each in capsys.readouterr().err.splitlines() if each[:9] == "ballplate")
    assert told.removeprefix("ballplate: ").startswith(MISTAKES[line])


@pytest.mark.parametrize(
    ("value", "text"),
    [(213.4, "210"), (0.000623, "0.00062"), (1.96, "2"), (31.0, "31"), (99.6, "100")],
)
def test_a_number_of_a_forecast_has_two_digits_and_no_exponent(value, text):
    assert round_plainly(value) == text


def test_the_work_of_a_plan_is_stated_before_it_is_done():
    """Three motions of 40 s on five rigs: 600 s of runs, 0.25 s of processor time each."""
    told = describe_work(0, 40.0, RigChoice(rigs=4), optimise=False)
    assert told.startswith(
        "forecasting 3 motions of 40 s on the nominal rig and 4 drawn: about 150 s"
    )
    searched = describe_work(1, 10.0, RigChoice(on="tube", rigs=0), optimise=True)
    assert "a motion of 10 s on the nominal rig, and a search" in searched
    # 2 forecasts, 12 motions on 3 rigs, 40 simulations: 38 * 2.5 s + 40 * 0.1 s
    assert "about 99 s" in searched


@pytest.mark.parametrize("rig", ["", "hobby", "tube"])
def test_a_rig_is_planned_for_with_one_axis(rig):
    choice = RigChoice(on=rig, settings=axes_settings(1, rig))
    assert EXCITATIONS[choice.axes][0] == "line"
    assert axes_settings(None, rig) == ()


def planned(line, capsys):
    """What ``identify --plan`` prints as JSON with some options."""
    with pytest.raises(SystemExit) as ended:
        main(["identify", "--plan", *line.split(), "--json"])
    assert ended.value.code == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.long
def test_a_plan_of_one_axis_has_no_second(capsys):
    found = planned("--axes 1 --seconds 15 --rigs 1 --scenario line", capsys)
    for rig in found["motions"][0]["rigs"]:
        names = [each["name"] for each in rig["verdicts"]]
        assert names == ["rolling", "breakaway", "delay", "servo", "level_phi"]


@pytest.mark.long
def test_the_motion_that_tells_most_comes_first(capsys):
    line = "--on hobby --seconds 10 --rigs 0 --scenario hold --scenario sine"
    found = planned(line, capsys)
    assert found["best"] == "sine"
    assert [each["scenario"] for each in found["motions"]] == ["sine", "hold"]
    assert found["motions"][0]["score"] < found["motions"][1]["score"]
