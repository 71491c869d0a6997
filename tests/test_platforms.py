"""`twin`.

What needs no rig runs where there is no POSIX: its modules are imported where they are used."""

import subprocess
import sys

import pytest

from twin.cli import COMMANDS

HIDDEN = """
import os, sys

import can, psutil, serial  # these choose by themselves what they import on which system

for name in ("fcntl", "termios", "pty", "tty", "resource", "pwd", "grp"):
    sys.modules[name] = None
for name in [name for name in vars(os) if name.startswith("sched_")]:
    delattr(os, name)

from twin.cli import COMMANDS, main

for number, line in enumerate(sys.argv[1:]):
    for command in COMMANDS if line == "all" else [line]:
        try:
            main([command, "--help"] if line == "all" else command.split())
        except SystemExit as ended:
            assert not ended.code, command
    print("\\f", flush=True)
"""
STUDY = """
title = "short"
scenario = "hold"
set = ["plant.kind=lagrange", "duration=0.1", "metrics.start=0"]
method = "grid"
metrics = ["rms_error"]

[parameters."plant.friction.rolling_mm"]
values = [0.1, 0.2]
"""
CALLS = {
    "list": "list",
    "run": "run hold --plant lagrange --set duration=0.2 --set metrics.start=0 --out runs/hold",
    "report": "report runs/hold",
    "plan": "study short.toml --plan",
    "help": "all",
}


@pytest.mark.long
def test_without_posix_scenarios_are_listed_runs_reported_studies_planned_and_commands_told(
    tmp_path,
):
    (tmp_path / "short.toml").write_text(STUDY)
    # one process for all
    done = subprocess.run(
        [sys.executable, "-c", HIDDEN, *CALLS.values()],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    printed = dict(zip(CALLS, done.stdout.split("\f"), strict=False))
    assert "circle" in printed["list"]
    for name in ("run.parquet", "report.html"):
        assert (tmp_path / "runs" / "hold" / name).is_file()
    assert "2 runs" in printed["plan"]
    assert printed["help"].count("Usage: ") == len(COMMANDS)


@pytest.mark.long
def test_the_hidden_modules_are_missed_where_they_are_used():
    code = HIDDEN.partition("from twin")[0] + "import fcntl"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "ModuleNotFoundError" in done.stderr
