"""`twin.fmu`.

A controller FMU of either version, compiled here, against the same feedback in Python."""

import inspect
import re
import subprocess
import zipfile
from dataclasses import dataclass
from pathlib import Path

import fmpy.fmi2
import fmpy.fmi3
import numpy as np
import pytest

import ballplate as bp
from ballplate.changes import changes_of, scenario_of
from controllers import catalog, fmu
from controllers.interfaces import Law
from twin.base.errors import LawError, ScenarioError
from twin.devices.akd.decoding import Conversation
from twin.devices.akd.traces import read_trace
from twin.run.controller_building import build_reference
from twin.run.loop import simulate

IMPORTER = {2: fmpy.fmi2, 3: fmpy.fmi3}
X, Y = [17.3, 21.7, 64.5, 16.7], [-17.3, -21.7, 64.5, 16.7]
GAINS = np.array([[*X, *4 * [0.0]], [*4 * [0.0], *Y]])
INPUTS = [
    f"equivalent_{each}{rate}" for each in ("x", "phi", "y", "theta") for rate in ("", "_rate")
]
INPUTS += ["reference_x", "reference_x_rate", "reference_y", "reference_y_rate"]
ACCELERATIONS = ("requested_phi_acc", "requested_theta_acc")


VARIABLE = {
    2: '<ScalarVariable name="{}" causality="{}" valueReference="{}"><Real {}/></ScalarVariable>',
    3: '<Float64 name="{}" causality="{}" valueReference="{}" {}/>',
}
GIVEN = {2: '<Unknown index="{1}"/>', 3: '<Output valueReference="{0}"/>'}
DESCRIPTION = {
    2: """<?xml version="1.0"?><fmiModelDescription fmiVersion="2.0" modelName="controller"
guid="1">
<CoSimulation modelIdentifier="controller"/><ModelVariables>{}</ModelVariables>
<ModelStructure><Outputs>{}</Outputs></ModelStructure></fmiModelDescription>""",
    3: """<?xml version="1.0"?><fmiModelDescription fmiVersion="3.0" modelName="controller"
instantiationToken="1"><CoSimulation modelIdentifier="controller"/><ModelVariables>{}<Float64
name="time" valueReference="99" causality="independent" variability="continuous"/></ModelVariables>
<ModelStructure>{}</ModelStructure></fmiModelDescription>""",
}


@dataclass(frozen=True, kw_only=True)
class SameInPython(Law):
    name = "same_in_python"

    def control(self, t, x, reference, q):
        r = reference(t)
        wanted = np.zeros_like(x)
        wanted[..., [0, 4]], wanted[..., [1, 5]] = r[0], r[1]
        return -(x - wanted) @ GAINS.T


def compile_controller(
    folder, *, fmi=2, bad=0, at=1.0, total=0.0, inputs=INPUTS, outputs=ACCELERATIONS
):
    rows = ", ".join("{%s}" % ", ".join(map(repr, row.tolist())) for row in GAINS)  # noqa: UP031
    source = Path(__file__).with_name("controller.c")
    library = folder / f"controller{fmi}.so"
    given = {"FMI": fmi, "BAD": bad, "AT": at, "SUM": total, "GAINS": f"{{{rows}}}"}
    named = [f"-D{key}={value}" for key, value in given.items()]
    functions = re.findall(rf"[\"'](fmi{fmi}[A-Z]\w+)[\"']", inspect.getsource(IMPORTER[fmi]))
    rest = folder / "rest.c"  # what an importer looks for and this controller does not have
    weak = "__attribute__((weak)) int {}(void) {{ return 3; }}\n"
    rest.write_text("".join(map(weak.format, dict.fromkeys(functions))))
    made = ["cc", "-std=gnu99", "-fPIC", "-shared", "-ffp-contract=off", *named, source, rest]
    subprocess.run([*made, "-o", library], check=True)
    causality = [*((each, "input") for each in inputs), *((each, "output") for each in outputs)]
    variables = "".join(
        VARIABLE[fmi].format(name, what, i, 'start="0"' if what == "input" else "")
        for i, (name, what) in enumerate(causality)
    )
    gives = "".join(GIVEN[fmi].format(i, i + 1) for i in range(len(inputs), len(causality)))
    text = DESCRIPTION[fmi].format(variables, gives)
    place = {2: "linux64", 3: "x86_64-linux"}[fmi]
    path = folder / f"controller{fmi}.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", text)
        archive.write(library, f"binaries/{place}/controller.so")
    return path


def changed(kind, **settings):
    keys = {key.replace("__", "."): value for key, value in settings.items()}
    brief = {"plant.kind": "lagrange", "duration": 0.6, "metrics.start": 0.0}
    return brief | {"plant.start.x": 0.05, "plant.start.y": 0.02} | {"controller.kind": kind} | keys


def scenario(kind, **settings):
    return scenario_of("circle", changes_of(changed(kind, **settings), {}))


def run(path, **settings):
    return bp.run("circle", changed("fmu", controller__file=str(path), **settings))


@pytest.mark.short("3")
@pytest.mark.parametrize("fmi", [2, 3])
def test_it_does_what_the_same_feedback_does_in_python(tmp_path, fmi):
    path = compile_controller(tmp_path, fmi=fmi)
    catalog.register(SameInPython)
    try:
        rigs = [{"seed": 1}, {"seed": 2, "plant__friction__rolling_mm": 0.3}]
        own = simulate([scenario("same_in_python", **each) for each in rigs])
    finally:
        catalog.unregister("same_in_python")
    theirs = simulate([scenario("fmu", controller__file=str(path), **each) for each in rigs])
    for a, b in zip(own, theirs, strict=True):
        assert b["tracking_error_percent"] == pytest.approx(a["tracking_error_percent"], rel=1e-9)
    one, other = (each["tracking_error_percent"] for each in own)
    assert one != pytest.approx(other, rel=1e-3)


@pytest.mark.long
def test_each_rig_has_an_instance_that_remembers_its_own(tmp_path):
    path = str(compile_controller(tmp_path, total=0.02))
    rigs = [scenario("fmu", controller__file=path, seed=seed) for seed in (1, 2)]
    alone = [simulate([each])[0] for each in rigs]
    assert simulate(rigs) == alone
    assert alone[0]["tracking_error_percent"] != alone[1]["tracking_error_percent"]


@pytest.mark.long
def test_rates_are_what_the_plate_is_told(tmp_path):
    # what is requested is a period of the difference to the rate of before, here added up anew
    path = compile_controller(tmp_path, outputs=("rate_phi", "rate_theta"))
    record = run(path, duration=0.1).record
    error = record["estimate"][:, 0].copy()
    along = build_reference(scenario("afl"))(record.time)
    error[:, [0, 4]] -= along[0]
    error[:, [1, 5]] -= along[1]
    rates = np.cumsum(record["applied"][:, 0], axis=0) * record.period
    before = np.vstack((np.zeros(2), rates[:-1]))
    expected = (-error @ GAINS.T - before) / record.period
    np.testing.assert_allclose(record["requested"][:, 0], expected, rtol=1e-9, atol=1e-9)
    assert np.abs(expected).max() > 1.0


def test_periods_that_a_loop_missed_pass_for_an_fmu_too(tmp_path):
    # its integrator adds up x once a step of 2 ms: three of them, then those missed up to 20 ms
    law = fmu.FmuLaw(file=str(compile_controller(tmp_path, total=1.0)))
    process = law.start(np.zeros(8), None, 0.002)
    given = np.zeros((1, len(fmu.FMU_INPUT_NAMES)))
    given[0, fmu.FMU_INPUT_NAMES.index("equivalent_x")] = 1.0
    times = [0.0, 0.002, 0.004, 0.020, 0.022]
    sums = [-(GAINS[0, 0] + process.ask(each, given)[0]) for each in times]
    assert sums == pytest.approx([1, 2, 3, 11, 12])


@pytest.mark.parametrize(
    ("bad", "words"),
    [(1, "no numbers"), (2, "no answer within 0.3 s"), (3, "process ended"), (4, "fmi2DoStep")],
)
def test_what_fails_is_one_line_and_ends_the_run(tmp_path, bad, words):
    path = compile_controller(tmp_path, bad=bad, at=0.2)
    with pytest.raises(LawError) as caught:
        run(path, controller__time_limit=0.3, duration=0.5)
    assert words in str(caught.value)
    assert "controller.file" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.long
def test_files_that_are_no_controller_are_named(tmp_path):
    with pytest.raises(ScenarioError, match=r"there is no 'none\.fmu'"):
        run("none.fmu")
    other = tmp_path / "text.fmu"
    other.write_text("no zip")
    with pytest.raises(LawError, match=r"controller\.file .*text\.fmu: "):
        run(other)
    with pytest.raises(LawError, match="has the input speed; inputs may be estimated_x"):
        run(compile_controller(tmp_path, inputs=["speed"]))
    with pytest.raises(LawError, match="must have the outputs rate_phi and rate_theta"):
        run(compile_controller(tmp_path, outputs=("phi",)))


WIRE = {"plant.kind": "mujoco", "duration": 4.0, "controller.kind": "fmu", "baseline": False}


def on_the_wire(tmp_path, **faulty):
    path = compile_controller(tmp_path, **faulty)
    return bp.run(
        "circle", WIRE | {"controller.file": str(path)}, on="emulated", out=tmp_path / "r"
    )


@pytest.mark.long
@pytest.mark.real_time
def test_it_drives_the_emulated_wire_as_it_drives_the_simulated_rig(tmp_path):
    done = on_the_wire(tmp_path)
    assert done.metrics["outcome"] == "finished"
    path = tmp_path / "controller2.fmu"
    simulated = bp.run("circle", WIRE | {"controller.file": str(path)})
    seen, own = (each.metrics["tracking_error_percent"] for each in (done, simulated))
    assert seen == pytest.approx(own, abs=3.0)


@pytest.mark.long
@pytest.mark.real_time
@pytest.mark.parametrize(
    ("bad", "words"), [(2, "no answer within 0.04 s"), (3, "process ended"), (1, "no numbers")]
)
def test_where_it_fails_on_the_wire_the_plate_is_levelled_and_the_record_whole(
    tmp_path, bad, words
):
    done = on_the_wire(tmp_path, bad=bad, at=2.5)
    assert done.metrics["outcome"] == "aborted"
    assert words in done.metrics["reason"]
    assert done["time"][-1] == pytest.approx(2.5, abs=0.06)
    heard = Conversation(read_trace(tmp_path / "r" / "trace.log").frames)
    for node in (1, 2):
        assert heard.nodes[node].drive[-2:] == ["operation enabled", "switch on disabled"]
        plate = np.array(heard.series[node, (0x2050, 0)].counts) * 360 / 245760
        assert np.abs(plate - plate[0]).max() > 0.2
        assert abs(plate[-1] - plate[0]) < 0.1  # degrees
