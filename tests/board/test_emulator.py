"""`twin.board.program`: compiled for a Cortex-M4F and run by QEMU."""

import re
import shutil
import subprocess

import numpy as np
import pytest

import ballplate as bp
from ballplate.changes import changes_of, scenario_of
from twin.base.errors import LawError
from twin.board import program as programs
from twin.board.program import command_of, compile_controller, size_of
from twin.board.protocol import ANSWER_LENGTH, Answer, decode, encode
from twin.board.trace import LAWS
from twin.run.controller_building import control_of

MISSING = [name for name in ("arm-none-eabi-gcc", "qemu-system-arm") if shutil.which(name) is None]
pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(bool(MISSING), reason=f"not installed: {', '.join(MISSING)}"),
]
KEYS = {"plant.kind": "lagrange", "baseline": False}
OBSERVERS = ("kalman", "nonlinear_luenberger", "luenberger", "ekf")


def run(program, scenario="circle", duration=0.5, **settings):
    keys = {key.replace("__", "."): value for key, value in settings.items()}
    return bp.run(scenario, KEYS | {"board.program": str(program)} | keys, duration=duration)


def control(**settings):
    keys = {key.replace("__", "."): value for key, value in settings.items()}
    return control_of(scenario_of("circle", changes_of(KEYS | keys, {})))


def test_without_a_function_of_math_h_it_gives_the_bits_of_this_computer():
    given = {"controller__kind": "pole_placement", "plant__start__x": 0.05}
    here, there = (run(each, "hold", **given) for each in ("host", "cortex-m4"))
    for name in here.keys() - {"instructions"}:
        np.testing.assert_array_equal(there[name], here[name], err_msg=name)
    assert np.abs(there["requested_phi_acc"]).max() > 0.1
    assert len(set(there["instructions"])) < 10  # the same branches, period after period


@pytest.mark.parametrize(
    ("law", "observer"),
    [(each.name, OBSERVERS[i % 4]) for i, each in enumerate(LAWS[:-1])],
)
def test_every_law_drives_the_twin_as_in_python(law, observer):
    start = {"plant__start__x": 0.05, "plant__start__y": -0.03}
    done = run("cortex-m4", controller__kind=law, observer__kind=observer, **start)
    python = done.beside["Python"]
    assert done.metrics["command_difference"] < 1e-5
    assert 1000 < done.metrics["instructions_median"] < 10_000
    np.testing.assert_allclose(done["true_x"], python["true_x"], rtol=0, atol=1e-7)
    assert np.abs(python["requested_phi_acc"]).max() > 0.1


def test_double_is_calculated_in_software_and_equals_python():
    done = run("cortex-m4", board__real="double", duration=0.2)
    assert done.metrics["command_difference"] < 1e-12
    assert done.metrics["instructions_median"] > 20_000


def test_the_instructions_of_a_period_are_the_same_each_time():
    one, other = (run("cortex-m4", duration=0.1)["instructions"] for _ in range(2))
    np.testing.assert_array_equal(one, other)


MEASURED = [0.0, 0.01, 0.001, 0.02, -0.001, 0.0, 1.0, 0.1, 0, 0, 0.1, -0.1, 0, 0, -0.1, 0.1, 0]


def test_the_count_is_that_of_the_emulator_s_own_trace_of_instructions(tmp_path):
    """QEMU writes down the address of every instruction; those of the controller are counted."""
    program, trace = compile_controller(control(), "cortex-m4", "float"), tmp_path / "trace"
    more = ["-singlestep", "-d", "exec,nochain", "-D", str(trace)]
    asked = [encode(k + 1, [0.002 * k, *MEASURED[1:]]) for k in range(3)]
    said = subprocess.run(
        [*command_of(program), *more], input=b"".join(asked), capture_output=True, check=True
    ).stdout[22:]
    size = 6 + 8 * ANSWER_LENGTH
    counted = [
        Answer.of(decode(said[k * size : (k + 1) * size], k + 1, ANSWER_LENGTH)).instructions
        for k in range(3)
    ]
    names = {}
    listing = subprocess.run(
        ["arm-none-eabi-nm", program], capture_output=True, text=True, check=True
    ).stdout
    for address, _, name in (line.split() for line in listing.splitlines()):
        names.setdefault(name, int(address, 16) & ~1)
    found = re.findall(r"^Trace \d+: \S+ \[\w+/(\w+)/", trace.read_text(), re.MULTILINE)
    executed = [int(each, 16) for each in found]
    begins = [i for i, each in enumerate(executed) if each == names["controller_reference_at"]]
    main = range(names["main"], min(each for each in names.values() if each > names["main"]))
    own = []
    for begin in begins:
        step = executed.index(names["controller_step"], begin)
        own.append(next(i for i in range(step, len(executed)) if executed[i] in main) - begin)
    # between the two looks at the counter main itself prepares two calls
    assert [0 <= count - each <= 4 for count, each in zip(counted, own, strict=True)] == [True] * 3
    assert counted[0] > counted[1] == counted[2] > 1000


def test_memory_is_stated():
    single, double = (
        size_of(compile_controller(control(), "cortex-m4", real), "cortex-m4")
        for real in ("float", "double")
    )
    assert 8_000 < single.flash_bytes < double.flash_bytes < 40_000
    assert 500 < single.ram_bytes < double.ram_bytes < 5_000


def build(folder, text=None):
    """The ``.elf`` that the README of an exported folder says how to make."""
    if text is not None:
        (folder / "plate.c").write_text(text, "utf-8")
    readme = (folder / "README.md").read_text("utf-8")
    command = re.search(r"^arm-none-eabi-gcc .*$", readme, re.MULTILINE)[0]
    subprocess.run(command.split(), cwd=folder, check=True)
    return folder / "plate.elf"


def exported(tmp_path):
    return bp.controller_source("circle", tmp_path / "plate.c", KEYS, duration=0.1, real="float")


def test_the_program_that_the_readme_builds_is_run_by_its_file(tmp_path):
    elf = build(exported(tmp_path))
    np.testing.assert_array_equal(
        run(elf, duration=0.1)["requested_phi_acc"],
        run("cortex-m4", duration=0.1)["requested_phi_acc"],
    )
    with pytest.raises(LawError, match=r"is made for a period of 0.002 s; rig.period is 0.004"):
        run(elf, duration=0.1, rig__period=0.004)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("for (;;) out->valid = 1;", "gave no answer within 0.5 s"),
        ("*(volatile int *)0xFFFF0000u = out->valid;", "its process ended, exit status 1"),
        ("m = 0; out->rate[0] = ((float (*)(void))m)();", "its process ended, exit status"),
        ("c->state[0] = 1.0f / 0.0f - 1.0f / 0.0f;", r"its law's request is not a number|not all"),
    ],
)
def test_a_program_that_fails_in_mid_run_is_one_line(line, words, tmp_path):
    folder = exported(tmp_path)
    text = (folder / "plate.c").read_text("utf-8")
    begin = "    y[0] = m->x;\n"
    assert text.count(begin) == 1
    elf = build(
        folder, text.replace(begin, begin + f"    if (c->started && m->age >= 0) {{ {line} }}\n")
    )
    with pytest.raises(LawError, match=words) as error:
        run(elf, duration=0.1, board__time_limit=0.5)
    assert "\n" not in str(error.value)


def test_a_program_that_does_not_fit_into_the_memory_is_one_line(monkeypatch):
    write = programs._write

    def with_less_memory(texts, folder):
        script = texts["cortex-m4/board.ld"].replace("LENGTH = 4M", "LENGTH = 8K")
        write(texts | {"cortex-m4/board.ld": script}, folder)

    monkeypatch.setattr(programs, "_write", with_less_memory)
    with pytest.raises(bp.TwinError, match=r"needs \d+ bytes more than the FLASH of") as error:
        run("cortex-m4", reference__kind="path")
    assert "\n" not in str(error.value)
