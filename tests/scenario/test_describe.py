"""Tests of `twin.scenario.describe`."""

import json
import re
from pathlib import Path

import pytest
from click.testing import CliRunner
from docstring_parser import parse_from_object

from docs import pages
from docs import settings as settings_page
from twin.base.errors import ScenarioError
from twin.base.settings import value_of
from twin.cli.runs import describe as command
from twin.run.tables import flat
from twin.scenario.describe import _docstring as docstring
from twin.scenario.describe import about, every_kind, find_keys
from twin.scenario.load import check
from twin.scenario.schema import CATALOG_TABLES, Scenario, choices

TABLES = {
    "title": "test",
    "duration": 1.0,
    "controller": {"kind": "lqr"},
    "reference": {"kind": "hold"},
}
EVERY = [*find_keys(), *(key for keys in every_kind().values() for key in keys)]
PROJECT = Path(__file__).parents[2]
SUFFIX = {"mm": "mm", "um": "um", "deg": "deg", "hz": "Hz", "percent": "%"}


def describe(*arguments):
    result = CliRunner().invoke(command, arguments, catch_exceptions=False)
    assert result.exit_code == 0
    return result.output


def test_every_key_says_what_it_means_and_in_which_unit():
    for key in EVERY:
        assert key.meaning.endswith("."), key
        if (suffix := key.key.rpartition("_")[2]) in SUFFIX and key.key.count("_"):
            assert key.unit.partition("/")[0].partition(" ")[0] == SUFFIX[suffix], key
        if " in m/s^2" in key.meaning:
            assert key.unit == "m/s^2", key


def test_every_key_that_a_scenario_has_is_described():
    ball = {"kind": "nominal", "mass": 0.1, "radius": 0.02, "inertia": 1e-5, "height": 0.1}
    tables = {
        **TABLES,
        "predictor": {},
        "board": {},
        "controller": {**TABLES["controller"], "model": ball},
    }
    whole = check(tables, "test").model_dump(mode="json")
    assert flat(whole).keys() == {key.key for key in find_keys()}


@pytest.mark.parametrize("table", CATALOG_TABLES)
def test_docstrings_read_from_a_whole_module_are_those_of_each_class(table):
    for cls in list(choices(table).values())[:2]:
        expected, found = parse_from_object(cls), docstring(cls)
        assert found.short_description == expected.short_description
        assert expected.params
        assert list(map(vars, found.params)) == list(map(vars, expected.params))


def test_the_described_defaults_are_those_of_a_scenario():
    scenario = check({**TABLES, "predictor": {}, "board": {}}, "test")
    for key in find_keys():
        if not key.required:
            value = value_of(scenario, key.key)
            value = list(value) if isinstance(value, tuple) else value
            assert value == key.default, key.key


def test_a_kind_shows_its_own_settings_and_sentence():
    assert [key.key for key in find_keys("lqr")] == [key.key for key in find_keys("controller.lqr")]
    assert {key.kind for key in find_keys("lqr")} == {"lqr"}
    assert about("lqr").startswith("State feedback that minimises")
    assert find_keys("ideal") == []


def test_the_last_part_of_a_key_finds_all_of_that_name():
    found = {(key.kind, key.key) for key in find_keys("amplitude")}
    assert {kind for kind, _ in found} == {"circle", "lissajous", "sine"}
    assert [key.key for key in find_keys("rolling_mm")] == ["plant.friction.rolling_mm"]
    assert [key.kind for key in find_keys("reference.path.points")] == ["path"]


def test_a_key_of_several_kinds_is_that_of_each():
    found = find_keys("reference.omega")
    assert {key.key for key in found} == {"reference.omega"}
    assert {"circle", "sine", "lissajous"} <= {key.kind for key in found}


def test_a_table_shows_its_keys_only():
    assert {key.key.rpartition(".")[0] for key in find_keys("plant.friction")} == {"plant.friction"}
    assert len(find_keys("plant")) > len(find_keys("plant.friction"))


def test_the_name_of_a_table_is_suggested_for_one_that_is_nearly_it():
    with pytest.raises(
        ScenarioError, match=r"nothing called 'friktion'; did you mean 'friction'\? "
    ):
        find_keys("friktion")


@pytest.mark.parametrize("wrong", ["roling_mm", "plant.fricton", "lqrr"])
def test_an_unknown_name_is_one_line_with_the_nearest(wrong):
    with pytest.raises(ScenarioError, match=r"nothing called .*; did you mean '") as caught:
        find_keys(wrong)
    assert len(str(caught.value)) < 200


def test_a_word_finds_a_table_within_another_or_what_keys_mean():
    assert {key.key.rpartition(".")[0] for key in find_keys("servo")} == {"plant.servo"}
    assert "plant.friction.rolling_mm" in {key.key for key in find_keys("arm")}
    assert all("corner" in key.meaning.lower() for key in find_keys("corner"))


@pytest.mark.parametrize("table", ["law", "observer", "reference"])
def test_all_of_a_kind_are_listed_with_a_sentence_each(table):
    lines = describe(f"{table}s").splitlines()
    assert len(lines) > 7
    assert all(re.fullmatch(r"\w+ +\S.+", line) for line in lines[:-1])
    if table == "law":
        assert re.match(r"afl +Approximate feedback linearization \(AFL\)", lines[0])


def test_the_command_prints_words_or_json():
    words = describe("plant.friction.rolling_mm")
    assert "plant.friction.rolling_mm = 0.18 mm" in words
    assert "[number, >= 0, <= 10]" in words
    (key,) = json.loads(describe("plant.friction.rolling_mm", "--json"))
    assert (key["unit"], key["default"], key["required"]) == ("mm", 0.18, False)
    assert "It has no settings." in describe("ideal")


def test_the_page_holds_every_key_and_kind_and_is_today_s():
    page = settings_page.page()
    made = pages.parts("settings.md", page)
    assert len(made) == 5
    for name, text in made.items():
        assert text == (PROJECT / "docs" / name).read_text(encoding="utf-8")
    for key in EVERY:
        assert f"| `{key.key}` |" in page
    for table in CATALOG_TABLES:
        for kind in choices(table):
            assert f"## {table}.{kind}\n" in page
    assert Scenario.__name__ not in page
