"""`twin.cli.planning`: The options of `identify --plan`, and their mistakes in one line."""

import json

import pytest

from twin.cli import main

MISTAKES = {
    "identify": "LOG: give a log, or --plan",
    "identify --plan no.csv": "no.csv: --plan takes no LOG",
    "identify no.csv --seconds 30": "--seconds: needs --plan",
    "identify no.csv --scenario sine": "--scenario: needs --plan",
    "identify --plan --seconds 1": "seconds: must be 5 to 600, got 1",
    "identify --plan --rigs 1000": "rigs: must be 0 to 200, got 1000",
    "identify --plan --scenario cirle": "scenario 'cirle': not found",
    "identify --plan --on no": "rig 'no': not found",
    "identify --plan --parameters spring": "parameters: cannot be forecast: spring",
    "identify --plan --ball hollow": "--ball: not allowed with --plan",
    "identify --plan --hold-out log.csv": "--hold-out: with --plan give one share",
    "identify no.csv --optimise": "--optimise: needs --plan",
    "identify --plan --table motion.csv": "--table: needs --optimise",
    "identify --plan --optimise --table motion.txt": "--table motion.txt: must end in .toml or",
    "identify --plan --hold-out 0.9": "hold_out: must be 0 to 0.8, got 0.9",
}


@pytest.mark.parametrize("line", MISTAKES)
def test_a_mistake_is_one_line(line, capsys):
    with pytest.raises(SystemExit) as ended:
        main(line.split())
    assert ended.value.code == 2
    (told,) = (each for each in capsys.readouterr().err.splitlines() if each[:9] == "ballplate")
    assert told.removeprefix("ballplate: ").startswith(MISTAKES[line])


@pytest.mark.long
def test_the_motion_that_tells_most_comes_first(capsys):
    line = "identify --plan --on hobby --seconds 10 --rigs 0 --scenario hold --scenario sine --json"
    with pytest.raises(SystemExit) as ended:
        main(line.split())
    found = json.loads(capsys.readouterr().out)
    assert ended.value.code == 0
    assert found["best"] == "sine"
    assert [each["scenario"] for each in found["motions"]] == ["sine", "hold"]
    assert found["motions"][0]["score"] < found["motions"][1]["score"]
