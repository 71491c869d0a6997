"""`twin.scenario`.

Every shipped scenario on every shipped rig, its reference as large as that rig has room for."""

import re
from functools import cache

import numpy as np
import pytest

from twin.base.errors import ScenarioError
from twin.base.shipped import shipped_in
from twin.run.assemble import assemble
from twin.run.controller_building import build_controller, build_reference
from twin.run.finished import run
from twin.scenario import shipped_scenarios
from twin.scenario.load import LAGGING, check, load, read, resolve
from twin.scenario.schema import choices

RIGS = sorted(shipped_in("rigs"))
as_shipped = cache(load)


def farthest(scenario):
    """Largest |x|, |y| of its reference over the run, m."""
    kind, settings = scenario.reference.kind, scenario.reference.settings
    reference = choices("reference")[kind](**settings)
    return np.abs(reference(np.linspace(0, scenario.duration, 5001))[0]).max(axis=0)


LENGTHS = r"\([\d.]+, [\d.]+\) m?m\b|[\d.]+ m?m\b"
"""What states a length, or one along each axis."""


def title_along_x(title, length, said):
    """A title that states lengths, with the real one along x in m in place of the two."""
    real = re.sub(LENGTHS, f"{1000 * length:g} mm", title)
    real = real.replace(" on both axes", "")
    return ", ".join([real, *(each for each in said if not each.startswith("lengths x"))])


@pytest.mark.long
@pytest.mark.parametrize("rig", RIGS)
@pytest.mark.parametrize("name", shipped_scenarios())
def test_a_scenario_on_a_rig_starts_with_a_reference_in_its_area(name, rig):
    made_for, now = as_shipped(name), load(name, [f"parameters={rig}"])
    axes = now.plant.axes
    share = min(np.divide(now.rig.limits.area, made_for.rig.limits.area)[:axes])
    assert share < 1
    assert farthest(now) == pytest.approx(share * farthest(made_for), rel=1e-9)
    assert (farthest(now)[:axes] <= np.array(now.rig.limits.area)[:axes] + 1e-9).all()
    assert (np.array(now.rig.limits.area) < np.array(now.plant.size) / 2)[:axes].all()
    held = not farthest(made_for).any()
    said = [] if held else [f"lengths x {share:.3g}"]
    late = now.controller.kind != made_for.controller.kind
    said = ["law for a plate that follows late"] * late + said
    said += ["along x"] if axes == 1 and farthest(made_for)[1] else []
    expected = ", ".join([made_for.title, *said])
    if axes == 1 and not held and re.search(LENGTHS, made_for.title):
        expected = title_along_x(made_for.title, share * farthest(made_for)[0], said)
    assert now.title == expected
    if "/" in name and (rig != "hobby" or name.endswith(("_075", "_100"))):
        return  # the same laws as those that start
    started, controller = assemble(now)
    with started:
        controller.start(started.read())
        started.start()
        assert np.isfinite(controller.command(started.read()).rate).all()


def test_the_title_of_a_rig_of_ones_own_does_not_hide_what_runs_on_it(tmp_path):
    rig = tmp_path / "mine.toml"
    rig.write_text('title = "bamboo"\n[rig.limits]\narea = [0.1, 0.1]\n', encoding="utf-8")
    now = load("circle", [f"parameters={rig}"])
    assert now.title == load("circle").title + ", lengths x 0.4"


def test_a_ball_told_without_its_inertia_is_refused_with_the_one_it_has_and_may_have():
    light = ["plant.ball.mass=0.0027", "plant.ball.radius=0.02"]
    with pytest.raises(ScenarioError, match=r"at most .* = 1.08e-06 kg m\^2, and is 6.4e-06; a"):
        load("circle", light)
    load("circle", [*light, f"plant.ball.inertia={2 / 3 * 1.08e-6}"])


def test_who_may_reach_less_far_on_a_rig_is_told_what_makes_the_reference_smaller():
    with pytest.raises(ScenarioError, match=r"allows 0.1, 0.1 m; a smaller rig \(--on\)"):
        build_reference(load("circle"), (0.1, 0.1))
    build_reference(load("circle", ["parameters=hobby"]), (0.1, 0.1))


@pytest.mark.parametrize("rig", RIGS)
def test_law_and_observer_are_told_of_a_rig_what_its_file_says_of_its_drives_and_frames(rig):
    now = load("cure", [f"parameters={rig}"])
    controller = build_controller(now)
    servo, touch = now.plant.servo, now.sensors.touch
    lag = 1 / (2 * np.pi * servo.bandwidth_hz)
    assert controller.law.model.lag == controller.observer.model.lag == pytest.approx(lag, rel=0.02)
    # it knows how old a frame is; the Smith predictor takes them for half a frame old
    assert controller.observer.delay == touch.dead_time
    smith = build_controller(load("circle", [f"parameters={rig}"])).observer
    assert smith.delay == pytest.approx(touch.dead_time + 0.5 / touch.frame_rate, abs=0.002)


@pytest.mark.long
@pytest.mark.parametrize("rig", [rig for rig in RIGS if rig not in {"tube", "beam", "cyberrunner"}])
def test_the_cure_keeps_the_ball_on_every_rig_and_must_be_told_a_lag_it_cannot_find(rig):
    on = [f"parameters={rig}", "baseline=false", "plant.step=0.002", "reference.omega=1.0"]
    settings = [*on, "duration=14.0", "metrics.start=7.7"]
    told, not_told = (run(load("cure", [*settings, *more])) for more in ((), ("rig.plate_lag=0",)))
    assert told.metrics["outcome"] == "finished"
    assert told.metrics["tracking_error_percent"] < 4.0
    error, worse = (run.metrics["tracking_error_percent"] for run in (told, not_told))
    least = 1.2 if rig == "hobby" else 1.5
    if told.scenario.rig.plate_lag > 0.05:
        assert not_told.metrics["outcome"] != "finished" or worse > least * error
    else:
        assert worse < 1.2 * error


@pytest.mark.long
def test_on_sloping_paper_the_cure_keeps_the_ball_and_most_of_its_error_is_the_slope():
    on = ["parameters=cyberrunner", "baseline=false", "plant.step=0.002", "reference.omega=1.0"]
    settings = [*on, "duration=14.0", "metrics.start=7.7"]
    even = ("plant.surface.slope_deg=0", "plant.surface.spread_percent=0")
    sloping, flat = (run(load("cure", [*settings, *more])) for more in ((), even))
    assert sloping.metrics["outcome"] == flat.metrics["outcome"] == "finished"
    errors = [each.metrics["tracking_error_percent"] for each in (sloping, flat)]
    assert errors[0] > 2 * errors[1]


@pytest.mark.parametrize("name", shipped_scenarios())
def test_on_the_rig_of_the_thesis_a_scenario_is_what_its_file_says(name):
    tables, source = read(name)
    assert tables["title"]
    own = {key: table for key, table in tables.items() if key != LAGGING}
    assert load(name) == check(own, source)
    assert load(name, ["rig.limits.area=[0.2,0.15]"]).reference == load(name).reference


HOBBY, WIDE, LARGER = "parameters=hobby", "plant.size=[0.7,0.5]", "rig.limits.area=[0.3,0.2]"


@pytest.mark.parametrize(
    ("name", "settings", "reference"),
    [
        ("circle", [HOBBY, "reference.amplitude=0.05"], {"amplitude": 0.05, "omega": 0.75}),
        ("circle", [HOBBY, "reference.omega=1"], {"amplitude": 0.06, "omega": 1}),
        ("circle", [HOBBY, WIDE, LARGER], {"amplitude": 0.15, "omega": 0.75}),
        ("circle", [HOBBY, "reference.kind=lissajous"], {"amplitude": [0.08, 0.048]}),
        (
            "hold",
            [HOBBY, "reference.kind=circle", "reference.omega=1"],
            {"amplitude": 0.06, "omega": 1},
        ),
        ("step", [HOBBY, "reference.x=0.01"], {"x": 0.01, "y": 0.06}),
        ("circle", [HOBBY, 'reference={kind="circle",amplitude=0.03}'], {"amplitude": 0.03}),
    ],
)
def test_what_is_set_stays_and_defaults_become_smaller(name, settings, reference):
    found = load(name, settings).reference.settings
    assert found == reference
    same = "0.4" not in load(name, settings).title
    own = ("amplitude", "reference.x", LARGER)  # a length that is set is stated as it is
    assert same == any(key in str(settings) for key in own)


def test_a_parameter_file_lies_over_the_rig_that_it_names(tmp_path):
    mine, found = tmp_path / "mine.toml", tmp_path / "found.toml"
    mine.write_text('parameters = "hobby"\nplant.friction.rolling_mm = 0.13\n')
    found.write_text(f'parameters = "{mine.as_posix()}"\nsensors.touch.dead_time = 0.02\n')
    hobby = load("circle", ["parameters=hobby"])
    chosen = load("circle", [f"parameters={found}", "plant.servo.backlash_deg=0"])
    own = ["plant.friction.rolling_mm=0.13", "sensors.touch.dead_time=0.02"]
    assert chosen == load("circle", ["parameters=hobby", *own, "plant.servo.backlash_deg=0"])
    assert chosen.title == hobby.title


@pytest.mark.parametrize("named", ["mine.toml", "other.toml", 3])
def test_a_parameter_file_that_leads_to_itself_is_refused_in_one_line(named, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = f"parameters = {named if named == 3 else repr(named)}\n"
    (tmp_path / "mine.toml").write_text(text)
    (tmp_path / "other.toml").write_text('parameters = "mine.toml"\n')
    with pytest.raises(ScenarioError, match="must name a different file, got") as caught:
        load("circle", ["parameters=mine.toml"])
    assert "\n" not in str(caught.value)


def test_times_of_goals_stay_and_a_start_becomes_smaller():
    tables, _ = read("hold")
    tables["plant"] = {"start": {"x": 0.1, "y_rate": 0.2}}
    goals = [[0.0, 0.1, 0.05], [2.0, -0.2, 0.0], [4.0, 0.0, 0.0]]
    tables["reference"] = {"kind": "setpoints", "points": goals}
    found = check(*resolve(tables, "t", [("parameters", "hobby")]))
    assert found.plant.start.x == pytest.approx(0.04)
    assert found.plant.start.y_rate == 0.2
    settings = found.reference.settings
    assert settings["points"] == [[0.0, 0.04, 0.02], [2.0, -0.08, 0.0], [4.0, 0.0, 0.0]]
