"""`twin.study.compiled`.

Runs in C against those in numpy: motions to rounding, indicators, endings, refusals."""

from __future__ import annotations

import itertools
import shutil

import numpy as np
import pytest

import ballplate as bp
from twin.base.errors import TwinError
from twin.base.shipped import shipped_in
from twin.fmu.export import first_values, surface_of, variables
from twin.run.assemble import assemble
from twin.run.loop import drive
from twin.run.metrics import Motion
from twin.run.record import Recorder
from twin.scenario import load
from twin.scenario.schema import Scenario, at_study_step
from twin.study import compiled
from twin.study.schema import draw_rigs, read_family
from twin.study.work import Builder, Row, ScenarioRuns, carry_out, controller_key

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler (cc)")

EXACT = ("plant.kind=lagrange", "baseline=false")
CAMERA = (
    "sensors.touch.frame_rate=47",
    "sensors.touch.jitter=0.008",
    "sensors.touch.lost=0.2",
    "sensors.touch.dead_time_spread=0.002",
)
RIGS = {
    "plain": (),
    "held": ("sensors.noise_hold=0.01", "disturbance.variance=[1e-4, 3e-5]"),
    "camera": CAMERA,
    "vibration": ("plant.servo.vibration=2", "plant.servo.vibration_wander=0.3"),
    "uneven": ("plant.surface.spread_percent=30", "plant.surface.seed=3"),
    "sloping": ("plant.surface.slope_deg=0.1", "plant.surface.seed=4", "plant.camber=[0.4, -0.3]"),
    "drives": ("plant.servo.bandwidth_hz=8", "plant.servo.backlash_deg=0.1"),
}
"""Settings of rigs with every stream of noise and with screens of their own."""
FALLING = ("plant.start.x=0.34", "plant.start.x_rate=0.5", "rig.limits.margin=0.2")
SURFACED = ("uneven", "sloping")
"""Rigs that need a library of their own."""


@pytest.fixture(autouse=True)
def quickly_compiled(request, monkeypatch):
    """To optimise is most of what compiling takes; long tests simulate for longer than that."""
    if request.node.get_closest_marker("long") is None:
        flags = ["-O0" if flag == "-O3" else flag for flag in compiled.LOOP_FLAGS]
        monkeypatch.setattr(compiled, "LOOP_FLAGS", flags)


def scenario(*settings: str, name: str = "circle", seconds: float = 1.0) -> Scenario:
    return at_study_step(load(name, [*EXACT, f"duration={seconds}", *settings]))


def motion(of: Scenario) -> tuple[np.ndarray, np.ndarray]:
    """True states and applied accelerations of a run in numpy."""
    rig, controller = assemble([of], threads=1, unseen=True, as_alone=False)
    ticks = round(of.duration / of.rig.period)
    record = Recorder(ticks, 1, of.rig.period, keep=("state", "applied"))
    drive(rig, controller, of.duration, record)
    return record["state"][:, 0], record["applied"][:, 0]


@pytest.mark.short("held", "camera")
@pytest.mark.parametrize(
    "rig",
    [pytest.param(each, marks=[pytest.mark.long] if each in SURFACED else []) for each in RIGS],
)
def test_a_motion_in_c_is_that_in_numpy(rig):
    of = scenario("seed=3", *RIGS[rig])
    state, applied = motion(of)
    (found,) = simulated(of)
    assert found is not None
    np.testing.assert_allclose(found.ball, state[:, 0::4], rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.plate, state[:, 2::4], rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.u, applied, rtol=0, atol=1e-10)


def test_the_values_of_a_rig_are_those_of_its_description():
    of = scenario("seed=3", *RIGS["drives"], *CAMERA, "plant.level_deg=[0.4, -0.3]")
    expected = [each.start or 0.0 for each in variables(of, 0.3)]
    np.testing.assert_array_equal(first_values(of, 0.3), expected)


def test_a_rig_of_one_axis_has_no_indicator_of_a_second():
    short = ("parameters=tube", "baseline=false", "metrics.start=0")
    tube = [load("line", [*short, f"duration={t}"]) for t in (0.5, 1.0)]
    assert_same(*rows_of([at_study_step(each) for each in tube]), rtol=1e-6)


def test_a_ball_that_falls_in_the_last_period_has_fallen():
    last = [scenario(*FALLING, seconds=0.002 * ticks) for ticks in range(2, 30)]
    runs = ScenarioRuns(last)
    jobs = runs.jobs(runs.tasks)
    expected = [row["outcome"] for row in carry_out(jobs)]
    fell = expected.index("fell")
    assert 1 < fell < len(jobs) - 2
    around = slice(fell - 2, fell + 2)
    found = compiled.carry_out_compiled(jobs[around])
    assert [row["outcome"] for row in found] == expected[around]


@pytest.mark.short("camera")
@pytest.mark.parametrize("rig", ["held", "camera", "vibration", "drives"])
def test_a_rig_has_the_same_bits_alone_and_next_to_others(rig):
    of, falls = scenario("seed=3", *RIGS[rig]), scenario(*RIGS[rig], *FALLING)
    near = [scenario(f"seed={n}", *RIGS[rig], "plant.friction.rolling_mm=0.4") for n in (4, 5)]
    (alone,) = [(m.ball.copy(), m.u.copy()) for m in simulated(of)]
    for beside in ([falls, of], [*near, of], [near[0], of, falls, near[1]]):
        found = simulated(*beside)[beside.index(of)]
        np.testing.assert_array_equal(found.ball, alone[0])
        np.testing.assert_array_equal(found.u, alone[1])


def test_what_one_rig_feels_changes_no_bit_of_another():
    felt = {
        "plain": (),
        "sticking": ("plant.friction.breakaway_ratio=1.5", "plant.friction.dwell_time=0.2"),
        "bending": ("plant.friction.presliding_um=200",),
        "walled": ("plant.rim.size=[0.28, 0.28]",),
    }
    moving = ("seed=3", "plant.start.x=0.1", "plant.start.x_rate=0.2")
    of = [scenario(*moving, *settings) for settings in felt.values()]
    library, rigs = library_of(of[0]), [rig_of(each) for each in of]
    assert {id(library_of(each)) for each in of} == {id(library)}
    alone = [(m.ball.copy(), m.u.copy()) for (m,) in (library.run([rig]) for rig in rigs)]
    for one, other in itertools.combinations(alone, 2):
        assert (one[0] != other[0]).any()
    for order in ((0, 1, 2, 3), (3, 2, 1, 0)):
        together = library.run([rigs[k] for k in order])
        for k, found in zip(order, together, strict=True):
            np.testing.assert_array_equal(found.ball, alone[k][0])
            np.testing.assert_array_equal(found.u, alone[k][1])


def test_another_seed_has_other_noise():
    first, second = simulated(scenario("seed=3"), scenario("seed=4"))
    assert np.abs(first.plate - second.plate).max() > 1e-6


def rows_of(scenarios: list[Scenario]) -> tuple[list[Row], list[Row]]:
    """Rows of runs in numpy and in C."""
    runs = ScenarioRuns(scenarios)
    jobs = runs.jobs(runs.tasks)
    return carry_out(jobs), compiled.carry_out_compiled(jobs)


def assert_same(numpy_rows: list[Row], c_rows: list[Row], rtol: float) -> None:
    """Outcomes and reasons are equal, indicators up to a relative difference."""
    assert len(numpy_rows) == len(c_rows)
    for expected, found in zip(numpy_rows, c_rows, strict=True):
        assert expected.keys() == found.keys()
        for name, value in expected.items():
            same = pytest.approx(value, rel=rtol, abs=1e-12) if isinstance(value, float) else value
            assert found[name] == same, name


@pytest.mark.long
def test_rows_are_those_of_numpy_however_a_run_ends():
    ends = {"aborted": ("plant.start.x=0.2", "plant.start.x_rate=0.3"), "finished": ()}
    odd = ("controller.gains=[-1.0, -1.0, -1.0, -1.0]",)
    expected, found = rows_of([scenario(*each) for each in (*ends.values(), odd)])
    assert [row["outcome"] for row in expected[:2]] == list(ends)
    assert_same(expected, found, 1e-6)


def library_of(of: Scenario) -> compiled.CompiledRuns:
    return compiled.compiled_runs(rig_of(of), controller_key(of))


def rig_of(of: Scenario) -> compiled.CompiledRig:
    return compiled.CompiledRig(of, surface_of(of))


def simulated(*of: Scenario) -> list[Motion | None]:
    """Motions of runs in C that go into one library."""
    return library_of(of[0]).run([rig_of(each) for each in of])


def test_a_rig_with_another_error_of_its_cams_has_the_same_controller():
    one, other = (scenario(f"rig.cam_error_percent=[{error}, 1.0]") for error in (2.5, -2.5))
    assert controller_key(one) == controller_key(other)
    assert controller_key(one) != controller_key(scenario("rig.limits.rate_deg=20"))


@pytest.mark.long
def test_one_library_serves_all_rigs_of_one_controller():
    wrong = [
        scenario(f"rig.cam_error_percent=[{error}, 1.0]", seconds=3.0) for error in (2.5, -2.5)
    ]
    assert library_of(wrong[0]) is library_of(wrong[1])
    expected, found = rows_of(wrong)
    assert expected[0]["rms_error"] != expected[1]["rms_error"]
    assert_same(expected, found, 1e-6)
    rigs = [scenario(f"seed={n}", f"plant.surface.seed={n}", *RIGS["uneven"][:1]) for n in (1, 2)]
    assert library_of(rigs[0]) is library_of(rigs[1])
    assert library_of(scenario("controller.kind=lqr")) is not library_of(scenario())


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (("plant.kind=mujoco",), "plant.kind: must be lagrange with engine = c"),
        (("sensors.ideal=true",), "sensors.ideal"),
        (('fault=[{at = 0.05, name = "unplug"}]',), "fault"),
        (("controller.computing_time=0.004",), "computing time"),
        (('change=[{at = 0.5, set = {"plant.friction.rolling_mm" = 0.3}}]',), "change"),
        (("controller.kind=mpc",), "mpc"),
    ],
)
def test_what_c_does_not_know_is_refused_in_one_line(settings, words):
    study = {
        "title": "t",
        "scenario": "circle",
        "set": [*EXACT, "duration=0.1", *settings],
        "engine": "c",
        "method": "grid",
        "parameters": {"plant.friction.rolling_mm": {"values": [0.1, 0.2]}},
    }
    with pytest.raises(TwinError, match=words) as refused:
        bp.study(study, processes=1)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("key", "values", "words"),
    [
        ("plant.kind", ("lagrange", "mujoco"), "plant.kind: must be lagrange with engine = c"),
        ("controller.computing_time", (0.0, 0.004), "computing time"),
        ("controller.kind", ("afl", "mpc"), "mpc"),
    ],
)
def test_what_c_does_not_know_of_a_later_point_is_refused_before_the_first_run(
    monkeypatch, key, values, words
):
    monkeypatch.setattr(compiled, "carry_out_compiled", lambda jobs: pytest.fail("a run began"))
    study = {
        "title": "t",
        "scenario": "circle",
        "set": ["duration=0.1", *(EXACT if key != "plant.kind" else ["baseline=false"])],
        "engine": "c",
        "method": "grid",
        "parameters": {key: {"values": values}},
    }
    with pytest.raises(TwinError, match=words) as refused:
        bp.study(study, processes=1)
    assert "\n" not in str(refused.value)


def test_each_controller_of_a_study_in_c_is_asked_for_once(monkeypatch):
    asked = []
    monkeypatch.setattr(compiled, "check_controller", asked.append)
    check = compiled.KnownCheck()
    rigs = [(law, seed) for seed in (1, 2) for law in ("afl", "lqr")]
    for law, seed in rigs:
        check(scenario(f"controller.kind={law}", f"seed={seed}"))
    check.check_controllers()
    assert [each.controller.kind for each in asked] == ["afl", "lqr"]


def test_a_missing_compiler_is_one_line(monkeypatch):
    monkeypatch.setattr(compiled, "_compiled", {})
    monkeypatch.setattr(shutil, "which", lambda _: None)
    with pytest.raises(TwinError, match="engine: c needs a C compiler"):
        library_of(scenario())


def test_a_study_in_c_keeps_its_runs_apart_from_those_of_python(tmp_path):
    study = {
        "title": "t",
        "scenario": "circle",
        "set": [*EXACT, "duration=0.5"],
        "method": "grid",
        "parameters": {"plant.friction.rolling_mm": {"values": [0.1, 0.2]}},
    }
    slow = bp.study(study, processes=1, out=tmp_path)
    quick = bp.study(study, processes=1, out=tmp_path, engine="c")
    assert {task.key for task in slow.work.tasks}.isdisjoint(task.key for task in quick.work.tasks)
    name = "tracking_error_percent"
    np.testing.assert_allclose(slow.to_pandas()[name], quick.to_pandas()[name], rtol=1e-6)
    assert "compiled C" in (tmp_path / "report.html").read_text(encoding="utf-8")


@pytest.mark.long
@pytest.mark.parametrize("name", ["circle", "sine", "step", "hold"])
@pytest.mark.parametrize("law", ["afl", "lqr", "pid"])
def test_indicators_of_random_rigs_are_those_of_numpy(name, law):
    family = read_family("uncertain")
    assert "uncertain" in shipped_in("families")
    build = Builder(name)
    fixed = (*EXACT, "duration=8", f"controller.kind={law}")
    rigs = [
        at_study_step(build((*fixed, f"seed={rig.seed}"), rig.point))
        for rig in draw_rigs(family, 77, 17)
    ]
    assert_same(*rows_of(rigs), rtol=1e-6)
