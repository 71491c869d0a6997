"""Controllers in C, compiled and run on this computer."""

import shutil
import subprocess

import pytest

from ballplate.changes import changes_of, scenario_of

COMPILER = shutil.which("gcc")
WARNINGS = ("-std=c99", "-O2", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Werror")


def scenario(reference="circle", **changes):
    """Hold, or follow a reference, on the exact equations with noise; keys with ``__`` for dots."""
    keys = {"plant.kind": "lagrange", "reference.kind": reference}
    keys |= {"reference.amplitude": 0.1} if reference == "circle" else {}
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


def replayed(program, what="periods, "):
    """Whether the replay of the reference run passes, and the largest difference of the commands.

    In rad/s; with ``"reference: "`` that of the reference.
    """
    done = subprocess.run(
        [program], cwd=program.parent, capture_output=True, text=True, check=False
    )
    assert done.returncode in {0, 1}, done.stderr or done.returncode
    after = done.stdout.split(f"{what}largest difference ")[1]
    return not done.returncode, float(after.split()[0])


LIMITS = {
    "rig__limits__angle_deg": 0.6,
    "rig__limits__rate_deg": 1.5,
    "rig__limits__acceleration": 0.5,
    "plant__start__x": 0.06,
    "plant__start__y": -0.08,
}
"""Limits so narrow that a start off the centre meets each of them."""
SCREEN = {
    "predictor__kind": "smith",
    "predictor__delay": 0.0413,
    "sensors__touch__lost": 0.02,
    "sensors__touch__frame_rate": 133.0,
    "sensors__touch__hidden": [0.0535, -0.2, 0.0545, 0.2],
}
"""A screen with frames, one of 50 lost, and a blind strip, behind a predictor with a dead time that
is no multiple of the period."""
