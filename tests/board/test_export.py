"""`twin.board.source`.

The C controller against the Python one, period by period."""

import ctypes
import math

import numpy as np
import pandas as pd
import pytest
from board_source import (
    LIMITS,
    MAX_ROUNDINGS,
    SCREEN,
    compiled,
    replayed,
    scenario,
    single_roundings,
)
from click.testing import CliRunner

import ballplate as bp
from twin.board.footprint import measure_footprint
from twin.cli.see import export as export_command
from twin.run.assemble import assemble
from twin.run.controller_source import _check_own, export

pytestmark = pytest.mark.usefixtures("no_footprint")

LAWS = {
    "pole_placement": "luenberger",
    "lqr": "luenberger",
    "feedforward": "kalman",
    "pid": "nonlinear_luenberger",
    "afl": "ekf",
    "afl_integral": "kalman",
    "backstepping": "nonlinear_luenberger",
    "sliding_mode": "luenberger",
}
"""Each law, with one of the observers."""
SHORT = ("lqr", "feedforward", "pid", "afl")
"""Laws by which every observer is exported once."""
QUICK = ("-O0",)
"""To optimise is most of what compiling takes; the long tests do, and the two short ones
of a predictor and of ``float``."""


@pytest.mark.short("lqr", "pid")
@pytest.mark.parametrize(
    "law", [pytest.param(each, marks=() if each in SHORT else pytest.mark.long) for each in LAWS]
)
def test_a_law_in_c_commands_what_it_commands_in_python(law, tmp_path):
    chosen = scenario(controller__kind=law, observer__kind=LAWS[law], duration=0.6)
    flags = QUICK if law in SHORT else ()
    passed, difference = replayed(compiled(export(tmp_path / "plate.c", chosen), *flags))
    assert passed
    assert difference < 1e-14


@pytest.mark.long
def test_predictor_and_limits_in_c_are_those_of_python_with_frames_lost(tmp_path):
    chosen = scenario(observer__kind="kalman", duration=1.2, **SCREEN, **LIMITS)
    folder = export(tmp_path / "plate.c", chosen)
    run = pd.read_csv(folder / "reference_run.csv")
    rates = run[["rate_phi", "rate_theta"]]
    assert rates.abs().max().max() == pytest.approx(math.radians(1.5))
    assert rates.diff().abs().max().max() == pytest.approx(0.5 * 0.002)
    assert not run.touched.all()
    assert run.age.max() > 1 / 133
    passed, difference = replayed(compiled(folder))
    assert passed
    assert difference < 1e-14


REFERENCES = {
    "hold": {"x": 0.05},
    "circle": {"start": 0.3},
    "setpoints": {"points": [[0.1, 0.0, 0.0], [0.2, 0.1, 0.05], [0.4, -0.1, 0.0]]},
    "path": {},
}
"""Constant, harmonic after a polynomial, filtered goals, and a table."""


@pytest.mark.short("hold", "path")
@pytest.mark.parametrize("kind", REFERENCES)
def test_a_reference_in_c_is_that_of_python(kind, tmp_path):
    settings = {f"reference__{key}": value for key, value in REFERENCES[kind].items()}
    chosen = scenario(reference=kind, duration=0.6, **settings)
    program = compiled(export(tmp_path / "plate.c", chosen), *QUICK)
    passed, difference = replayed(program, "reference: ")
    assert passed
    assert difference < 1e-12


@pytest.mark.long
def test_float_has_no_operation_in_double_and_differs_by_rounding_only(tmp_path):
    chosen = scenario(observer__kind="kalman", duration=0.6)
    folder = export(tmp_path / "plate.c", chosen, real="float")
    passed, difference = replayed(compiled(folder))
    assert passed
    assert 0 < difference < 1e-5
    assert difference < MAX_ROUNDINGS["kalman"] * single_roundings(folder)
    (folder / "test_plate.c").unlink()
    compiled(folder, "-c", "-Wdouble-promotion")


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"controller.kind": "mpc"}, "controller.kind: 'mpc' has no form in C; exported are"),
        ({"controller.kind": "tvlqr"}, "controller.kind: 'tvlqr' has no form in C; exported are"),
        ({"observer.kind": "ideal"}, "observer.kind: 'ideal' has no form in C; exported are"),
        ({"controller.period": 0.01}, "leave controller.period and controller.computing_time out"),
    ],
)
def test_what_has_no_form_in_c_is_refused_in_one_line(settings, text, tmp_path):
    with pytest.raises(bp.TwinError, match=text) as error:
        bp.controller_source("hold", tmp_path / "plate.c", settings)
    assert "\n" not in str(error.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["Plate.c", "2.c", "a-b.c", "plate.txt", "int.c", "math.c"])
def test_a_name_that_is_none_in_c_is_refused(name, tmp_path):
    with pytest.raises(bp.TwinError, match=r"names in C begin|must end in \.c"):
        bp.controller_source("hold", tmp_path / name, duration=0.1)


def test_the_command_writes_a_folder(tmp_path, monkeypatch):
    monkeypatch.setattr("twin.board.source.measure_footprint", measure_footprint)
    file = tmp_path / "plate.c"
    short = ["--set", "duration=0.1", "--set", "plant.kind=lagrange"]
    done = CliRunner().invoke(export_command, ["hold", str(file), "--real", "float", *short])
    assert done.exit_code == 0, done.output
    names = {each.name for each in (tmp_path / "plate").iterdir()}
    files = {"README.md", "plate.c", "plate.h", "test_plate.c", "reference_run.csv"}
    assert names == files | {"cortex-m4"}
    assert "typedef float plate_real;" in (tmp_path / "plate" / "plate.h").read_text("utf-8")
    _check_own(file)  # its own folder may be written again, that of somebody else may not
    (tmp_path / "plate" / "plate.c").write_text("int main(void) { return 0; }\n")
    with pytest.raises(bp.TwinError, match="no folder of an earlier export"):
        _check_own(file)


class Measurement(ctypes.Structure):
    """``struct plate_measurement``."""

    _fields_ = (
        *((name, ctypes.c_double) for name in ("x", "phi", "y", "theta", "age")),
        ("touched", ctypes.c_int),
    )


class Command(ctypes.Structure):
    """``struct plate_command``."""

    _fields_ = (
        ("rate", ctypes.c_double * 2),
        ("acceleration", ctypes.c_double * 2),
        ("estimate", ctypes.c_double * 8),
        ("valid", ctypes.c_int),
    )


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """A controller with integral action behind a predictor, as a shared library."""
    chosen = scenario(controller__kind="afl_integral", duration=0.01, **SCREEN)
    folder = export(tmp_path_factory.mktemp("c") / "plate.c", chosen)
    return ctypes.CDLL(str(compiled(folder, *QUICK, "-shared", "-fPIC")))


def commands(library, measurements):
    """Plate rates in rad/s, shape (n, 2), and whether each request is finite."""
    state, command = ctypes.create_string_buffer(4096), Command()
    desired = (ctypes.c_double * 10)()
    library.plate_init(state)
    found = []
    for each in measurements:
        library.plate_step(state, ctypes.byref(Measurement(*each)), desired, ctypes.byref(command))
        found.append((*command.rate, command.valid))
    rows = np.array(found)
    return rows[:, :2], rows[:, 2] == 1


def test_measurements_at_the_limits_and_beyond_never_give_a_rate_beyond_its_limits(library):
    draw = np.random.default_rng(4)
    rows = draw.uniform(-1, 1, (4000, 6)) * (0.3, 0.5, 0.2, 0.5, 0.2, 1.0)
    rates, valid = commands(library, [(*row[:5], int(row[5] > -0.5)) for row in rows.tolist()])
    assert valid.all()
    assert np.abs(rates).max() == pytest.approx(math.radians(35))
    assert np.abs(np.diff(rates, axis=0)).max() <= 7.0 * 0.002 + 1e-12


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", range(4))
def test_a_measurement_that_is_no_number_brakes_the_plate_and_is_reported(library, bad, place):
    good = [0.05, 0.01, -0.05, 0.01, 0.0, 1]
    wrong = good.copy()
    wrong[place] = bad
    rates, valid = commands(library, [good] * 20 + [wrong] * 200)
    assert valid[:20].all()
    assert not valid[-1]
    assert np.isfinite(rates).all()
    assert (rates[-1] == 0).all()


@pytest.mark.parametrize("age", [math.nan, math.inf, -1e30, 1e30, 0.11])
def test_a_position_of_an_impossible_age_counts_as_not_touched(library, age):
    begin = [(0.05, 0.0, -0.05, 0.0, 0.0, 1)]
    rates, valid = commands(library, begin + [(9.0, 0.0, 9.0, 0.0, age, 1)] * 50)
    untouched, _ = commands(library, begin + [(9.0, 0.0, 9.0, 0.0, 0.0, 0)] * 50)
    assert valid.all()
    assert (rates == untouched).all()


@pytest.mark.long
def test_a_run_that_the_c_code_drives_is_that_of_the_python_controller(tmp_path):
    chosen = scenario(controller__kind="afl", observer__kind="luenberger", duration=2.0, **SCREEN)
    folder = export(tmp_path / "plate.c", chosen)
    run = pd.read_csv(folder / "reference_run.csv")
    library = ctypes.CDLL(str(compiled(folder, *QUICK, "-shared", "-fPIC")))
    state, command, desired = ctypes.create_string_buffer(4096), Command(), (ctypes.c_double * 10)()
    library.plate_reference_at.argtypes = [ctypes.c_double, ctypes.c_void_p]
    library.plate_init(state)
    rates = []
    rig, _ = assemble(chosen, unseen=True)
    with rig:
        measured = rig.read()
        rig.supervisor.angle = measured.y[:, 1::2].copy()
        rig.start()
        for _ in range(len(run)):
            given = Measurement(*measured.y[0], measured.age[0], int(measured.touched[0]))
            library.plate_reference_at(measured.time, desired)
            library.plate_step(state, ctypes.byref(given), desired, ctypes.byref(command))
            rates.append(rig.write(np.array([command.rate]))[0])
            rig.wait()
            measured = rig.read()
    assert len(run) == 1000
    expected = run[["rate_phi", "rate_theta"]].to_numpy()
    assert np.abs(rates).max() > 0.01
    assert np.abs(rates - expected).max() < 1e-9
