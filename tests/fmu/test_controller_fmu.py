"""`twin.fmu.controller`.

A scenario's controller as an FMU: alone, with the rig's FMU, and as a law of the loop."""

import subprocess
import sys
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
from c_rig import counted, exact, followed
from fmpy.validation import validate_fmu
from fmu_pair import MEASURED, RATES, Unit, coupled

import ballplate as bp
from controllers.fmu import FMU_INPUT_NAMES, FmuLaw
from twin.board.source import sources
from twin.run.assemble import assemble
from twin.run.controller_building import control_of

SILENT = {"sensors.touch.variance": [0.0, 0.0], "sensors.encoders.variance": [0.0, 0.0]}
OFF_CENTRE = {"plant.start.x": 0.05, "plant.start.y": 0.03, "duration": 0.4}
"""The rig of the fixture ``exported``."""


@pytest.fixture(autouse=True, scope="module")
def quickly_compiled():
    """To optimise is most of what an FMU takes to be made."""
    with pytest.MonkeyPatch.context() as patch:
        flags = ("-std=c99", "-fPIC", "-shared", "-ffp-contract=off")
        patch.setattr("twin.fmu.export.COMPILER_FLAGS", flags)
        yield


def settings(law="pid", observer="kalman", **more):
    """Changes of the circle's scenario."""
    found = OFF_CENTRE | {"plant.kind": "lagrange", "observer.kind": observer}
    return found | {"controller.kind": law} | more


@pytest.fixture(scope="module")
def controllers(tmp_path_factory):
    """Path of a controller's FMU; each is made once."""
    known = {}

    def path(fmi=3, law="pid", observer="kalman", **more):
        key = (fmi, law, observer, *more.items())
        if key not in known:
            file = tmp_path_factory.mktemp("controller") / f"controller{fmi}.fmu"
            known[key] = bp.controller_fmu("circle", file, settings(law, observer), fmi=fmi, **more)
        return known[key]

    return path


def reference_of(file, name):
    """The reference in an FMU: its inputs, or outputs."""
    with zipfile.ZipFile(file) as archive:
        (found,) = (each for each in archive.namelist() if each.endswith(f"reference_{name}.csv"))
        with archive.open(found) as table:
            return np.genfromtxt(table, delimiter=",", names=True)


@pytest.mark.short("3")
@pytest.mark.parametrize("fmi", [2, 3])
def test_fmpy_accepts_it_and_finds_the_commands_of_python(controllers, fmi):
    file = controllers(fmi)
    assert validate_fmu(str(file)) == []
    given, expected = reference_of(file, "in"), reference_of(file, "out")
    found = fmpy.simulate_fmu(
        str(file), input=given, output=RATES, stop_time=0.4, output_interval=0.002
    )
    assert len(found) == len(expected) == 201
    for name in RATES:
        np.testing.assert_allclose(found[name], expected[name], rtol=0, atol=1e-12)
        assert np.abs(expected[name]).max() > 1e-3


def test_within_is_the_c_source_that_is_exported_for_boards(controllers):
    expected = sources("controller", control_of(exact("circle", **under(settings()))), "double")
    with zipfile.ZipFile(controllers()) as archive:
        for name in ("controller.c", "controller.h"):
            found, wanted = archive.read(f"sources/{name}").decode(), expected[name]
            # the title of the scenario names its changes in another order
            assert found.split("\n", 1)[1] == wanted.split("\n", 1)[1]


def under(changes):
    """Keys with ``__`` for dots."""
    return {key.replace(".", "__"): value for key, value in changes.items()}


@pytest.mark.short("3")
@pytest.mark.parametrize("fmi", [2, 3])
def test_with_the_rig_it_is_the_run_of_the_twin(controllers, exported, fmi):
    silent = exact("circle", **under(settings(**SILENT)))
    expected = followed(*assemble(silent), silent)
    rig = Unit(exported / f"rig{fmi}.fmu", noise=False)
    found = coupled(rig, Unit(controllers(fmi)), 200)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
    assert np.ptp(expected[:, [0, 4]], axis=0).min() > 1e-4


@pytest.mark.skipif(sys.platform != "linux", reason="libcosim is installed on Linux alone")
def test_a_master_that_steps_both_at_once_gives_each_command_one_period_late(controllers, exported):
    """libcosim does: that is the run of a rig that acts on commands one period later."""
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    log_output_level(CosimLogLevel.FATAL)  # it takes `time` for a variable that needs a start
    files = exported / "rig2.fmu", controllers(2)
    places = [{name: each.valueReference for name, each in Unit(f).known.items()} for f in files]
    execution = CosimExecution.from_step_size(2_000_000)  # nanoseconds
    rig, controller = (execution.add_local_slave(CosimLocalSlave(str(f), f.stem)) for f in files)
    execution.boolean_initial_value(rig, places[0]["noise"], value=False)
    for names, source, sink, one, other in (
        (MEASURED, rig, controller, *places),
        (RATES, controller, rig, *reversed(places)),
    ):
        for name in names:
            execution.connect_real_variables(source, one[name], sink, other[name])
    execution.connect_boolean_variables(rig, places[0]["touched"], controller, places[1]["touched"])
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer)
    ball = [places[0][name] for name in ("true_x", "true_y")]
    found = []
    for _ in range(199):
        assert execution.step()
        found.append(observer.last_real_values(rig, ball))
    runs = []
    for dead_time in (0.002, 0.0):
        changes = settings(**SILENT, **{"plant.servo.dead_time": dead_time})
        scenario = exact("circle", **under(changes))
        runs.append(followed(*assemble(scenario), scenario)[1:, [0, 4]])
    np.testing.assert_allclose(found, runs[0], rtol=0, atol=1e-9)
    assert np.abs(runs[1] - runs[0]).max() > 1e-5


@pytest.mark.parametrize("fmi", [pytest.param(2, marks=pytest.mark.long), 3])
def test_as_a_law_of_the_loop_it_commands_what_python_does(controllers, fmi):
    """On the mechanism in MuJoCo, also while the ball is not seen."""
    brief = {"baseline": False, "sensors.touch.hidden": [0.053, 0.0, 0.0543, 0.1]}
    brief |= OFF_CENTRE | {"duration": 0.3, "observer.kind": "kalman"}
    brief |= {"sensors.touch.frame_rate": 133.0}
    law = {"controller.kind": "fmu", "controller.file": str(controllers(fmi))}
    theirs = bp.run("circle", brief | law).record
    own = bp.run("circle", brief | {"controller.kind": "pid"}).record
    assert not own["touched"].all()
    np.testing.assert_allclose(theirs["applied"], own["applied"], rtol=0, atol=1e-9)
    assert np.abs(own["applied"]).max() > 0.1


def test_periods_that_a_loop_missed_are_periods_without_touch(controllers):
    file = controllers()
    seen = {"measured_x": 0.05, "measured_y": 0.03}
    late = Unit(file)
    for k, touched in enumerate([True, True, False, False, True]):
        late.put(seen | {"touched": touched})
        late.fmu.doStep(0.002 * k, 0.002)
    process = FmuLaw(file=str(file)).start(np.zeros(8), None, 0.002)
    given = np.zeros((1, len(FMU_INPUT_NAMES)))
    for name, value in (seen | {"touched": 1.0}).items():
        given[0, FMU_INPUT_NAMES.index(name)] = value
    for time in (0.0, 0.002, 0.008):
        answer = process.ask(time, given)
    np.testing.assert_allclose(0.002 * answer, late.get(*RATES), rtol=1e-12)
    assert np.abs(answer).min() > 0


@pytest.mark.long
def test_a_reference_from_outside_is_followed_as_the_one_within(controllers):
    inside, outside = Unit(controllers()), Unit(controllers(reference_inputs=True))
    given = reference_of(controllers(reference_inputs=True), "in")
    named = [name for name in given.dtype.names if name.startswith("reference_")]
    assert len(named) == 10
    for k, row in enumerate(given[:100]):
        for unit in (inside, outside):
            unit.put({name: float(row[name]) for name in MEASURED})
        outside.put({name: float(row[name]) for name in named})
        for unit in (inside, outside):
            unit.fmu.doStep(0.002 * k, 0.002)
        np.testing.assert_allclose(outside.get(*RATES), inside.get(*RATES), rtol=0, atol=1e-12)
    outside.put({"reference_x": 0.1})
    for unit in (inside, outside):
        unit.fmu.doStep(0.2, 0.002)
    assert np.abs(outside.get(*RATES) - inside.get(*RATES)).max() > 1e-3


@pytest.mark.long
def test_a_reference_is_that_of_the_simulated_time(controllers):
    """A simulation that begins later follows the later part of the path."""
    on_time, late = Unit(controllers()), Unit(controllers(), start=0.2)
    outside = Unit(controllers(reference_inputs=True))
    given = reference_of(controllers(reference_inputs=True), "in")[100]
    outside.put({name: float(given[name]) for name in given.dtype.names if "reference" in name})
    for unit, time in ((on_time, 0.0), (late, 0.2), (outside, 0.0)):
        unit.fmu.doStep(time, 0.002)
    np.testing.assert_allclose(late.get(*RATES), outside.get(*RATES), rtol=0, atol=1e-12)
    assert np.abs(late.get(*RATES) - on_time.get(*RATES)).max() > 1e-6


@pytest.mark.long
def test_a_controller_in_float_differs_by_rounding_alone(controllers):
    given, rates = reference_of(controllers(), "in")[:100], []
    for real in ("double", "float"):
        unit = Unit(controllers(real=real))
        for k, row in enumerate(given):
            unit.put({name: float(row[name]) for name in MEASURED})
            unit.fmu.doStep(0.002 * k, 0.002)
        rates.append(unit.get(*RATES))
    assert 0 < np.abs(rates[1] - rates[0]).max() < 1e-5


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_saved_state_goes_on_to_the_same_bits(controllers, fmi):
    unit = Unit(controllers(fmi), measured_x=0.05)
    name = "FMUState" if fmi == 3 else "FMUstate"

    def go_on():
        for k in range(30, 60):
            unit.put({"measured_x": 0.05 + 1e-4 * k})
            unit.fmu.doStep(0.002 * k, 0.002)
        return unit.get(*RATES, "estimated_x_rate").tobytes()

    for k in range(30):
        unit.fmu.doStep(0.002 * k, 0.002)
    saved = getattr(unit.fmu, f"get{name}")()
    first = go_on()
    getattr(unit.fmu, f"set{name}")(saved)
    assert go_on() == first
    getattr(unit.fmu, f"free{name}")(saved)


def test_what_no_controller_takes_is_no_number_and_is_reported(controllers):
    unit = Unit(controllers())
    for k in range(20):
        unit.put({"measured_x": np.nan if k > 9 else 0.05})
        unit.fmu.doStep(0.002 * k, 0.002)
        assert unit.get("valid")[0] == (k <= 9)
        assert np.isfinite(unit.get(*RATES)).all()


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (
            ["circle", "c.fmu", "--controller", "--set", "controller.kind=mpc"],
            "controller.kind: 'mpc' has no form in C; exported are pole_placement",
        ),
        (["circle", "c.fmu", "--controller", "--fps", "2"], "there are the options --fmi"),
        (["circle", "c.c", "--controller"], "--controller: exports an FMU; the file"),
        (["circle", "c.c", "--fmi", "3"], "--fmi and --reference need a file"),
        (["akd", "c.fmu", "--controller", "--bus"], "--controller: exports an FMU"),
        (["circle", "c.fmu", "--real", "float"], "--real: for a controller in C; the file"),
    ],
)
def test_a_wrong_request_is_one_line(refuse_export, arguments, line):
    assert line in refuse_export(*arguments)


LAWS = ("pole_placement", "lqr", "feedforward", "pid", "afl", "afl_integral", "backstepping")
LAWS += ("sliding_mode",)
OBSERVERS = ("luenberger", "kalman", "nonlinear_luenberger", "ekf")


@pytest.mark.long
@pytest.mark.parametrize("observer", OBSERVERS)
@pytest.mark.parametrize("law", LAWS)
def test_each_law_with_each_observer_and_the_rig_is_the_run_of_the_twin(tmp_path, law, observer):
    """With the noise of the rig's FMU, frames of the screen, and some of them lost."""
    frames = {"sensors.touch.frame_rate": 133.0, "sensors.touch.lost": 0.02, "seed": 5}
    moving = {"plant.friction.rolling_mm": 0.05, "duration": 3.0}
    changes = settings(law, observer, **frames, **moving)
    scenario = exact("circle", **under(changes))
    files = bp.fmu("circle", tmp_path / "rig.fmu", changes), tmp_path / "controller.fmu"
    bp.controller_fmu("circle", files[1], changes, fmi=3)
    twin = assemble(scenario)
    expected = followed(counted(twin.rig, 5), twin.controller, scenario)
    found = coupled(*(Unit(file) for file in files), 1500)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
    assert np.ptp(expected[:, [0, 4]], axis=0).min() > 1e-3


NARROW = {"rig.limits.rate_deg": 3.0, "rig.limits.acceleration": 0.5, "rig.limits.angle_deg": 1.0}


@pytest.mark.long
def test_at_the_limits_and_with_a_period_of_its_own_it_is_the_run_of_the_twin(tmp_path):
    changes = settings(**SILENT, **NARROW) | {"rig.period": 0.001, "duration": 1.0}
    scenario = exact("circle", **under(changes))
    expected = followed(*assemble(scenario), scenario)
    rig = Unit(bp.fmu("circle", tmp_path / "rig.fmu", changes), noise=False)
    controller = Unit(bp.controller_fmu("circle", tmp_path / "controller.fmu", changes))
    found = coupled(rig, controller, 1000, 0.001)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
    # plate rates are in the columns 3 and 7
    assert np.abs(np.diff(expected[:, [3, 7]], axis=0)).max() == pytest.approx(0.5 * 0.001)


@pytest.mark.long
def test_compiler_and_sanitizers_find_nothing(controllers, tmp_path):
    with zipfile.ZipFile(controllers()) as archive:
        archive.extractall(tmp_path)
    source = tmp_path / "sources"
    flags = "-std=c99 -Wall -Wextra -Wpedantic -Wconversion -Wno-unused-parameter -Werror -g -O1"
    flags += " -fsanitize=address,undefined -fno-sanitize-recover=all"
    files = [Path(__file__).with_name("exercise_controller.c"), *source.glob("*.c")]
    build = ["cc", *flags.split(), f"-I{source}", "-o", tmp_path / "exercise", *files, "-lm"]
    subprocess.run(build, check=True)
    done = subprocess.run([tmp_path / "exercise"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.long
def test_a_law_that_plans_ahead_has_no_reference_as_inputs(tmp_path):
    keys = {"plant.kind": "lagrange"}
    with pytest.raises(bp.TwinError, match="'stable_inversion' plans ahead along the scenario's"):
        bp.controller_fmu("cure", tmp_path / "cure.fmu", keys, duration=0.1, reference_inputs=True)
    assert not list(tmp_path.iterdir())
