"""`twin.fmu.export`.

An FMU as importers see it: valid, complete, simulated, saved, restored; what it refuses."""

import ctypes
import json
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
from c_rig import CRig, exact
from fmpy.validation import validate_fmu

import ballplate as bp
from controllers import fmu as fmu_law
from twin.fmu.export import exponents, parameters
from twin.run.controller_building import build_reference
from twin.scenario.describe import find_keys

HERE = Path(__file__).parent


@pytest.fixture(params=[2, 3])
def fmu(request, exported):
    return exported / f"rig{request.param}.fmu"


@pytest.mark.long
def test_fmpy_finds_nothing_to_complain_of(fmu):
    assert validate_fmu(str(fmu)) == []
    assert fmpy.read_model_description(str(fmu)).fmiVersion == f"{fmu.stem[-1]}.0"


def test_every_function_of_the_header_is_there(fmu):
    number = fmu.stem[-1]
    header = Path(fmpy.__file__).parent / "c-code" / f"fmi{number}Functions.h"
    declared = re.findall(rf"^#define (fmi{number}\w+) +fmi\dFullName", header.read_text(), re.M)
    assert len(declared) > 40
    (library,) = (fmu.parent / f"fmi{number}").rglob("*.so")
    loaded = ctypes.CDLL(str(library))
    assert [name for name in declared if not hasattr(loaded, name)] == []


def variables(fmu):
    """What its description lists, by name."""
    return {each.name: each for each in fmpy.read_model_description(str(fmu)).modelVariables}


def answers(fmu, name="out"):
    """The reference that lies in an FMU, or the commands of it."""
    folder = next((fmu.parent / f"fmi{fmu.stem[-1]}").glob("extra/*"))
    return np.genfromtxt(folder / f"reference_{name}.csv", delimiter=",", names=True)


def test_fmpy_finds_the_reference_that_lies_in_the_fmu(fmu):
    commands, expected = answers(fmu, "in"), answers(fmu)
    names = expected.dtype.names[1:]
    found = fmpy.simulate_fmu(
        str(fmu), start_values={"noise": False}, input=commands, output=list(names)
    )
    assert len(found) == len(expected) == 201
    for name in names:
        np.testing.assert_allclose(found[name], expected[name], rtol=0, atol=1e-10)
    assert abs(expected["true_x"]).max() > 1e-3
    noisy = fmpy.simulate_fmu(str(fmu), input=commands, output=list(names))
    assert abs(noisy["measured_x"] - expected["measured_x"]).max() > 1e-4


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("jump", [0.1013, 0.0501, 0.102])
def test_a_host_whose_input_jumps_between_two_periods_runs_it(exported, fmi, jump):
    """A host splits a communication step there only if the FMU says that it can take it."""
    fmu = exported / f"rig{fmi}.fmu"
    told = fmpy.read_model_description(str(fmu)).coSimulation
    assert not told.canHandleVariableCommunicationStepSize
    kinds = [("time", float), ("rate_phi", float), ("rate_theta", float)]
    rows = [(0.0, 0.0, 0.0), (jump, 0.0, 0.0), (jump, 0.2, -0.1), (0.3, 0.2, -0.1)]
    options = {"start_values": {"noise": False}, "output": ["true_phi"], "stop_time": 0.3}
    options |= {"output_interval": 0.002}
    found = fmpy.simulate_fmu(str(fmu), input=np.array(rows, dtype=kinds), **options)
    assert found["time"][-1] == pytest.approx(0.3)
    first = found["time"][np.flatnonzero(found["true_phi"])[0]]
    period = np.ceil(jump / 0.002 - 1e-9) * 0.002  # the first that begins with the new command
    assert first == pytest.approx(period + 0.002)


@pytest.mark.skipif(sys.platform != "linux", reason="libcosim is installed on Linux alone")
def test_another_importer_finds_the_reference_too(exported):
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
    from libcosimpy.CosimManipulator import CosimManipulator
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    log_output_level(CosimLogLevel.WARNING)
    fmu = exported / "rig2.fmu"  # libcosim reads FMI 1.0 and 2.0
    commands, expected, known = answers(fmu, "in"), answers(fmu), variables(fmu)
    execution = CosimExecution.from_step_size(2_000_000)  # nanoseconds
    rig = execution.add_local_slave(CosimLocalSlave(str(fmu), "rig"))
    execution.boolean_initial_value(rig, known["noise"].valueReference, value=False)
    observer, manipulator = CosimObserver.create_last_value(), CosimManipulator.create_override()
    execution.add_observer(observer)
    execution.add_manipulator(manipulator)
    ball = [known[name].valueReference for name in ("true_x", "true_y")]
    rates = [known[name].valueReference for name in commands.dtype.names[1:]]
    path = []
    for _, *given in commands[:-1]:
        manipulator.slave_real_values(rig, rates, given)
        assert execution.step()
        path.append(observer.last_real_values(rig, ball))
    wanted = np.column_stack((expected["true_x"], expected["true_y"]))
    np.testing.assert_allclose(path, wanted[1:], rtol=0, atol=1e-12)
    assert np.ptp(wanted, axis=0).min() > 1e-4


def test_the_description_says_between_which_numbers_a_variable_may_be(fmu):
    known = variables(fmu)
    wanted = {
        "plant.servo.backlash": (0.0, np.radians(5)),
        "plant.friction.breakaway_ratio": (1.0, 20.0),
        "seed": (0, 2**31 - 1),
        "sensors.noise_hold": (0.0, None),
        "true_x": (None, None),
        "noise": (None, None),
    }
    for name, ends in wanted.items():
        said = known[name].min, known[name].max
        assert [each and float(each) for each in said] == list(ends), name
    assert known["noise"].start == "true"


@pytest.mark.short("3")
def test_the_sources_that_are_listed_make_the_binary(fmu, tmp_path):
    unzipped = Path(fmpy.extract(str(fmu), str(tmp_path)))
    lists = (unzipped / "modelDescription.xml", unzipped / "sources" / "buildDescription.xml")
    listed = "".join(path.read_text() for path in lists if path.exists())
    names = re.findall(r'File name="(\w+\.c)"', listed)
    assert sorted(names) == sorted(path.name for path in (unzipped / "sources").glob("*.c"))
    made = tmp_path / "made.so"
    command = ["cc", "-std=c99", "-shared", "-fPIC", "-o", made, *names, "-lm"]
    subprocess.run(command, cwd=unzipped / "sources", check=True)
    assert hasattr(ctypes.CDLL(str(made)), f"fmi{fmu.stem[-1]}DoStep")


@pytest.mark.parametrize("serialized", [False, True])
def test_a_saved_state_goes_on_to_the_same_bits(library, serialized):
    scenario = exact(
        plant__servo__resonance_hz=14.0,
        plant__servo__vibration=1.0,
        plant__servo__vibration_wander=0.3,
        sensors__touch__frame_rate=133.0,
        plant__friction__breakaway_ratio=2.0,
        plant__friction__dwell_time=0.2,
    )
    rig = CRig(library, scenario).begin()
    rig.step([0.2, 0.1], 150)
    saved = ctypes.c_void_p()
    rig.call("GetFMUState", ctypes.byref(saved))
    other = CRig(library) if serialized else rig

    def go_on(which):
        which.tick = 150
        seen = []
        for i in range(100):
            which.step([0.3 * np.sin(i / 9), -0.1])
            seen.append([*which.measured, *which.truth])
        return np.array(seen)

    first = go_on(rig)
    if serialized:
        size = ctypes.c_size_t()
        rig.call("SerializedFMUStateSize", saved, ctypes.byref(size))
        held = (ctypes.c_uint8 * size.value)()
        rig.call("SerializeFMUState", saved, held, size)
        saved = ctypes.c_void_p()
        other.call("DeserializeFMUState", held, size, ctypes.byref(saved))
    other.call("SetFMUState", saved)
    assert go_on(other).tobytes() == first.tobytes()
    other.call("FreeFMUState", ctypes.byref(saved))


def test_what_cannot_be_done_is_said_in_a_line(library):
    rig = CRig(library)
    assert rig.set("plant.friction.rolling", -1.0) == 3
    assert rig.set("measured_x", 0.0) == 3
    assert rig.set("rig.period", 0.004) == 3
    rig.begin()
    assert rig.set("plant.start.x", 0.1) == 3
    for time, length in ((0.0, 0.003), (0.5, 0.002), (0.0, 0.0)):
        assert rig.go(time, length) == 3
    said = [
        "plant.friction.rolling is not in the range that the model description gives",
        "measured_x cannot be set",
        "rig.period cannot be set",
        "plant.start.x can be set before the first step only",
        "a step of 0.003 s is no multiple of the control period, rig.period",
        "a step from 0.5 s, but this FMU is at 0 s",
        "a step of 0 s is no multiple of the control period, rig.period",
    ]
    assert rig.said == said


def test_parameters_have_the_names_of_describe_and_its_numbers_in_si():
    keys = {key.key: key for key in find_keys()}
    factor = {"": 1.0, "_mm": 1e-3, "_um": 1e-6, "_deg": np.pi / 180, "_percent": 0.01}
    given = {"plant.friction.rolling_mm": 0.25, "plant.level_deg": [0.5, 1.0]}
    found = {}
    for each in parameters(exact(**{key.replace(".", "__"): v for key, v in given.items()})):
        found.setdefault(each.name.partition("[")[0], []).append(each.start)
    named = set()
    for base, values in found.items():
        (key,) = {base + end for end in factor} & keys.keys()
        said = np.ravel(given.get(key, keys[key].default))
        np.testing.assert_allclose(values, said * factor[key.removeprefix(base)], rtol=1e-15)
        named.add(key)
    rest = {key for key, its in keys.items() if not its.plants} - named
    known = ("plant.surface.", "plant.camber", "plant.shape", "plant.kind", "plant.step")
    known += (
        "plant.axes",
        "plant.ball_spin",
        "plant.ball.kind",
        "plant.linkage.phi_deg",
        "plant.linkage.theta_deg",
        "rig.period",
        "rig.cams",
        "rig.plate_lag",
        "sensors.ideal",
        "sensors.noise_hold",
    )
    ours = {key for key in rest if key.startswith(("plant.", "rig.", "sensors.", "disturbance"))}
    assert [key for key in ours if not key.startswith(known)] == []


def test_exponents_are_those_of_the_unit():
    assert exponents("kg m^2") == {"kg": 1, "m": 2}
    assert exponents("rad/s^2") == {"rad": 1, "s": -2}
    assert exponents("Hz") == {"s": -1}
    assert exponents("N m s/rad") == {"kg": 1, "m": 2, "s": -1, "rad": -1}


def test_every_name_on_the_page_about_simulink_is_one_of_the_fmu(fmu):
    page = (HERE.parents[1] / "docs" / "simulink.md").read_text(encoding="utf-8")
    (script,) = re.findall(r"^```matlab\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    listed = variables(fmu)
    for causality in ("input", "output"):
        (names,) = re.findall(rf"^{causality}s = \{{(.*)\}};$", script, re.MULTILINE)
        inside = [name for name, each in listed.items() if each.causality == causality]
        assert re.findall(r"'(\w+)'", names) == inside  # the order of the block's ports
    assert set(re.findall(r"(?:expected|out)\.(measured\w+)", script)) <= set(
        answers(fmu).dtype.names
    )
    assert set(re.findall(r"commands\.(\w+)", script)) == {"time"}
    steps = re.findall(r"'(?:FixedStep|FMUSampleTime|SampleTime)', '([\d.]+)'", script)
    assert set(steps) == {"0.002"}
    table = page[page.index("| variable |") : page.index("- A communication step")]
    for quoted in re.findall(r"`([a-z_.]+)`", table.replace("`_", "")):
        assert quoted in listed, quoted


@pytest.fixture
def quickly_compiled(monkeypatch):
    """To optimise is most of what an FMU takes to be made."""
    monkeypatch.setattr("twin.fmu.export.COMPILER_FLAGS", ("-std=c99", "-fPIC", "-shared"))


@pytest.mark.usefixtures("quickly_compiled")
def test_every_name_of_the_maestro_files_is_one_of_the_fmu_of_the_right_kind(tmp_path):
    page = (HERE.parents[1] / "docs" / "simulink.md").read_text(encoding="utf-8")
    files = re.findall(r"^```json\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    model, run = (json.loads(each) for each in files)
    path = tmp_path / "rig.fmu"
    bp.fmu("circle", path, with_reference=True, duration=0.02)
    of_rig = {f"{{rig}}.rig.{name}": each for name, each in variables(path).items()}
    of_law = {f"{{controller}}.law.{name}": "input" for name in fmu_law.FMU_INPUT_NAMES}
    of_law |= {f"{{controller}}.law.{name}": "output" for name in fmu_law.RATE_OUTPUTS}
    kinds = {name: each.causality for name, each in of_rig.items()} | of_law
    ends = [end for each in model["connections"].values() for end in each]
    assert {kinds[each] for each in model["connections"]} == {"output"}
    assert {kinds[each] for each in ends} == {"input"}
    assert len(set(ends)) == len(ends)
    assert {"{rig}.rig.rate_phi", "{rig}.rig.rate_theta"} <= set(ends)
    assert {kinds[each] for each in model["parameters"]} == {"parameter"}
    types = {"Real": float, "Boolean": bool}
    assert all(type(v) is types[of_rig[n].type] for n, v in model["parameters"].items())
    (logged,) = model["logVariables"].items()
    assert {f"{logged[0]}.{name}" for name in logged[1]} <= of_rig.keys()
    assert set(model["fmus"]) == {"{rig}", "{controller}"}
    assert run["algorithm"]["size"] == float(of_rig["{rig}.rig.rig.period"].start)


@pytest.mark.long
def test_equal_scenarios_make_equal_files(tmp_path):
    for folder in ("a", "b"):
        bp.fmu("circle", tmp_path / folder / "rig.fmu", duration=0.02)
    a, b = ((tmp_path / folder / "rig.fmu").read_bytes() for folder in ("a", "b"))
    assert a == b
    bp.fmu("circle", tmp_path / "b/rig.fmu", duration=0.02, rig={"period": 0.001})
    assert (tmp_path / "b/rig.fmu").read_bytes() != a


@pytest.mark.long
def test_without_a_compiler_there_are_the_sources_and_a_line(tmp_path, monkeypatch):
    monkeypatch.setattr("twin.base.programs.shutil.which", lambda _: None)
    with pytest.warns(bp.BallplateWarning, match=r"source only.*no C compiler"):
        path = bp.fmu("circle", tmp_path / "rig.fmu", duration=0.02)
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
    assert "sources/rig.c" in names
    assert not any("binaries" in name for name in names)
    assert validate_fmu(str(path)) == []


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (
            ["circle", "rig.fmu", "--fps", "2"],
            "of an .fmu there are the options --fmi, --reference, --controller, --real, --on",
        ),
        (
            ["circle", "rig.csv", "--fmi", "3"],
            "--fmi, --reference, --on and --set: need a file",
        ),
        (["cirle", "rig.fmu"], "cirle"),
        (["circle", "rig.fmu", "--set", "plant.friction.sliding=0.4"], "plant.friction.sliding"),
    ],
)
def test_a_wrong_request_is_told_in_a_line(refuse_export, arguments, line):
    assert line in refuse_export(*arguments)


@pytest.mark.long
def test_the_sanitizers_find_nothing(library, tmp_path):
    source = library.parents[2] / "sources"
    shell = HERE.parents[1] / "src/twin/fmu/c/fmi2.c"
    program = tmp_path / "exercise"
    names = (
        "rig.c",
        "noise.c",
        "instance.c",
        "fmi3.c",
        "fmi3_absent.c",
        "scenario.c",
        "variables.c",
    )
    files = [HERE / "exercise.c", *(source / name for name in names), shell]
    flags = "-std=c99 -Wall -Wextra -Wpedantic -Wconversion -Wno-unused-parameter -Werror -g -O1"
    flags += " -fsanitize=address,undefined -fno-sanitize-recover=all"
    command = ["cc", *flags.split(), f"-I{source}", "-o", program, *files, "-lm"]
    subprocess.run(command, check=True)
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.usefixtures("quickly_compiled")
@pytest.mark.parametrize("fmi", [pytest.param(2, marks=pytest.mark.long), 3])
def test_the_reference_is_an_output_where_it_is_asked_for(tmp_path, fmi, exported):
    path = tmp_path / "rig.fmu"
    bp.fmu("sine", path, duration=1.0, fmi=fmi, with_reference=True)
    assert validate_fmu(str(path)) == []
    names = [f"reference_{axis}{order}" for order in ("", "_rate", "_acc") for axis in "xy"]
    found = fmpy.simulate_fmu(str(path), output=names, stop_time=1.2, output_interval=0.002)
    scenario = exact("sine", duration=1.0)
    time = np.minimum(found["time"], 1.0)
    desired = build_reference(scenario)(time)
    for i, name in enumerate(names):
        np.testing.assert_allclose(found[name], desired[i // 2, :, i % 2], rtol=0, atol=1e-12)
    assert np.ptp(found["reference_x_acc"]) > 1e-3
    later = fmpy.simulate_fmu(
        str(path), output=names, start_time=0.5, stop_time=0.6, output_interval=0.002
    )
    assert later["time"][0] == 0.5
    np.testing.assert_allclose(later["reference_x"], found["reference_x"][250:301], atol=1e-12)
    assert not variables(exported / f"rig{fmi}.fmu").keys() & {*names}
