"""`ballplate`.

`ballplate.run` does what the command does, to the bit; what it changes is said in Python."""

import json
import re
import subprocess
import sys
import warnings
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from command_line import called

import ballplate
from ballplate.changes import changes_of, scenario_of
from ballplate.dangers import warn_of_dangers
from ballplate.reporter import Notebook, Reporter
from ballplate.rig_access import rig_label
from twin.base.shipped import shipped_in
from twin.run.loop import simulate
from twin.run.reach import beyond_area, out_of_reach
from twin.scenario import load

QUICK = {"plant": {"kind": "lagrange"}, "duration": 0.2, "metrics": {"start": 0}}


@dataclass(frozen=True, kw_only=True)
class Proportional(ballplate.laws.Law):
    """Tilts against the ball's distance."""

    name: ClassVar[str] = "proportional"
    gain: float = 20.0

    def control(self, t, x, reference, q):
        away = reference(t)[0] - x[..., 0::4] - x[..., 1::4]
        return self.gain * away * [1.0, -1.0] - 60 * x[..., 2::4] - 14 * x[..., 3::4]


@pytest.fixture(scope="module")
def circle():
    """The mechanism and the clean model, for a moment."""
    return ballplate.run("circle", ["duration=0.2", "metrics.start=0"])


def test_the_same_call_and_command_write_the_same_files(tmp_path, circle, capsys):
    circle.save(tmp_path / "python")
    shorter = ("--set", "duration=0.2", "--set", "metrics.start=0")
    assert called(capsys, "run", "circle", *shorter, "--out", tmp_path / "command")[0] == 0
    for name in ("run.parquet", "picture.png"):
        one, other = ((tmp_path / each / name).read_bytes() for each in ("python", "command"))
        assert one == other, name
    numbers = [
        json.loads((tmp_path / each / "metrics.json").read_text()) for each in ("python", "command")
    ]
    assert {**numbers[0], "real_time_factor": 0} == {**numbers[1], "real_time_factor": 0}


def test_tables_dotted_keys_and_texts_change_the_same():
    tables = changes_of((), {"plant": {"friction": {"rolling_mm": 0.1}}, "controller": "lqr"})
    dotted = changes_of({"plant.friction.rolling_mm": np.float64(0.1), "controller": "lqr"}, {})
    texts = changes_of(["plant.friction.rolling_mm=0.1", "controller.kind=lqr"], {})
    assert tables == dotted == texts


def test_a_table_changes_only_the_keys_it_names():
    done = ballplate.run("circle", **{**QUICK, "reference": {"amplitude": 0.1}})
    assert done.scenario.reference.settings == {"amplitude": 0.1, "omega": 0.75}
    assert done.title.endswith("metrics.start=0, reference.amplitude=0.1)")


def test_a_law_by_class_is_all_of_its_settings_not_those_of_the_scenario():
    afl = ballplate.laws.AFL(gains=(180.0, 162.0, 66.0, 13.0))
    given, default, kept = (
        ballplate.run("circle", controller=each, **QUICK) for each in (afl, type(afl), "afl")
    )
    assert given["requested_phi_acc"].tobytes() == kept["requested_phi_acc"].tobytes()
    assert default.scenario.controller.settings == {}


def test_keys_beside_a_law_by_class_change_what_it_says():
    keys = {"controller.period": 0.004, "controller.gains": [1.0, 2.0, 3.0, 4.0]}
    changed = scenario_of("circle", changes_of(keys, {"controller": ballplate.laws.AFL}))
    assert changed.controller.period == 0.004
    assert changed.controller.settings == {"gains": [1.0, 2.0, 3.0, 4.0]}


@pytest.mark.filterwarnings("ignore::ballplate.BallplateWarning")
def test_a_law_of_the_running_program_runs_and_its_new_version_takes_its_place():
    first = ballplate.run("hold", controller=Proportional(gain=30.0), **QUICK)
    assert '(controller={kind="proportional", gain=30.0}, ' in first.title

    class Other(Proportional):
        """Does nothing."""

        name = "proportional"

        def control(self, t, x, reference, q):
            return np.zeros((1, 2))

    second = ballplate.run("hold", controller=Other, **QUICK)
    assert first["requested_phi_acc"].any()
    assert not second["requested_phi_acc"].any()


@pytest.mark.filterwarnings("ignore::ballplate.BallplateWarning")
def test_a_law_that_only_this_process_knows_runs_in_it(monkeypatch):
    monkeypatch.setattr("twin.base.jobs.pool", None)
    found = ballplate.compare(
        "hold", vary={"controller": [Proportional, "lqr"]}, processes=2, **QUICK
    )
    assert [each.outcome for each in found.values()] == ["finished", "finished"]


def test_what_is_unwise_is_a_warning_of_the_line_that_asked_for_it():
    gains = {"kind": "afl", "gains": [1800.0, 1620.0, 660.0, 13.0]}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        ballplate.run("hold", controller=gains, **QUICK)
    (warning,) = caught
    assert warning.category is ballplate.BallplateWarning
    assert warning.filename == __file__


def dangers(scenario, *settings):
    """What somebody is warned of who would run it."""

    class Told(Reporter):
        def warn(self, message):
            found.append(message)

    found = []
    warn_of_dangers(load(scenario, settings), Told())
    return found


@pytest.mark.parametrize(
    "rig",
    # the beam has one axis, as the tube has, and is the dearest of all
    [
        pytest.param(each, marks=[pytest.mark.long] if each == "beam" else [])
        for each in (None, *shipped_in("rigs"))
    ],
)
def test_who_tells_the_cure_what_a_rig_file_says_is_warned_of_nothing(rig):
    assert dangers("cure", *([f"parameters={rig}"] if rig else [])) == []


@pytest.mark.parametrize(
    ("settings", "on"),
    [
        ((), ""),
        (("parameters=hobby",), " --on hobby"),
        (("plant.size=[0.5, 0.5]",), " --set plant.size=[0.5,0.5]"),
    ],
)
def test_the_advice_on_an_unstable_loop_names_the_rig(settings, on):
    poles = ("controller.kind=afl", "controller.poles=[-30,-31,-32,-33]")
    (said,) = (each for each in dangers("hold", *settings, *poles) if "unstable" in each)
    assert f"`ballplate run cure{on}` has a law that knows" in said
    assert f"`ballplate tune afl{on}` searches other gains" in said


@pytest.mark.short("settings[1-9]-*")
@pytest.mark.parametrize(
    ("settings", "line"),
    [
        (["omega=5.0"], r"0\.75 m/s at the start, from rest, and for up to 3\.75 m/s\^2.*1\d\d mm"),
        (["omega=1.5"], r"0\.22 m/s at the start, from rest\).*for 1?\.?\d+ s .* \d\d mm away"),
        (["omega=0.5"], None),
        (
            ["omega=5.0", "law=afl"],
            r"it asks for up to 3\.75 m/s\^2, a plate at 10 deg gives 1\.02",
        ),
        (["omega=0.5", "law=afl"], None),
    ],
)
def test_a_reference_that_the_plate_cannot_give_is_said_before_the_run(settings, line):
    omega, *law = (each.split("=")[1] for each in settings)
    path = f'reference={{kind="sine",amplitude=[0.15,0.0],omega={omega}}}'
    found = out_of_reach(load("circle" if law else "cure", [path]))
    assert found is None if line is None else re.search(line, found)


@pytest.mark.parametrize("scenario", ["cure", "circle", "step", "sine", "hold", "excite"])
def test_of_a_reference_that_the_plate_can_give_nothing_is_said(scenario):
    assert out_of_reach(load(scenario)) is None


@pytest.mark.parametrize(
    ("amplitude", "line"),
    [
        (0.15, None),
        (15.0, "reference.amplitude: 15 m is beyond rig.limits.area = 0.25, 0.15 m; in 1 s the"),
        ([0.1, 15.0], "reference.amplitude: 0.1, 15 m is beyond rig.limits.area"),
        ([0.1, 0.2], "reference.amplitude: 0.1, 0.2 m is beyond rig.limits.area"),
        ([0.2, 0.1], None),
    ],
)
def test_a_length_beyond_the_area_is_said_where_the_run_ends_before_it(amplitude, line):
    kind = "sine" if isinstance(amplitude, list) else "circle"
    settings = ["duration=1", f"reference={{kind='{kind}', amplitude={amplitude}}}"]
    found = beyond_area(load("circle", settings))
    assert found is None if line is None else found.startswith(line)


@pytest.mark.parametrize(
    ("reference", "line"),
    [
        ("{kind='path', points=[[0, 0], [0.1, 9]], duration=99}", "reference.points: 0.1, 9 m is"),
        ("{kind='path', points=[[0, 0], [0.2, 0.1]], duration=99}", None),
        ("{kind='setpoints', points=[[0, 0, 0], [9, 0.1, 9]]}", "reference.points: 0.1, 9 m is"),
        ("{kind='setpoints', points=[[0, 0, 0], [9, 0.1, 0.1]]}", None),  # 9 is a time
    ],
)
def test_a_point_beyond_the_area_is_said_where_the_run_ends_before_it(reference, line):
    found = beyond_area(load("circle", ["duration=1", f"reference={reference}"]))
    assert found is None if line is None else found.startswith(line)


@pytest.mark.parametrize(
    ("points", "line"),
    [("[[0, 0], [0.01, 9]]", None), ("[[0, 0], [9, 0]]", "reference.points: 9 m is beyond")],
)
def test_on_one_axis_no_y_is_beyond_the_area(points, line):
    reference = f"reference={{kind='path', points={points}, duration=99}}"
    found = beyond_area(load("line", ["parameters=tube", "duration=1", reference]))
    assert found is None if line is None else found.startswith(line)


HOBBY = "cure parameters=hobby"  # a lag of 60 ms and 30 ms of dead time
SLOW = "cure plant.servo.bandwidth_hz=8.0 sensors.touch.dead_time=0.055"  # 20 ms and 13 ms
BLIND = "observer.plate=modelled"
SHORTER = "the dead time is 16 ms shorter than predictor.delay: above 15 ms"
BELIEVED = {
    f"{HOBBY} rig.plate_lag=0.031": None,
    f"{HOBBY} rig.plate_lag=0.029": "drives and dead time are 31 ms later",
    f"{HOBBY} sensors.touch.dead_time=0.05 rig.plate_lag=0.04": "40 ms later",
    "cure sensors.touch.dead_time=0.08": "38 ms later",
    SLOW: None,  # the observer finds a lag of up to 30 ms
    f"{SLOW} {BLIND}": "33 ms later",
    "cure_afl parameters=hobby rig.plate_lag=0.0 controller.gains=[60,54,30,8]": None,
    f"{HOBBY} plant.servo.dead_time=0.05": "50 ms later",
    f"{HOBBY} plant.servo.dead_time=0.05 {BLIND}": "50 ms later",
    # what the predictor knows is where the ball was seen, and without encoders all of it
    f"{HOBBY} plant.servo.dead_time=0.05 {BLIND} predictor.delay=0.08": None,
    f"{HOBBY} plant.servo.dead_time=0.05 predictor.delay=0.08": "50 ms shorter",
    f"{HOBBY} predictor.delay=0.044": None,
    f"{HOBBY} predictor.delay=0.046": SHORTER,
    # the one does not make up for the other
    f"{HOBBY} predictor.delay=0.06 rig.plate_lag=0.03": "30 ms shorter",
    f"{HOBBY} rig.plate_lag=0.1": None,  # costs nothing
}
"""A scenario and what is set of it to what is told, where anything is."""


@pytest.mark.parametrize("asked", BELIEVED)
def test_30_ms_later_or_15_ms_less_dead_time_than_the_cure_believes_is_a_warning(asked):
    told = BELIEVED[asked]
    found = dangers(*asked.split())
    assert [told in each for each in found] == [True] * (told is not None)
    assert not any("\n" in each for each in found)


def test_a_dither_beyond_the_limits_of_the_commands_is_a_warning():
    # a lag of 60 ms at 7 Hz: 2.82 times the circle of the plate
    shaken = ["parameters=hobby", "controller.dither_hz=7"]
    assert not dangers("cure", *shaken, "controller.dither_deg=0.4")
    (line,) = dangers("cure", *shaken, "controller.dither_deg=0.5")
    assert "needs 62.1 deg/s and 47.6 rad/s^2 at dither_hz = 7" in line
    (line,) = dangers("cure", *shaken, "controller.dither_deg=0.4", "rig.limits.rate_deg=40")
    assert "rig.limits allows 40 and 40" in line


@pytest.mark.long
@pytest.mark.parametrize(
    ("rig", "lag", "delay", "told"),
    [
        ("hobby", 60, 0.03, (0.92, 1.71, 1.62)),
        ("course", 40, 0.01, (0.65, 1.13, 1.28)),
        (None, 0, 0.042, (0.11, 3.06, 1.49)),
    ],
)
def test_from_where_on_these_warnings_come_the_cure_errs_more_most_on_the_rig_of_the_thesis(
    rig, lag, delay, told
):
    on = ["baseline=false", "plant.step=0.002", "reference.omega=1.0"]
    on += ["duration=14.0", "metrics.start=7.7", *([f"parameters={rig}"] if rig else [])]
    slower = f"plant.servo.bandwidth_hz={1000 / (2 * np.pi * (lag + 30)):.5g}"
    slower = slower if rig else f"sensors.touch.dead_time={delay + 0.03}"
    more = f"predictor.delay={delay + 0.015}"
    scenarios = [load("cure", [*on, *off]) for off in ((), (slower,), (more,))]
    found = [simulate([each])[0]["tracking_error_percent"] for each in scenarios]
    assert found == pytest.approx(told, abs=0.05)


def test_progress_of_a_run_and_its_clean_model_is_told(circle):
    class Told(Reporter):
        def __init__(self):
            self.labels = []

        def progress(self, what, total, unit=""):
            self.labels.append((what, total))
            return super().progress(what, total, unit)

    told = Told()
    ballplate.run("circle", ["duration=0.2", "metrics.start=0"], reporter=told)
    assert told.labels == [("honest twin", 0.2), ("clean model", 0.2)]
    assert [circle.label, circle.baseline.label] == ["honest twin", "clean model"]


class Formatter(dict):
    """As IPython's: what makes a picture of an object, by type."""

    lookup_by_type = dict.__getitem__
    for_type = dict.__setitem__


@pytest.mark.long
def test_in_a_notebook_long_work_tells_its_progress_and_figures_are_pictures(monkeypatch, capsys):
    module = type(sys)("IPython")
    module.version_info = (9, 0, 0)  # matplotlib asks for it when it draws for the first time
    formatter = Formatter()
    formats = type("Formats", (), {"formatters": {"image/png": formatter}})
    shell = type("Shell", (), {"kernel": None, "display_formatter": formats})
    module.get_ipython = lambda: shell
    monkeypatch.setitem(sys.modules, "IPython", module)
    assert ballplate.run("hold", **QUICK).finished
    assert capsys.readouterr().out == ""  # it takes no ten seconds
    monkeypatch.setattr("ballplate.reporter.LINE_EVERY", -1.0)
    assert isinstance(ballplate.reporter.default(), Notebook)
    figure = ballplate.run("hold", **QUICK).plot()
    assert capsys.readouterr().out == "exact equations: 1%\n"
    assert formatter.lookup_by_type(type(figure))(figure).startswith(b"\x89PNG")


LIGHT = """
import sys
before = set(sys.modules)
import ballplate
print(*{name.partition(".")[0] for name in set(sys.modules) - before})
"""


def test_the_import_loads_no_library_but_its_own():
    done = subprocess.run([sys.executable, "-c", LIGHT], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert {"ballplate", "twin"} <= loaded
    assert loaded - {"ballplate", "twin", "controllers"} <= set(sys.stdlib_module_names)


def pd(t, x, reference, *, kp=6.0, kd=5):
    """Proportional and derivative, of ball and plate."""
    r = reference(t)
    goal = (kp * (r[0] - x[..., 0::4]) + kd * (r[1] - x[..., 1::4])) / 5.886
    return 100 * (goal * [1, -1] - x[..., 2::4]) - 20 * x[..., 3::4]


def test_a_function_is_a_law_with_its_keywords_as_settings():
    law = ballplate.law(pd)
    brief = {"duration": 0.2, "plant.kind": "lagrange"}
    done = ballplate.run("hold", brief, controller=law(kp=7.0))
    assert done.finished
    assert done.scenario.controller.kind == "pd"
    assert done.classes["controller"]["settings"] == {"kp": 7.0, "kd": 5}
    assert done.classes["controller"]["file"] == "test_run.py"
    other = ballplate.run("hold", brief | {"controller": law, "controller.kd": 5.5}, baseline=False)
    assert other.scenario.controller.settings["kd"] == 5.5  # of a 5, any number
    x = np.array([[0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.07, 0.08]])
    hold = ballplate.references.Hold()
    np.testing.assert_array_equal(law().control(0.0, x, hold, x[:, :0]), pd(0.0, x, hold))


@pytest.mark.long
def test_beside_the_twin_of_another_rig_runs_the_clean_model_of_it():
    brief = {"duration": 2.0, "metrics.start": 1.0}
    other = ballplate.run("circle", brief | {"parameters": "hobby"})
    assert other.label == "honest twin"
    clean, twin = (run.metrics["tracking_error_percent"] for run in (other.baseline, other))
    assert 20 * clean < twin
    assert other.baseline.scenario.plant.size == other.scenario.plant.size == (0.3, 0.3)
    assert ballplate.run("circle", brief | {"plant.kind": "lagrange"}).baseline is None


def test_faults_of_a_scenario_are_refused_where_nothing_can_have_them(tmp_path, monkeypatch):
    faulty = tmp_path / "faulty.toml"
    faulty.write_text(
        'title = "t"\nduration = 2.0\n[controller]\nkind = "lqr"\n[reference]\nkind = "setpoints"\n'
        'points = [[0.0, 0.0, 0.0]]\n[[fault]]\nat = 1.0\nname = "sync lost"\n'
    )
    for attempt in (ballplate.run, ballplate.compare):
        with pytest.raises(ballplate.TwinError, match=r"\[\[fault\]\]: only the virtual rig can"):
            attempt(faulty)
    with monkeypatch.context() as light:  # before anything of a run is imported
        light.setitem(sys.modules, "ballplate.results", None)
        with pytest.raises(ballplate.TwinError, match=r"no fault 'sync losst'; did you mean"):
            ballplate.run(faulty, ['fault=[{at=1.0, name="sync losst"}]'], on="emulated")
    with pytest.raises(ballplate.TwinError, match=r"fault\.0\.name"):
        ballplate.run(faulty, ["fault=[{at=1.0}]"])


def test_a_rig_is_called_by_the_title_of_its_file(tmp_path):
    named, plain = tmp_path / "one.toml", tmp_path / "two.toml"
    named.write_text('title = "mine"\nbackend = "mine.py:Mine"\n')
    plain.write_text('backend = "mine.py:Mine"\n')
    assert [rig_label(str(each)) for each in (named, plain)] == ["mine", "rig two"]
    assert rig_label("emulated") == "rig emulated"
    with pytest.raises(ballplate.TwinError, match=r"three\.toml: cannot be read"):
        rig_label(str(tmp_path / "three.toml"))


def test_a_wrong_rig_file_is_refused_before_anything_of_a_bus_is_imported(tmp_path, monkeypatch):
    (tmp_path / "rig.toml").write_text("no TOML")
    monkeypatch.setitem(sys.modules, "twin.devices.akd.recording", None)
    for name, reason in (("rig.toml", "not a TOML file"), ("none.toml", "cannot be read")):
        with pytest.raises(ballplate.TwinError, match=reason):
            ballplate.run("circle", on=tmp_path / name, out=tmp_path / "runs")
