"""Controllers in C, compiled and run on this computer."""

import shutil
import subprocess

import pytest

from ballplate.changes import changes_of, scenario_of

COMPILER = shutil.which("gcc")
WARNINGS = ("-std=c99", "-O2", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Werror")


def scenario(**changes):
    """A circle on the exact equations, with noise, with changes by keys with ``__`` for dots."""
    keys = {"plant.kind": "lagrange", "reference.kind": "circle", "reference.amplitude": 0.1}
    keys |= {key.replace("__", "."): value for key, value in changes.items()}
    return scenario_of("hold", changes_of(keys, {}))


def compiled(folder, *flags):
    """The C files of a folder as a program; its path."""
    if COMPILER is None:
        pytest.skip("gcc is not installed")
    program = folder / "program"
    command = [COMPILER, *WARNINGS, *flags, "-o", program, *folder.glob("*.c"), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert not done.returncode, done.stderr
    return program


def replayed(program):
    """Whether the replay of the reference run passes, and the largest difference in rad/s."""
    done = subprocess.run(
        [program], cwd=program.parent, capture_output=True, text=True, check=False
    )
    assert done.returncode in {0, 1}, done.stderr or done.returncode
    return not done.returncode, float(done.stdout.split("largest difference ")[1].split()[0])
