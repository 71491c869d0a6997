"""`twin.board.friction_map`: the whole cure in C, with its map and the motion that it follows."""

import re
import shutil

import numpy as np
import pytest
from board_source import FRAMES, compiled, remeasured, replayed

import ballplate as bp
from ballplate.changes import changes_of, scenario_of
from twin.board import program as programs
from twin.board.friction_map import LocalFriction, map_of
from twin.run.controller_building import control_of
from twin.run.controller_source import export

KEYS = {"plant.kind": "lagrange"}
SANITIZERS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g")
COMPILED = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
FAST = {"reference__omega": 1.2, "reference__start": 1.5}
"""A circle on which the ball passes from cell to cell within few seconds."""


def chosen(name="cure", duration=3.0, **changes):
    keys = {key.replace("__", "."): value for key, value in changes.items()}
    return scenario_of(name, changes_of(KEYS | {"duration": duration} | keys, {}))


def test_the_map_has_135_points_and_a_camber():
    observer = control_of(chosen()).observer
    numbers = map_of(observer)
    assert (numbers.lines, numbers.size) == ((15, 9), 137)
    assert map_of(control_of(chosen("cure_afl")).observer).size == 135
    # what C keeps in the struct, counted from its declaration
    assert numbers.numbers == 137 + 9 * 146 + 137 * 138 // 2 + 2 * 32 * 137 + 6 * 137 + 6


def test_the_equations_without_the_map_are_those_of_the_observer_itself():
    observer = control_of(chosen()).observer
    local = LocalFriction.of(observer)
    assert local.resting_walk == observer.resting_walk
    np.testing.assert_array_equal(local._Q, observer._Q)
    assert "cuts" not in vars(observer)


def wild(run):
    """Frames in which nothing is felt and the position is no number, and a ball that is moved."""
    run.loc[700:730, "touched"] = 0
    run.loc[700:730, ["x", "y"]] = np.nan
    run.loc[900:, "x"] += 0.03


CASES = {
    "cure": {},
    "afl": {"name": "cure_afl"},
    "frames": FRAMES,
    "modelled": {"observer__plate": "modelled", "rig__plate_lag": 0.02},
    "dither": {"controller__dither_deg": 0.3, "rig__plate_lag": 0.02},
}


@pytest.mark.long
@pytest.mark.parametrize("which", CASES)
def test_the_cure_in_c_commands_what_it_commands_in_python(which, tmp_path):
    case = chosen(**(FAST | CASES[which]))
    folder = export(tmp_path / "plate.c", case)
    remeasured(folder, case, wild)
    passed, difference = replayed(compiled(folder, *SANITIZERS))
    assert passed
    assert difference < 1e-10


@pytest.mark.long
@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("name", ["cure", "cure_afl"])
def test_the_cure_in_c_is_that_of_python_over_25_s(name, real, tmp_path):
    folder = export(tmp_path / "plate.c", chosen(name, 25.0, **FRAMES), real=real)
    passed, difference = replayed(compiled(folder, *SANITIZERS))
    assert passed
    assert difference < {"double": 1e-9, "float": 2e-3}[real]


@pytest.mark.long
@COMPILED
def test_in_float_the_ball_is_as_near_to_its_path_as_in_python():
    done = bp.run("cure", KEYS | {"board.program": "host", "board.real": "float"}, duration=15.0)
    python = done.beside["Python"].metrics["tracking_error_percent"]
    assert python < 1.0
    assert done.metrics["tracking_error_percent"] == pytest.approx(python, abs=2e-3)
    assert done.metrics["command_difference"] < 1e-3


MISSING = [name for name in ("arm-none-eabi-gcc", "qemu-system-arm") if shutil.which(name) is None]


@pytest.mark.long
@pytest.mark.skipif(bool(MISSING), reason=f"not installed: {', '.join(MISSING)}")
def test_the_cure_fits_the_memory_of_a_board_and_no_period_is_much_longer_than_the_others():
    control = control_of(chosen())
    size = programs.size_of(programs.compile_controller(control, "cortex-m4", "float"), "cortex-m4")
    assert size.flash_bytes < 64_000
    assert size.ram_bytes < 128_000
    keys = KEYS | {"board.program": "cortex-m4", "baseline": False}
    instructions = bp.run("cure", keys, duration=4.0)["instructions"].ravel()
    assert instructions[0] < 2_000_000  # the first period samples the path ahead
    assert instructions[1:].max() < 260_000
    assert instructions[1:].max() < 1.5 * np.median(instructions[1000:])


MUTATIONS = (
    # the covariance over a period
    (r"c->shares\[i\] \* \(j < 9", "c->shares[0] * (j < 9"),
    (r"c->place\[axis\] \* with_camber", "with_camber"),
    (r"A\[4\] \* c->P\[6\]\[j\]", "A[4] * c->P[7][j]"),
    (r"after\[3\] \+= A\[7\]", "after[3] += A[6]"),
    (r"moved\[i\]\[2\] \+= A\[6\]", "moved[i][2] -= A[6]"),
    (r"P\[9 \+ POINTS \+ j\]", "P[9 + POINTS]"),
    (r"c->P\[j\]\[i\] = c->P\[i\]\[j\]", "c->P[j][i] = c->P[i][i]"),
    # a sample
    (r"c->P\[i\]\[i\] = weights\[i\]", "c->P[i][i] += weights[i]"),
    (r"L\[1\] \* x \+ L\[2\]", "L[2]"),
    (r"innovation\[1\] \* y", "innovation[0] * y"),
    (r"learns \|\| i < 6 \? ALL : 6", "ALL"),
    (r"learns \? 9 : 6", "9"),
    (r"c->rows\[i\]\[j\] -= x", "c->rows[i][j] += x"),
    (r"changed\[9 \+ j\]", "changed[8 + j]"),
    (r"c->P\[i / 4\]\[i % 4\] \+= struck", "c->P[i / 4][i % 4] -= struck"),
    # the map's covariance in blocks
    (r"c->block = 1 - c->block;", ""),
    (r"c->folded\+\+;", "c->folded += 2;"),
    (r"n < c->folded \? c->folded : 0", "0"),
    (r"j <= n \? row_of\(c, n\)\[j\] : row_of\(c, j\)\[n\]", "row_of(c, n)[j <= n ? j : n]"),
    (r"n2 \* w2\[j\] \+ ", ""),
    (r"        clear_block\(c\);", ""),
    (r"find_point\(cell.points, c->near\[i\]\)\]", "i]"),
    # its prior
    (r"-scale \* \(step_y", "-scale * (step_x"),
    (r"CAMBER_STD \* CAMBER_STD", "CAMBER_STD"),
    # the motion
    (r"MOTION_NEAR \* w\[4 \+ i\] \+ MOTION_FAR \*", "MOTION_FAR * w[4 + i] + MOTION_NEAR *"),
    (r"MOTION_FAR \* w\[4 \+ i\]\n", "MOTION_NEAR * w[4 + i]\n"),
    (r"now \+ REACH\) %", "now + REACH - 1) %"),
    (r"now \+ AHEAD - 1\)", "now + AHEAD - 2)"),
    (r"now % SLICE == 0", "now == 0"),
    (r"slope_rate - change", "slope_rate + change"),
    (r"10 - 15 \* t", "10 - 14 * t"),
    (r"60 \* t \* \(1 - t\)", "50 * t * (1 - t)"),
    # what is generated
    (r"LAW_SLOW_K\[1\]", "LAW_SLOW_K[0]"),
    (r"known\[0\]", "known[1]"),
    (r"OBSERVER_Q\[8\]", "OBSERVER_Q[7]"),
)
"""Pattern in the C source and its replacement, at the first place."""


@pytest.mark.long
def test_the_test_program_notices_every_mutation_of_map_and_motion(tmp_path):
    off = {"plant__start__x": 0.12, "plant__start__y": 0.05}
    case = chosen(**FAST, **FRAMES, **off)
    folder = export(tmp_path / "plate.c", case)
    remeasured(folder, case, wild)
    source = folder / "plate.c"
    whole = source.read_text("utf-8")
    quick = ("-O0", "-Wno-error")
    assert replayed(compiled(folder, *quick))[0]
    unnoticed = []
    for pattern, replacement in MUTATIONS:
        mutated, count = re.subn(pattern, replacement, whole, count=1)
        assert count, f"{pattern} is not in the source"
        source.write_text(mutated, "utf-8")
        if replayed(compiled(folder, *quick))[0]:
            unnoticed.append(pattern)
    assert not unnoticed
