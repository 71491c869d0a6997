"""`twin.base.followers`: who is stated to follow a setting does, to the bit; nobody else does."""

import os
import re
import subprocess
import sys
from functools import cache
from itertools import product
from pathlib import Path

import every_setting
import numpy as np
import pytest
from every_setting import OTHER

import ballplate as bp
from twin.base.errors import ModelError, ScenarioError
from twin.base.followers import DEFAULT, FOLLOWER_LABELS, FREE, GIVEN, SHAPE, Effect, Followers
from twin.base.settings import setting
from twin.fmu.export import frame_phase, sources, variables
from twin.identify.logs import of_columns
from twin.identify.parameters import (
    BALL_PARAMETERS,
    HIDDEN_PARAMETERS,
    PARAMETER_CHOICES,
    SERVO_PARAMETER,
)
from twin.run.assemble import assemble
from twin.run.loop import drive
from twin.run.record import Recorder
from twin.scenario import load
from twin.scenario.rig_tables import ENGINES, REGISTER, Section, register
from twin.whatif.attribution import EFFECTS, effects_of, without

SHORT = ("duration=0.1", "metrics.start=0", "plant.start.x_rate=0.1")
CRANKS = {
    "plant.linkage.crank_mm": "[40.0, 28.0]",
    "plant.linkage.rod_mm": "[90.0, 95.0]",
    "plant.linkage.arm_mm": "[100.0, 70.0]",
    "plant.linkage.distance_mm": "[50.0, 42.0]",
}
ROWS = {f"plant.linkage.{axis}_deg": "[[-40, -15], [40, 15]]" for axis in ("phi", "theta")}
VALUES = OTHER | {
    "plant.shape": "round",
    "plant.ball_spin": "thesis",
    "plant.surface.patch_mm": "80.0",
    "plant.servo.torque_limit": "0.01",
    "plant.linkage.crank_mm": "[41.0, 28.0]",
    "plant.linkage.rod_mm": "[91.0, 95.0]",
    "plant.linkage.arm_mm": "[101.0, 70.0]",
    "plant.linkage.distance_mm": "[51.0, 42.0]",
    "plant.linkage.phi_deg": "[[-40, -16], [40, 15]]",
    "plant.linkage.theta_deg": "[[-40, -16], [40, 15]]",
    "rig.limits.angle_deg": "0.2",
}
"""A value of each setting that differs from the default, or from that in ``BESIDE``."""
EDGE = {"plant.start.x": "0.24", "plant.start.x_rate": "0.4"}
"""A ball that leaves the operating area at once."""
LATER = {"duration": "0.3"}
"""A duration after which it acts, s."""
BREAKS = {"plant.friction.breakaway_ratio": "2.0"}
SHAKES = {"plant.servo.vibration": "0.5"}
UNEVEN = {"plant.surface.spread_percent": "20.0"}
FRAMES = {"sensors.touch.frame_rate": "100.0"}
BESIDE = {
    **dict.fromkeys(CRANKS, CRANKS),
    **dict.fromkeys(ROWS, ROWS),
    "plant.axes": {"reference.kind": "sine", "reference.amplitude": "[0.1, 0.0]"},
    "plant.shape": {
        "plant.size": "[0.5, 0.5]",
        "rig.limits.area": "[0.15, 0.15]",
        "rig.limits.margin": "0.3",
        **{f"plant.start.{axis}": "0.17" for axis in "xy"},
        **{f"plant.start.{axis}_rate": "0.4" for axis in "xy"},
    },
    "plant.friction.stribeck_speed": BREAKS,
    "plant.friction.dwell_time": BREAKS,
    "plant.friction.spinning_mm": {"plant.start.spin": "20.0"},
    **dict.fromkeys(("plant.rim.size", "plant.servo.speed_limit"), LATER),
    **dict.fromkeys(("rig.limits.angle_deg", "rig.limits.rate_deg"), LATER),
    "plant.rim.restitution": {"plant.rim.size": "[0.06, 0.06]", **LATER},
    "plant.servo.vibration_hz": SHAKES,
    "plant.servo.vibration_wander": SHAKES,
    "plant.servo.resonance_damping": {"plant.servo.resonance_hz": "15.0"},
    "plant.surface.patch_mm": UNEVEN,
    "plant.surface.seed": UNEVEN,
    "sensors.touch.jitter": FRAMES,
    "sensors.touch.lost": FRAMES,
    "rig.limits.area": EDGE,
    "rig.limits.margin": EDGE,
    "rig.cams": CRANKS,
}
"""What a setting needs to act at all."""


def settings(kind, key, *more):
    """A rig on a plant in which a setting can act, without that setting."""
    beside = BESIDE.get(key, {}).items()
    return (*SHORT, f"plant.kind={kind}", *(f"{name}={each}" for name, each in beside), *more)


@cache
def bits(name, told):
    """All that a run's record holds of its rig, as bytes."""
    scenario = load(name, list(told))
    return bits_of(scenario)


def bits_of(scenario):
    """The bytes of a scenario's record."""
    rig, controller = assemble([scenario], threads=1, unseen=True)
    record = Recorder(round(scenario.duration / scenario.rig.period), 1, scenario.rig.period)
    drive(rig, controller, scenario.duration, record)
    return b"".join(record[each].tobytes() for each in ("state", "measured", "applied"))


def test_every_setting_of_a_rig_is_tried():
    assert REGISTER.keys() <= VALUES.keys()


FOLLOWED = [
    (kind, key)
    for kind, key in product(ENGINES, REGISTER)
    if not REGISTER[key].followed_by.lacking(ENGINES[kind])
]
QUICK = {("mujoco", f"plant.{key}") for key in ("friction.sliding", "servo.resonance_hz")}
REFUSED = [each for each in product(ENGINES, REGISTER) if each not in FOLLOWED]


@pytest.mark.parametrize(
    ("kind", "key"),
    [
        pytest.param(
            *each, marks=() if each in QUICK or each[0] == "lagrange" else pytest.mark.long
        )
        for each in FOLLOWED
    ],
)
def test_a_setting_that_a_plant_follows_changes_a_run(kind, key):
    told = settings(kind, key)
    assert bits("circle", (*told, f"{key}={VALUES[key]}")) != bits("circle", told)


@pytest.mark.parametrize(("kind", "key"), REFUSED)
def test_a_setting_that_a_plant_leaves_out_is_refused_in_a_line_that_says_why(kind, key):
    why = REGISTER[key].followed_by.lacking(ENGINES[kind])
    with pytest.raises(ScenarioError) as refused:
        load("circle", [f"plant.kind={kind}", f"{key}={VALUES[key]}"])
    assert f"{key}: {FOLLOWER_LABELS[ENGINES[kind]]} {why}; set plant.kind=" in str(refused.value)


def source_of(told):
    """The C source of a scenario's FMU."""
    scenario = load("circle", list(told))
    held = variables(scenario, frame_phase(scenario))
    return "".join(sources(scenario, held, 3)[0].values())


IN_SOURCE = [key for key, about in REGISTER.items() if about.followed_by.source is GIVEN]
OPEN_IN_SOURCE = {key for key, about in REGISTER.items() if about.followed_by.source is FREE}


@pytest.mark.parametrize("key", IN_SOURCE)
def test_what_an_fmu_has_for_good_stands_in_its_source(key):
    told = settings("lagrange", key)
    assert source_of((*told, f"{key}={VALUES[key]}")) != source_of(told)


def test_what_an_fmu_leaves_open_and_nothing_else_is_a_parameter_of_it():
    scenario = load("circle", ["plant.kind=lagrange"])
    found = variables(scenario, frame_phase(scenario))
    names = {each.name.partition("[")[0] for each in found if each.causality == "parameter"}
    own = {"noise", "seed", "rig.knows_linkage", "sensors.touch.frame_phase"}
    suffixes = ("_mm", "_um", "_deg", "_percent")
    stated = {key.removesuffix(next(filter(key.endswith, suffixes), "")) for key in OPEN_IN_SOURCE}
    assert names - own == stated


def test_what_the_source_alone_leaves_out_is_refused_at_the_export(monkeypatch, tmp_path):
    key = "plant.servo.backlash_deg"
    lacking = {key: "has drives without play"}
    monkeypatch.setattr("twin.fmu.export.left_out", lambda part: lacking)
    with pytest.raises(ScenarioError) as refused:
        bp.fmu("circle", tmp_path / "rig.fmu", {key: 0.1})
    assert str(refused.value) == f"{key}: the C source of an FMU has drives without play"
    assert not list(tmp_path.iterdir())


def identified(told):
    """What identify knows of a run besides its columns."""
    columns = ("time", "measured_x", "measured_y", "measured_phi", "measured_theta")
    scenario = load("circle", list(told)).model_dump(mode="json")
    log = of_columns(dict.fromkeys(columns, np.arange(3.0)), {"scenario": scenario}, "log")
    return log.model, log.own_lag, log.grips


@pytest.mark.parametrize("key", REGISTER)
def test_identify_takes_from_a_run_what_is_stated_and_nothing_else(key):
    kind = "mujoco" if REGISTER[key].followed_by.lacking("equations") else "lagrange"
    told = settings(kind, key)
    known = identified((*told, f"{key}={VALUES[key]}")) != identified(told)
    assert known == (REGISTER[key].followed_by.identify is GIVEN)


def test_identify_fits_what_is_stated_and_nothing_else():
    fitted = {about.key for name, about in BALL_PARAMETERS.items() if name in PARAMETER_CHOICES}
    fitted |= {BALL_PARAMETERS["level_phi"].key, SERVO_PARAMETER.key}
    stated = {key for key, about in REGISTER.items() if about.followed_by.identify is FREE}
    assert stated == fitted
    assert not stated & {about.key for about in HIDDEN_PARAMETERS.values()}


@cache
def symbols(told):
    """The equations as symbols at one state, with their bounds: numbers, and the names of p."""
    model = bp.symbolic("hold", list(told))
    x = 0.1 * np.arange(1, 9) / 8
    rate = np.array(model.f(x, [0.3, -0.2], model.nominal)).ravel()
    return (*rate, *np.ravel([*model.bounds.values()]), model.dead_time), model


@pytest.mark.parametrize("key", REGISTER)
def test_the_symbols_follow_what_is_stated_and_nothing_else(key):
    pytest.importorskip("casadi")
    how = REGISTER[key].followed_by.symbols
    kind = "mujoco" if REGISTER[key].followed_by.lacking("equations") else "lagrange"
    told = settings(kind, key)
    (now, model), (then, _) = symbols((*told, f"{key}={VALUES[key]}")), symbols(told)
    assert (now != then) == (how in {FREE, GIVEN})
    bare = key.removesuffix("_mm").removesuffix("_deg")
    assert any(name.partition("[")[0] == bare for name in model.names["p"]) == (how is FREE)


SHAPES = [
    (key, about.followed_by.explain)
    for key, about in REGISTER.items()
    if isinstance(about.followed_by.explain, Effect) and about.followed_by.explain.off is SHAPE
]


@pytest.mark.parametrize(("key", "effect"), SHAPES)
def test_what_shapes_an_effect_does_nothing_where_the_effect_is_off(key, effect):
    (chosen,) = (each for each in EFFECTS if each.name == effect.name)
    told = settings("lagrange", key)
    with_it, base = load("circle", [*told, f"{key}={VALUES[key]}"]), load("circle", list(told))
    assert bits_of(without(with_it, [chosen])) == bits_of(without(base, [chosen]))


def test_every_effect_has_a_setting_and_every_setting_of_an_effect_is_switched_by_it():
    for key, about in REGISTER.items():
        effect = about.followed_by.explain
        if isinstance(effect, Effect) and effect.off is not SHAPE:
            (chosen,) = (each for each in EFFECTS if each.name == effect.name)
            assert chosen.off[key] == (about.default if effect.off is DEFAULT else effect.off)


ALL = Followers(mechanism=GIVEN, equations=GIVEN, source=FREE, identify=FREE, symbols=FREE)


def test_a_setting_of_which_not_all_is_stated_is_refused_by_its_key():
    with pytest.raises(ModelError, match=r"^plant\.lugre: followed_by must state .* lacks explain"):
        setting("plant.lugre", 0.0, followed_by=ALL)
    with pytest.raises(TypeError, match="followed_by"):
        setting("plant.lugre", 0.0)


def test_a_tables_key_of_which_nothing_is_stated_is_refused_by_its_name():
    class Own(Section):
        lugre: float = 0.0

    with pytest.raises(ModelError, match=r"^plant\.lugre: nothing states who follows it"):
        register(bases={"plant": Own})


def test_an_effect_that_explain_does_not_know_is_refused_by_its_key():
    about = setting("plant.lugre", 0.0, followed_by=ALL.by("lugre")).metadata["setting"]
    with pytest.raises(ModelError, match=r"^plant\.lugre: no effect 'lugre' in"):
        effects_of({"plant.lugre": about}, {})
    told = {"lugre": {"label": "bristles"}}
    assert effects_of({"plant.lugre": about}, told)[0].off == {"plant.lugre": 0.0}
    with pytest.raises(ModelError, match="none: no setting"):
        effects_of({"plant.lugre": about}, told | {"none": {"label": "nothing"}})


TRIAL = """
import json, sys
from dataclasses import dataclass
from twin.base.errors import TwinError
from twin.base.followers import FREE, GIVEN, Followers
from twin.base.settings import ramp
from twin.sim import drives

@dataclass(frozen=True, kw_only=True)
class WithBristles(drives.DriveModel):
    lugre: float = ramp("plant.servo.lugre_stiffness", 0.0, ge=0, {stated})

drives.DriveModel = WithBristles

import ballplate as bp
from twin.scenario import load
told = [{on!r}, "plant.servo.lugre_stiffness=3.0", "duration=0.1", "metrics.start=0"]
try:
    {attempt}
except (TwinError, TypeError) as error:
    print(type(error).__name__, error)
"""
"""An effect as somebody may add it: a field of the drives, and no code at all."""
NONE = dict.fromkeys(("mechanism", "equations", "source", "identify", "symbols", "explain"))
OUT = ", ".join(f"{part}='has none'" for part in NONE)
HALF = OUT.replace("equations='has none'", "equations=GIVEN")
IN = "mechanism=GIVEN, equations=GIVEN, source=FREE, identify=FREE, symbols=FREE"
RUN = "bp.run('circle', told, baseline=False)"
EXPORT = "bp.fmu('circle', 'rig.fmu', told)"
READ = "import c_source; print(c_source.unread(load('circle', told)))"
MECHANISM, EQUATIONS = "plant.kind=mujoco", "plant.kind=lagrange"
KEY = "plant.servo.lugre_stiffness"


@pytest.mark.parametrize(
    ("stated", "effect", "on", "attempt", "line"),
    [
        (None, "", MECHANISM, RUN, "TypeError: .*'followed_by'"),
        (IN, "", MECHANISM, RUN, f".*ModelError: {KEY}: .* lacks explain"),
        (OUT, "", MECHANISM, RUN, f".*{KEY}: the mechanism has none$"),
        pytest.param(
            *(OUT, "", EQUATIONS, RUN, f".*{KEY}: the exact equations has none$"),
            marks=pytest.mark.long,
        ),
        pytest.param(
            *(OUT, "", EQUATIONS, EXPORT, f".*{KEY}: the exact equations has none$"),
            marks=pytest.mark.long,
        ),
        (HALF, "", EQUATIONS, EXPORT, f"ScenarioError {KEY}: the C source of an FMU has none"),
        (IN, "lugre", MECHANISM, "import twin.whatif.attribution", f"ModelError {KEY}: no effect"),
        (IN, "backlash", EQUATIONS, "bp.symbolic('circle', told)", f"ModelError {KEY}: no equa"),
        (IN, "backlash", EQUATIONS, READ, "{'PLANT_SERVO_LUGRE_STIFFNESS'}"),
    ],
)
def test_an_effect_added_as_a_field_alone_is_never_ignored(
    tmp_path, stated, effect, on, attempt, line
):
    if "symbolic" in attempt:
        pytest.importorskip("casadi")
    entry = f"followed_by=Followers({stated})" if stated else ""
    entry += f".by({effect!r})" if effect else ""
    done = subprocess.run(
        [sys.executable, "-c", TRIAL.format(stated=entry, on=on, attempt=attempt)],
        cwd=tmp_path, capture_output=True, text=True, check=False,
        env=os.environ | {"PYTHONPATH": str(Path(every_setting.__file__).parent)},
    )  # fmt: skip
    assert re.match(line, (done.stdout + done.stderr).strip().splitlines()[-1])
