"""`twin.whatif.attribution`.

What an effect costs: every switch works alone, and shares are what the error is made of."""

from __future__ import annotations

import json
import re
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from twin.base.data_file import read_toml
from twin.base.errors import TwinError
from twin.cli.understand import _effects
from twin.cli.understand import explain as command
from twin.run import picture
from twin.scenario import Scenario, load
from twin.scenario.derived import clean as cleaned
from twin.whatif import attribution
from twin.whatif.attribution import (
    ALL,
    EFFECTS,
    NONE,
    EffectCase,
    apply_overrides,
    attempt,
    attribute,
    describe_short_run,
    effects_present,
    explain,
    plan,
    summary,
    without,
)

CLEAN = (
    "duration=2",
    "metrics.start=0",
    "plant.friction.rolling_mm=0",
    "sensors.touch.dead_time=0",
    "sensors.touch.grid=0",
    "sensors.touch.variance=[0, 0]",
    "sensors.encoders.counts=0",
    "sensors.encoders.variance=[0, 0]",
    "disturbance.variance=[0, 0]",
    "rig.limits.rate_deg=3600",
    "rig.limits.acceleration=1e4",
)
SHORT = [{"duration": 1.5, "metrics.start": None, "baseline": None}]


@pytest.fixture
def clean():
    """A sine without a single effect, on the equations that its law is designed on."""
    scenario = load("sine", (*CLEAN, "plant.kind=lagrange", "plant.ball_spin=thesis"))
    return apply_overrides(scenario, [{"predictor": None}])


ON_THE_MECHANISM = tuple(effect for effect in EFFECTS if effect.name != "rolling")
"""Effects that the mechanism can be without; its ball rolls as a ball does."""
LIMITING = {"drive", "limits", "liftoff", "sliding"}
"""Effects that do nothing until a limit is reached."""
TYPICAL = {
    name: {key: None if value == "default" else value for key, value in about.items()}
    for name, about in read_toml(Path(__file__).with_name("typical.toml")).items()
}
"""Effect to settings of a size that a real rig may have."""


@pytest.fixture
def full():
    """The circle with every effect that it lacks at such a size."""
    circle = load("circle")
    has = {effect.name for effect in effects_present(circle)}
    return apply_overrides(circle, [each for name, each in TYPICAL.items() if name not in has])


@cache
def tried(scenario):
    """A run of a scenario given as JSON; many are compared with the one without effects."""
    (case,) = attempt([Scenario.model_validate_json(scenario)])
    return case


def test_a_scenario_with_every_effect_has_them_all(full):
    own = {effect.name for effect in ON_THE_MECHANISM}
    assert {effect.name for effect in effects_present(full)} == own


@pytest.mark.long
def test_how_the_ball_rolls_is_an_effect_of_the_exact_equations_alone(clean):
    spun = apply_overrides(clean, [{"plant.ball_spin": "free", "plant.start.spin": 5.0}])
    assert [effect.name for effect in effects_present(spun)] == ["rolling"]
    assert without(spun, effects_present(spun)) == clean
    one, other = (tried(each.model_dump_json()) for each in (spun, clean))
    assert 1e-9 < np.abs(one.error - other.error).max() < 1e-3


@pytest.mark.parametrize("effect", ON_THE_MECHANISM, ids=lambda effect: effect.name)
def test_switching_one_effect_off_takes_it_and_no_other_away(effect, full):
    gone = {e.name for e in ON_THE_MECHANISM} - {
        e.name for e in effects_present(without(full, [effect]))
    }
    # without dead time there is none that spreads
    implied = {"deadtime": {"spread"}}.get(effect.name, set())
    assert effect.name in gone
    assert gone <= {effect.name} | implied


@pytest.mark.long
@pytest.mark.parametrize(
    "effect",
    [each for each in ON_THE_MECHANISM if each.name not in LIMITING],
    ids=lambda effect: effect.name,
)
def test_every_effect_alone_changes_what_the_plant_or_the_sensors_do(effect, full):
    others = [other for other in ON_THE_MECHANISM if other is not effect]
    alone, none = without(full, others), without(full, ON_THE_MECHANISM)
    if effect.name in {"breakaway", "presliding"}:
        alone, none = (
            apply_overrides(s, [{"plant.friction.rolling_mm": 0.18}]) for s in (alone, none)
        )
    if effect.name == "spread":
        none = apply_overrides(none, [{"sensors.touch.dead_time": 0.042}])
        alone = apply_overrides(none, [TYPICAL[effect.name]])
    one, other = (tried(apply_overrides(s, SHORT).model_dump_json()) for s in (alone, none))
    assert np.abs(one.error - other.error).max() > 1e-9


@pytest.mark.long
@pytest.mark.parametrize(
    ("effect", "limit"),
    [
        ("drive", {"plant.servo.speed_limit": 0.05}),
        ("drive", {"plant.servo.torque_limit": 2.4}),
        ("limits", {"rig.limits.rate_deg": 0.3}),
        ("limits", {"rig.limits.acceleration": 0.1}),
        ("liftoff", {"plant.spring.preload": 2.0}),
        ("sliding", {"plant.friction.sliding": 0.001}),
    ],
)
def test_a_limit_acts_where_it_is_reached(effect, limit):
    free = apply_overrides(without(load("step"), ON_THE_MECHANISM), SHORT)
    limited = apply_overrides(free, [limit])
    assert [e.name for e in effects_present(limited)] == [effect]
    one, other = (tried(s.model_dump_json()) for s in (limited, free))
    assert np.abs(np.hypot(*one.error[-1]) - np.hypot(*other.error[-1])) > 1e-6


def test_a_plate_on_rods_has_no_effect_of_cams():
    course = load("circle", ["parameters=course", "plant.kind=mujoco"])
    found = {effect.name for effect in effects_present(course)}
    assert not found & {"vibration", "mass", "liftoff"}
    assert {"friction", "bandwidth"} <= found


@pytest.mark.parametrize("rig", ["hobby", "course", "three_legs", "balancer"])
def test_with_every_effect_off_a_controller_believes_what_it_does_on_the_clean_model(rig):
    none = plan(load("circle", [f"parameters={rig}"]))[NONE]
    assert none.designed_on == cleaned(none).designed_on
    assert none.predictor is None


def test_the_wait_for_a_frame_goes_with_the_frames_and_the_lag_with_the_servos():
    cases = plan(load("circle", ["parameters=three_legs"]))
    assert cases["-frames"].predictor.wait == 0
    assert cases["-frames"].predictor.delay == cases[ALL].predictor.delay
    assert cases["-bandwidth"].rig.plate_lag == 0
    assert cases["+bandwidth"].rig.plate_lag == cases[ALL].rig.plate_lag > 0


def test_a_scenario_without_a_predictor_is_given_none(clean):
    framed = apply_overrides(clean, [{"sensors.touch.frame_rate": 58.0}])
    assert plan(framed)["-frames"].predictor is None


def test_of_a_single_effect_alone_and_all_are_the_same_run(clean):
    scenario = apply_overrides(clean, [{"plant.friction.rolling_mm": 0.2}])
    cases = plan(scenario)
    assert cases["+friction"].model_dump() == cases[ALL].model_dump()
    assert cases["-friction"].model_dump() == cases[NONE].model_dump()


def test_of_a_single_effect_shares_add_up_to_the_whole(clean):
    found = explain(apply_overrides(clean, [{"plant.friction.rolling_mm": 0.2}]), processes=1)
    (part,) = found.contributions
    assert part.effect.name == "friction"
    assert part.share + found.base == pytest.approx(1.0)
    assert found.rest == pytest.approx(0.0, abs=1e-12)


def case(error, **changes):
    error = np.asarray(error, float)
    rms = float(np.sqrt((error**2).sum(axis=1).mean()))
    values = {"outcome": "finished", "percent": None, "rms": rms} | changes
    return EffectCase(error=error, **values)


@pytest.mark.parametrize(
    ("whole", "friction", "level", "shares"),
    [
        # what two effects add in different directions: 3 along x, 4 along y of a whole of length 5
        ([3.0, 4.0], [3.0, 0.0], [0.0, 4.0], {"friction": 9 / 25, "level": 16 / 25}),
        # last in, each brings all of it; first in, nothing: half and half, and none is left over
        ([1.0, 0.0], [0.0, 0.0], [0.0, 0.0], {"friction": 0.5, "level": 0.5}),
    ],
)
def test_errors_divide_by_their_squares_and_in_halves_where_effects_only_act_together(
    clean, whole, friction, level, shares
):
    scenario = apply_overrides(
        clean, [{"plant.friction.rolling_mm": 0.2, "plant.level_deg": (0.05, 0.0)}]
    )
    errors = {ALL: whole, NONE: [0.0, 0.0], "+friction": friction, "-level": friction}
    errors |= {"+level": level, "-friction": level}
    found = attribute(scenario, {name: case([error]) for name, error in errors.items()})
    assert {part.effect.name: part.share for part in found.contributions} == pytest.approx(shares)
    assert found.rest == pytest.approx(0.0)


@pytest.mark.parametrize(
    ("kind", "duration", "start", "words"),
    [
        ("circle", 3.0, 1.2, "1.8 s, from metrics.start = 1.2 s on; .* at least 6.28 s"),
        ("circle", 25.0, 10.0, ""),
        ("sine", 3.0, 1.0, "2 s, from metrics.start = 1 s on; .* at least 4 s"),
        ("sine", 5.0, 0.0, ""),
    ],
)
def test_shares_of_a_few_seconds_are_called_too_short(clean, kind, duration, start, words):
    """A circle at 1 rad/s goes once round in 6.28 s; along a line there is no round."""
    times = {"duration": duration, "metrics.start": start, "plant.friction.rolling_mm": 0.2}
    along = {"circle": 0.1, "sine": [0.1, 0.0]}[kind]
    reference = {"reference": {"kind": kind, "amplitude": along, "omega": 1.0}}
    scenario = apply_overrides(clean, [times, reference])
    one = case([[0.1, 0.0]])
    found = attribute(scenario, dict.fromkeys((ALL, NONE, "+friction", "-friction"), one))
    said = summary(found)["too_short"]
    assert bool(said) == bool(words)
    assert re.search(words, said)
    assert any("too short to evaluate" in str(line) for line in _effects(found)) == bool(words)


def test_a_run_that_is_too_short_is_warned_of_before_any_case_is_run(monkeypatch, tmp_path):
    def refuse(*_):
        raise TwinError("no run")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("twin.whatif.attribution.explain", refuse)
    done = CliRunner().invoke(command, ["hold", "--set", "duration=2", "--set", "metrics.start=0"])
    assert str(done.exception) == "no run"
    assert "too short to evaluate: 2 s" in " ".join(done.output.split())


@pytest.mark.parametrize(
    ("reference", "shown"),
    [
        ("{kind='circle'}", "at least 12.6 s"),  # once round at 0.5 rad/s, the default
        ("{kind='circle', omega=0.0}", ""),  # is refused where it is built
        ("{kind='hold'}", ""),
    ],
)
def test_a_circle_is_evaluated_once_round_if_it_goes_round(reference, shown):
    times = ("duration=10", "metrics.start=0")
    found = describe_short_run(load("circle", (*times, f"reference={reference}")))
    assert bool(found) == bool(shown)
    assert shown in found


def test_a_run_that_was_cut_short_has_no_share_and_says_why(clean):
    scenario = apply_overrides(clean, [{"plant.friction.rolling_mm": 0.2}])
    lost = case([[0.1, 0.0]], outcome="fell at 1.0 s", rms=None)
    good = case([[0.1, 0.0]])
    found = attribute(scenario, {ALL: good, NONE: good, "+friction": good, "-friction": lost})
    assert found.contributions[0].share is None
    assert found.rest is None
    assert summary(found)["effects"]["friction"]["without"]["outcome"] == "fell at 1.0 s"


@pytest.mark.long
def test_where_every_run_with_an_effect_fell_the_picture_says_so_below_a_whole_title(
    clean, tmp_path, monkeypatch
):
    drawn, seen = picture.styled_figure, []

    @contextmanager
    def kept(*size):
        with drawn(*size) as figure:
            seen.append(figure)
            yield figure

    monkeypatch.setattr(picture, "styled_figure", kept)
    scenario = apply_overrides(
        clean, [{"plant.friction.rolling_mm": 0.2, "title": "a long title " * 12}]
    )
    good, lost = case([[0.1, 0.0]]), case([[0.1, 0.0]], outcome="fell at 1.0 s", rms=None)
    found = attribute(scenario, {ALL: lost, NONE: good, "+friction": lost, "-friction": good})
    attribution.draw(tmp_path / "picture.png", found)
    (figure,) = seen
    (panel,) = figure.axes
    (said,) = panel.texts
    assert said.get_text() == " fell at 1.0 s"
    assert said.get_position()[0] == pytest.approx(100.0)
    title = figure.get_suptitle(), figure._suptitle.get_window_extent()
    assert title[0].startswith("a long title")
    assert 0 <= title[1].x0 < title[1].x1 <= figure.bbox.width


@pytest.mark.long
def test_the_command_writes_its_files_and_prints_one_json_object(tmp_path):
    exact = "plant.kind=lagrange", "plant.ball_spin=thesis"
    settings = (*CLEAN, *exact, "plant.friction.rolling_mm=0.2", "duration=1")
    last = {setting.partition("=")[0]: setting for setting in settings}
    arguments = [part for setting in last.values() for part in ("--set", setting)]
    out = tmp_path / "out"
    result = CliRunner().invoke(
        command, ["sine", *arguments, "--out", str(out), "--json"], standalone_mode=False
    )
    assert result.exception is None, result.exception
    told = json.loads(result.stdout)
    assert told == json.loads((out / "explain.json").read_text())
    assert "friction" in told["effects"]
    assert (out / "picture.png").stat().st_size > 10_000
