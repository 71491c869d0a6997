"""What needs no rig runs where there is no POSIX: its modules are imported where they are used."""

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

for command in COMMANDS if sys.argv[1:] == ["all"] else [sys.argv[1:]]:
    try:
        main([command, "--help"] if isinstance(command, str) else command)
    except SystemExit as ended:
        assert not ended.code, command
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
SHORT = ("run", "hold", "--plant", "lagrange", "--set", "duration=0.2", "--set", "metrics.start=0")


@pytest.fixture
def call(tmp_path):
    """Runs a command where the modules of POSIX are missing; what it printed."""

    def run(*arguments):
        done = subprocess.run(
            [sys.executable, "-c", HIDDEN, *arguments],
            cwd=tmp_path, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


def test_the_scenarios_are_listed_without_posix(call):
    assert "circle" in call("list")


def test_a_run_and_its_report_are_made_without_posix(call, tmp_path):
    call(*SHORT)
    assert (tmp_path / "runs" / "hold" / "run.parquet").is_file()
    call("report", "runs/hold")
    assert (tmp_path / "runs" / "hold" / "report.html").is_file()


def test_a_study_is_planned_without_posix(call, tmp_path):
    (tmp_path / "short.toml").write_text(STUDY)
    assert "2 runs" in call("study", "short.toml", "--plan")


def test_every_command_explains_itself_without_posix(call):
    assert call("all").count("Usage: ") == len(COMMANDS)


def test_the_hidden_modules_are_missed_where_they_are_used(tmp_path):
    code = HIDDEN.partition("from twin")[0] + "import fcntl"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "ModuleNotFoundError" in done.stderr
