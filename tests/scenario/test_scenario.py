"""Tests of `twin.scenario.load`."""

from __future__ import annotations

import pickle
import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.base.errors import ScenarioError
from twin.scenario import load
from twin.scenario.load import check, read
from twin.scenario.merging import put, setting
from twin.scenario.schema import choices
from twin.scenario.variations import comparison, parse_variations, variants


def override(tables, overrides):
    """The tables with each ``key=value`` put in."""
    return put(tables, map(setting, overrides))


ROUND = (
    *("plant.kind=lagrange", "plant.shape=round", "plant.size=[0.3,0.3]"),
    "rig.limits.area=[0.1,0.1]",
)


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["durration=3"], ["durration", "unknown", "'duration'"]),
        (["sensors.touch.dead_tme=1"], ["sensors.touch.dead_tme", "'dead_time'"]),
        (["predictor.dely=0.04"], ["predictor.dely", "did you mean 'delay'"]),
        (["controller.rhoo=1"], ["controller.rhoo", "'rho'", "kappa"]),
        (["controller.kind=lqrr"], ["controller.kind", "'lqrr'", "'lqr'"]),
        (["reference.kind=spiral"], ["reference.kind", "'spiral'", "circle"]),
        (["duration=long"], ["duration", "number", "long"]),
        (["duration=true"], ["duration", "number"]),
        (["seed=1.5"], ["seed", "integer"]),
        (["duration=inf"], ["duration", "finite"]),
        (["plant.ball.mass=-0.1"], ["plant.ball.mass", "greater than 0", "-0.1"]),
        (["plant.kind=real"], ["plant.kind", "mujoco", "lagrange"]),
        (["plant.start.x=0.4"], ["plant.start.x", "0.35"]),
        (["rig.limits.area=[0.25,0.2]"], ["rig.limits.area", "the plate's half is 0.35, 0.1975 m"]),
        (["plant.shape=round"], ["plant.size: of a round plate its diameter twice, got 0.7"]),
        ([*ROUND, "plant.size=[0.3,0.2]"], ["plant.size", "its diameter twice, got 0.3 and 0.2"]),
        ([*ROUND, "plant.start.x=0.11", "plant.start.y=-0.11"], ["plant.start", "radius is 0.15"]),
        (
            [*ROUND, "rig.limits.area=[0.14,0.07]"],
            ["corners must lie on the round plate of radius 0.15 m", "[0.134, 0.0671]"],
        ),
        (["metrics.start=2"], ["metrics.start", "duration"]),
        (["rig.period=0.0015"], ["rig.period", "0.001", "multiple"]),
        (["controller.period=0.003"], ["controller.period", "0.003", "multiple of rig.period"]),
        (["controller.period=0.001"], ["controller.period", "0.001", "multiple of rig.period"]),
        (["controller.period=0"], ["controller.period", "greater than 0"]),
        (["duration=1e9"], ["duration", "0.002 to 20000 s", "rig.period"]),
        (["duration=0.0001"], ["duration", "0.002 to 20000 s", "rig.period"]),
        (["plant.step=1e-9"], ["plant.step", "0.00001"]),
        (["predictor.delay=1e9"], ["predictor.delay", "less than or equal to 1"]),
        (["sensors.touch.frame_rate=0.5"], ["frame_rate: must be 0 or 1 to 10000, got 0.5"]),
        (["sensors.touch.frame_rate=1e9"], ["frame_rate", "less than or equal to 10000"]),
        (["duration"], ["duration", "key=value"]),
        (["duration.x=1"], ["duration", "not a table"]),
        (["rig.limits.area=[0.2]"], ["rig.limits.area"]),
    ],
)
def test_a_wrong_override_is_refused_in_one_line_that_names_key_and_remedy(
    scenario, overrides, words
):
    with pytest.raises(ScenarioError) as caught:
        scenario(*overrides)
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message


def test_a_missing_table_is_named(tables):
    without = {key: value for key, value in tables.items() if key != "controller"}
    with pytest.raises(ScenarioError, match="controller: missing"):
        check(without, "file.toml")


@pytest.mark.parametrize("table", ["controller", "reference"])
def test_a_missing_kind_is_reported_with_those_there_are(tables, table):
    with pytest.raises(ScenarioError) as caught:
        check({**tables, table: {}}, "file.toml")
    listed = str(caught.value).removeprefix(f"file.toml: {table}.kind: missing; give ")
    kinds = [each.strip("'") for each in listed.replace(" or ", ", ").split(", ")]
    assert kinds == list(choices(table))


def test_naming_another_controller_drops_the_settings_of_the_old(tables):
    poles = ["controller.poles=[-1,-2,-3,-4]", "controller.kind=pole_placement"]
    changed = override(tables, poles)
    assert changed["controller"] == {"kind": "pole_placement", "poles": [-1, -2, -3, -4]}
    check(changed, "file.toml")


@given(
    st.one_of(
        st.floats(allow_nan=False, allow_infinity=False),
        st.integers(-(2**63), 2**63 - 1),
        st.booleans(),
    )
)
def test_any_toml_value_survives_an_override(value):
    text = str(value).lower() if isinstance(value, bool) else repr(value)
    assert override({}, [f"a.b={text}"]) == {"a": {"b": tomllib.loads(f"v={text}")["v"]}}


@pytest.mark.parametrize("name", ["circle", "sine"])
def test_a_shorter_run_is_judged_from_the_same_share_of_it_on(name):
    whole = load(name)
    short = load(name, ["duration=5"])
    share = whole.metrics.start / whole.duration
    assert share > 0
    assert short.metrics.start == pytest.approx(5 * share)
    assert load(name, [f"duration={whole.duration - 1}"]).metrics.start == whole.metrics.start


def test_a_start_that_is_given_is_kept_or_refused():
    assert load("circle", ["duration=5", "metrics.start=4.5"]).metrics.start == 4.5
    with pytest.raises(ScenarioError, match=r"metrics.start: 5 s is not before the end"):
        load("circle", ["duration=5", "metrics.start=5"])


def test_a_scenario_can_be_sent_to_another_process():
    chosen = load("circle", ["plant.friction.rolling_mm=0.1", "sensors.touch.grid=64"])
    assert pickle.loads(pickle.dumps(chosen)) == chosen


@pytest.mark.parametrize(("kind", "other"), [("hollow", "steel"), ("steel", "hollow")])
def test_another_kind_of_ball_over_a_recorded_scenario_is_that_ball(kind, other):
    tables, source = read("circle")
    recorded = check(override(tables, [f"plant.ball.kind={kind}"]), source).model_dump(mode="json")
    changed = check(override(recorded, [f"plant.ball.kind={other}"]), source)
    assert changed.plant == check(override(tables, [f"plant.ball.kind={other}"]), source).plant
    own = override(recorded, ["plant.ball.mass=0.2"])
    assert check(override(own, [f"plant.ball.kind={other}"]), source).plant.ball.mass == 0.2


def test_a_date_is_no_text():
    with pytest.raises(ScenarioError, match="2026-01-01 is a date or a time") as told:
        override(read("circle")[0], ["title=2026-01-01"])
    assert "\n" not in str(told.value)


def names(*vary):
    return [variant.name for variant in variants(parse_variations(vary))]


def test_tables_are_values_with_the_shortest_name_that_tells_them_apart():
    two = variants(parse_variations(['controller=[{kind="afl"}, {kind="lqr", rho=100}]']))
    assert [variant.name for variant in two] == ["afl", "lqr"]
    assert two[1].settings == (("controller", {"kind": "lqr", "rho": 100}),)
    alike = 'controller=[{kind="lqr", rho=100}, {kind="lqr", rho=300}, {kind="afl"}]'
    assert names(alike) == ["lqr rho=100", "lqr rho=300", "afl"]


def test_values_may_be_written_without_brackets_and_combine():
    assert names("controller.kind=afl,lqr", "duration=[5, 10.0]") == [
        "afl duration=5",
        "afl duration=10.0",
        "lqr duration=5",
        "lqr duration=10.0",
    ]
    labels = [variant.label for variant in variants(parse_variations(["seed=[1,2]"]))]
    assert labels == ["seed=1", "seed=2"]
    assert variants({})[0].settings == ()


def test_a_comparison_is_titled_by_what_ran():
    assert comparison("Circle", ["controller.kind"], ["duration=5"]) == (
        "Circle over controller.kind (duration=5)"
    )
    assert comparison("Mine", [], ["title=Mine"]) == "Mine"


@pytest.mark.parametrize(
    "text", ["duration", "=5", "duration=", "a..b=[1]", "seed=[1, 2", "seed=1]"]
)
def test_what_is_no_variation_is_one_line(text):
    with pytest.raises(ScenarioError, match=r"\A.*\Z"):
        parse_variations([text])


# Parameter files, as identification writes them and scenarios name them


def test_a_parameter_file_may_stand_in_the_scenario_file(tmp_path):
    (tmp_path / "rig.toml").write_text("[plant.friction]\nrolling_mm = 0.3\n", encoding="utf-8")
    scenario = tmp_path / "mine.toml"
    scenario.write_text(
        f'title = "mine"\nduration = 1.0\nparameters = "{tmp_path / "rig.toml"}"\n'
        '[controller]\nkind = "afl"\n[reference]\nkind = "hold"\n'
        "[plant.friction]\nrolling_mm = 0.1\nbreakaway_ratio = 1.5\n",
        encoding="utf-8",
    )
    friction = load(str(scenario)).plant.friction
    assert (friction.rolling_mm, friction.breakaway_ratio) == (0.3, 1.5)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (None, "cannot be read: No such file"),
        ("[plant", "not a TOML file"),
        ("[plant.friction]\nrollling_mm = 1\n", "did you mean 'rolling_mm'"),
    ],
)
def test_a_parameter_file_that_is_wrong_is_named_in_one_line(tmp_path, text, says):
    file = tmp_path / "rig.toml"
    if text is not None:
        file.write_text(text, encoding="utf-8")
    with pytest.raises(ScenarioError, match=says) as caught:
        load("circle", (f"parameters={file}",))
    assert "rig.toml" in str(caught.value)
    assert "\n" not in str(caught.value)
