"""Tests of `twin.scenario.merging`: settings of a law that stand in place of others."""

from __future__ import annotations

import json

import pytest

from ballplate.changes import changes_of, warn_of_replaced
from twin.base.errors import ScenarioError
from twin.run.controller_building import build_law
from twin.scenario import load
from twin.scenario.load import check, describe_replaced
from twin.scenario.merging import merge_tables
from twin.scenario.schema import choices

POLES = [-5.0, -5.0, -5.0, -5.0]
GAINS = [180.0, 162.0, 66.0, 13.0]
REPLACED = [
    ("afl", {"gains": GAINS}, "poles", POLES),
    ("afl", {"poles": POLES}, "gains", GAINS),
    ("afl_integral", {"gains": [1.0, 5.0, 10.0, 10.0, 5.0]}, "poles", [-2.0] * 5),
    ("lqr", {"rho": 200.0, "kappa": 0.2}, "Q", [1.0] * 8),
    ("lqr", {"Q": [1.0] * 8}, "kappa", 0.2),
    ("feedforward", {"rho": 200.0}, "poles", [-3.0, -3.5, -4.0, -4.5]),
    ("feedforward", {"poles": [-3.0, -3.5, -4.0, -4.5]}, "rho", 200.0),
]
"""A law, what its scenario has, and a setting that replaces that."""


def write_scenario(file, controller):
    lines = [f"{key} = {json.dumps(value)}" for key, value in controller.items()]
    head = 'title = "mine"\nduration = 1.0\n[reference]\nkind = "hold"\n[controller]\n'
    file.write_text(head + "\n".join(lines), encoding="utf-8")
    return str(file)


@pytest.mark.parametrize(("kind", "own", "key", "value"), REPLACED)
def test_a_setting_replaces_those_it_stands_for(tmp_path, kind, own, key, value):
    table = {"kind": kind, **own}
    name = write_scenario(tmp_path / "mine.toml", table)
    given = [(f"controller.{key}", value)]
    done = load(name, [f"controller.{key}={value}"])
    assert done.controller.settings == {key: value}
    build_law(done)
    gone = " and ".join(f"controller.{each}" for each in own)
    assert describe_replaced(name, given) == f"controller.{key} replaces {gone} of mine.toml"
    over = merge_tables({"controller": table}, {"controller": {key: value}})
    assert over == {"controller": {"kind": kind, key: value}}


@pytest.mark.parametrize(("kind", "own", "key", "value"), REPLACED)
def test_both_given_together_are_refused(tables, kind, own, key, value):
    both = {**tables, "controller": {"kind": kind, **own, key: value}}
    with pytest.raises(ScenarioError, match=r"replaces? .*: give either"):
        build_law(check(both, "file.toml"))
    settings = [f"controller.{each}={given}" for each, given in (own | {key: value}).items()]
    with pytest.raises(ScenarioError, match=r"replaces? .*: give either"):
        build_law(load("circle", [f"controller.kind={kind}", *settings]))


def test_every_law_with_such_settings_is_tried():
    known = {kind for kind, law in choices("controller").items() if law.replaces}
    assert known == {kind for kind, *_ in REPLACED}


@pytest.mark.parametrize(
    "setting", ["controller.kind=lqr", "duration=2", f"controller.gains={GAINS}"]
)
def test_nothing_is_stated_where_nothing_is_replaced(setting, reported):
    warn_of_replaced(["circle"], changes_of([setting], {}), reported)
    assert not reported.lines


def test_the_scenarios_in_which_something_is_replaced_are_named(reported):
    changed = changes_of([f"controller.poles={POLES}"], {})
    warn_of_replaced(["circle", "hold", "sine"], changed, reported)
    assert reported.lines == [
        "controller.poles replaces controller.gains of circle.toml",
        "controller.poles replaces controller.gains of sine.toml",
    ]


@pytest.fixture
def reported():
    class Reported:
        def __init__(self):
            self.lines = []

        def warn(self, line):
            self.lines.append(line)

    return Reported()
