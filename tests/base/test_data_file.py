"""Tests of `twin.base.data_file`."""

import pytest
from at_once import is_at_once
from command_line import called
from hypothesis import given
from hypothesis import strategies as st

from twin.base.data_file import (
    INTEGER_RANGE,
    MAX_NESTING,
    DataError,
    parse_json,
    parse_toml,
    read_toml,
)

DEEP = "[" * 3000 + "]" * 3000
TABLES = "{a = " * 3000 + "1" + "}" * 3000
HUGE = "9" * 5000
LONG = ".".join(["a"] * 50_000)
LOG = "time,measured_x,measured_y,measured_phi,measured_theta"

BAD_TOML = {
    "lists": (f"title = {DEEP}", "nested deeper than 32 levels"),
    "tables": (f"title = {TABLES}", "nested deeper than 32 levels"),
    "steps": (
        f"[{'.'.join('a' * 20)}]\n{'.'.join('b' * 20)} = 1",
        "nested deeper than 32 levels",
    ),
    "digits": (f"duration = {HUGE}", "an integer beyond 64 bit"),
    "int65": (f"duration = {2**63}", "an integer beyond 64 bit"),
    "hexadecimal": (f"duration = 0x{'f' * 40_000}", "an integer beyond 64 bit"),
}
COMMANDS = {
    "scenario": ("run", "FILE"),
    "parameters": ("run", "circle", "--set", "parameters=FILE"),
    "rig": ("run", "circle", "--rig", "FILE"),
    "study": ("study", "FILE", "--plan"),
}


@pytest.fixture
def refused(capsys, tmp_path, monkeypatch):
    """Calls the command line; its one line of refusal, which comes as soon as any other."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        found = []
        assert is_at_once(
            lambda: found.append(called(capsys, *arguments)),
            lambda: called(capsys, "run", "circle", "--set", "seed=none"),
        )
        code, out, err = found[-1]
        assert (code, out) == (2, "")
        assert len(err.splitlines()) == 1
        assert len(err) < 1020
        return err

    return call


@pytest.mark.parametrize(
    ("command", "case"),
    [
        *(("scenario", case) for case in BAD_TOML),
        *((command, "lists") for command in COMMANDS if command != "scenario"),
    ],
)
def test_a_toml_file_beyond_a_limit_is_one_line_at_once(refused, tmp_path, command, case):
    text, expected = BAD_TOML[case]
    (tmp_path / "bad.toml").write_text(text)
    err = refused(*(part.replace("FILE", "bad.toml") for part in COMMANDS[command]))
    assert "bad.toml" in err
    assert expected in err


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("run", "circle", "--set", f"title={DEEP}"), "--set 'title': nested deeper"),
        (("run", "circle", "--set", f"seed={HUGE}"), "--set 'seed': an integer beyond 64 bit"),
        (("run", "circle", "--set", f"{LONG}=1"), "at most 32 parts"),
        (("run", "circle", "--set", LONG), "write key=value"),
        (
            ("run", "circle", "--set", 'parameters="\\u0000"'),
            "known: balancer, beam, course",
        ),
        (("run", "n" * 5000), "not found"),
        (("study", "n" * 5000), "not found"),
        (("run", "circle", "--set", f"duration={['a' * 100_000]}"), "duration: must be"),
        (("compare", "circle", "--vary", f"seed={DEEP}"), "--vary 'seed': nested deeper"),
        (("compare", "circle", "--vary", f"seed=[{HUGE}]"), "--vary 'seed': an integer beyond"),
        (("compare", "circle", "--vary", f"{LONG}=[1]"), "at most 32 parts"),
        (("compare", "circle", "--vary", LONG), "write KEY="),
    ],
)
def test_an_override_beyond_a_limit_is_one_line_at_once(refused, arguments, expected):
    assert expected in refused(*arguments)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a" * 100_000, "no column time"),
        (f"{LOG}\n0,{'b' * 100_000},0,0,0", "line 2: measured_x"),
        (f"{LOG}\n0,{HUGE * 40},0,0,0", "field larger than field limit"),
        (f"{LOG}\n0,\0,0,0,0", "is not a number"),
    ],
)
def test_a_damaged_csv_log_is_one_line_at_once(refused, tmp_path, text, expected):
    (tmp_path / "log.csv").write_text(text)
    assert expected in refused("identify", "log.csv")


def test_what_is_within_the_limits_is_read_as_it_stands(tmp_path):
    low, high = INTEGER_RANGE
    text = f"{'.'.join('a' * MAX_NESTING)} = {high}\n# {LONG[:63]}\nb = [{low}, 1.5, 'x.y']\n"
    (tmp_path / "good.toml").write_text(text)
    node = read_toml(tmp_path / "good.toml")
    assert node["b"] == [low, 1.5, "x.y"]
    for _ in range(MAX_NESTING - 1):
        node = node["a"]
    assert node["a"] == high


@given(st.text(alphabet="ab.\"'\\[]{}=#\n 1_-"))
def test_any_text_is_toml_or_is_refused(text):
    try:
        assert isinstance(parse_toml(text), dict)
    except ValueError as error:
        assert str(error)  # noqa: PT017  either is a right answer
    try:
        parse_json(text)
    except DataError as error:
        assert str(error)  # noqa: PT017
