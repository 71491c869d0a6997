"""`twin.cli`: A command starts fast: it imports nothing heavy before it needs it."""

import json
import os
import subprocess
import sys

import pytest

from twin.cli import main

UNUSED = {
    "control", "pandas", "sympy", "rerun", "matplotlib.pyplot", "scipy.signal",
    "scipy.stats", "scipy.interpolate", "scipy.optimize", "scipy.special", "glfw",
}  # fmt: skip
"""What no run with a nonlinear law needs, whatever it writes."""
LATE = {"matplotlib", "mujoco", "pyarrow", "PIL"}
"""What a run needs for its plant and its files, but not to be imported."""
HEAVY = UNUSED | LATE | {"numpy", "scipy", "pydantic"}
"""What help, lists and mistakes never need."""
SHORT = ("--set", "duration=0.2", "--set", "metrics.start=0")

COMMAND = """
from twin.cli import main
try:
    main(sys.argv[1:])
except SystemExit as ended:
    code = ended.code
"""


def modules(tmp_path, program, *arguments):
    """What a program leaves as ``code``, and the modules that it imported."""
    whole = f"import json, sys\ncode = 0\n{program}\nprint(json.dumps([code, [*sys.modules]]))"
    done = subprocess.run(
        [sys.executable, "-c", whole, *arguments],
        cwd=tmp_path, capture_output=True, text=True, check=True,
    )  # fmt: skip
    code, names = json.loads(done.stdout.splitlines()[-1])
    return code, set(names)


EVERY = """
from importlib import import_module
from twin.cli import COMMANDS, main
for place in COMMANDS.values():
    import_module(place.partition(":")[0])
code = []
for line in sys.argv[1:]:
    try:
        main(line.split())
    except SystemExit as ended:
        code.append(ended.code)
"""
DONE = (
    "",
    "--help",
    "--version",
    "list",
    "list --json",
    "run --help",
    "study",
    "tune --json",
    "fit",
)
MISTAKES = (
    "rn", "run cirle", "compare cirle", "explain cirle", "analyse cirle", "emulate cirle",
    "emulate --bus no",
    "doctor --scenario cirle", "study no", "tune no", "fit no", "sweep no duration=1:2:2",
    "play no", "identify no", "shadow no", "whatif no --at 1", "calibrate level no",
    "report --out /proc/no/a", "view --rrd /proc/no.rrd",
    "run circle --rig emulated --trace /proc/no", "calibrate cams --out /proc/no",
    "calibrate touch --out /proc/no", "safety --out /proc/no",
    "trace no --out /proc/no", "trace no --log /proc/no", "emulate --write /proc/no",
    "export circle /proc/no.fmu", "export circle /proc/no.c", "bench verify no", "bench table no",
)  # fmt: skip


def test_help_lists_and_mistakes_need_no_numerical_library_whatever_the_command(tmp_path):
    ended, imported = modules(tmp_path, EVERY, *DONE, *MISTAKES)
    assert ended == len(DONE) * [0] + len(MISTAKES) * [2]
    assert not imported & HEAVY
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("unopened", ["safety --list", "emulate --bus no"])
def test_a_command_that_opens_no_bus_loads_no_python_can(tmp_path, unopened):
    """python-can loads asammdf where that is installed, which takes seconds."""
    _, imported = modules(tmp_path, COMMAND, *unopened.split())
    assert not imported & {"can", "canopen", "asammdf"}


def test_an_emulated_bus_on_a_port_of_its_own_needs_no_python_can(tmp_path):
    program = "from twin.emulator.virtual_bus import VirtualBus; VirtualBus([])"
    _, imported = modules(tmp_path, program)
    assert "can" not in imported


OFFERED = """
from click.shell_completion import BashComplete
from twin.cli import ballplate
shell = BashComplete(ballplate, {}, "ballplate", "_BALLPLATE_COMPLETE")
for command in sys.argv[1:]:
    shell.get_completions([command], "x")
"""


def test_offering_scenarios_and_runs_imports_nothing_heavy(tmp_path):
    commands = ("run", "compare", "report", "view", "sweep", "export")
    assert not modules(tmp_path, OFFERED, *commands)[1] & HEAVY


@pytest.mark.long
@pytest.mark.parametrize(
    ("run", "unused"),
    [
        (("sine", "--plant", "lagrange"), UNUSED | {"mujoco"}),
        (("circle",), UNUSED),
    ],
)
def test_a_run_imports_only_what_it_uses(tmp_path, run, unused):
    code, imported = modules(tmp_path, COMMAND, "run", *run, *SHORT, "--out", "made")
    assert code == 0
    assert (tmp_path / "made" / "picture.png").is_file()
    assert not imported & unused


@pytest.mark.long
@pytest.mark.parametrize(
    "module",
    [
        "twin.run.finished",
        "twin.run.loop",
        "controllers.analysis",
        "twin.study.work",
    ],
)
def test_what_runs_a_scenario_can_be_imported_without_what_it_uses_later(tmp_path, module):
    assert not modules(tmp_path, f"import {module}")[1] & (UNUSED | LATE)


@pytest.mark.parametrize(("given", "threads"), [(None, "1"), ("2", "2")])
def test_linear_algebra_has_one_thread_unless_more_are_asked_for(monkeypatch, given, threads):
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    if given is not None:
        monkeypatch.setenv("OPENBLAS_NUM_THREADS", given)
    monkeypatch.setattr("twin.cli._end_in_order", lambda: None)
    with pytest.raises(SystemExit):
        main(["--version"])
    assert os.environ["OPENBLAS_NUM_THREADS"] == threads


WRONG_ON_RIG = [
    ("run", "hold", "--rig", "emulated", "--fault", "3 unplugg"),
    ("run", "faulty.toml", "--rig", "emulated"),
]
"""Faults of the virtual rig with a misspelt name."""


@pytest.mark.short("words0")
@pytest.mark.parametrize("words", WRONG_ON_RIG)
def test_a_misspelt_fault_is_reported_before_anything_heavy(tmp_path, words):
    (tmp_path / "faulty.toml").write_text(
        'title = "f"\nduration = 5.0\n[controller]\nkind = "lqr"\n[reference]\nkind = "hold"\n'
        '[[fault]]\nat = 3.0\nname = "unplugg"\n',
        encoding="utf-8",
    )
    code, found = modules(tmp_path, COMMAND, *words)
    assert code == 2
    assert not found & (UNUSED | LATE | {"can", "asammdf"})


OWN_RIG = """
backend = "own.py:Rig"

[own]
encoders = false
"""
WITHOUT_CAN = [
    ("emulate", "--drive", "cia402", "--eds", "drive.eds"),
    ("calibrate", "cams", "--on", "tube"),
    ("calibrate", "touch", "--rig", "no.toml"),
    ("doctor", "--rig", "own.toml"),
]
"""Commands that open no CAN bus."""


@pytest.mark.parametrize("words", WITHOUT_CAN, ids=" ".join)
def test_a_command_without_a_bus_imports_no_python_can(tmp_path, words):
    (tmp_path / "own.toml").write_text(OWN_RIG, encoding="utf-8")
    (tmp_path / "own.py").write_text(
        "class Rig:\n    def __init__(self, **given):\n        raise OSError('not connected')\n"
    )
    _, found = modules(tmp_path, COMMAND, *words)
    assert not found & {"can", "asammdf"}
