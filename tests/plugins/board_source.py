"""Controllers in C, compiled and run on this computer."""

import re
import shutil
import subprocess

import numpy as np
import pandas as pd
import pytest

from ballplate.changes import changes_of, scenario_of
from controllers.controller import Controller
from controllers.interfaces import Measurement
from twin.hal.supervisor import Event, Supervisor
from twin.run.controller_building import control_of

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


STORED = re.compile(r"^( +)(const real \w+|[\w>-]+\[.+?\]) (\+?)= ([^{].*);$", re.MULTILINE)
"""An assignment to a named number or to an element of an array."""


MAX_ROUNDINGS = {"luenberger": 5.0, "nonlinear_luenberger": 5.0, "kalman": 20.0, "ekf": 5.0}
"""Largest difference in ``float`` by observer, as a multiple of ``single_roundings``.

No bound was derived. The factors are about twice the largest that was measured in 25 s: 2.8, and 11
of ``feedforward`` with ``kalman``, a drift that grows to the end of the run.
"""


def single_roundings(folder):
    """Largest difference in rad/s that single precision alone makes in the replay of a folder.

    The ``float`` source, changed to calculate in ``double``, with its constants and measurements
    in ``float`` and each assigned number rounded to ``float``. Only the roundings within a
    statement are left out.
    """
    changed = folder.with_name(f"{folder.name}-rounded")
    shutil.copytree(folder, changed, ignore=shutil.ignore_patterns("program"))

    def rounded(match):
        indent, name, add, value = match.groups()
        return f"{indent}{name} = (real)(float)({f'{name} + ' if add else ''}{value});"

    def edit(file, function):
        text = (changed / file).read_text("utf-8")
        edited = function(text)
        assert edited != text
        (changed / file).write_text(edited, "utf-8")

    def of_source(text):
        text = re.sub(r"\b(pow|sqrt|sin|cos|tan|asin|fabs|exp)f\(", r"\1(", text)
        constants, functions = re.split(r"(?=^static void )", text, maxsplit=1, flags=re.MULTILINE)
        before, step, after = functions.partition("void plate_step(")
        end = after.index("\n}\n")  # what follows is the reference, which the replay reads instead
        return constants + STORED.sub(rounded, before + step + after[:end]) + after[end:]

    edit("plate.h", lambda text: text.replace("typedef float", "typedef double"))
    edit("plate.c", of_source)
    edit("test_plate.c", lambda text: text.replace("(plate_real)v[", "(plate_real)(float)v["))
    return replayed(compiled(changed))[1]


LIMITS = {
    "rig__limits__angle_deg": 0.6,
    "rig__limits__rate_deg": 1.5,
    "rig__limits__acceleration": 0.5,
    "plant__start__x": 0.06,
    "plant__start__y": -0.08,
}
"""Limits so narrow that a start off the centre meets each of them."""
FRAMES = {
    "predictor__delay": 0.0413,
    "sensors__touch__lost": 0.02,
    "sensors__touch__frame_rate": 133.0,
    "sensors__touch__hidden": [0.0535, -0.2, 0.0545, 0.2],
}
"""A screen with frames, one of 50 lost, and a blind strip; its dead time is no multiple of the
period."""
SCREEN = {"predictor__kind": "smith"} | FRAMES
"""The same behind a predictor."""


def remeasured(folder, chosen, change):
    """Change what was measured in the reference run of a folder, and command it in Python again.

    Args:
        folder: The exported folder.
        chosen: Its scenario.
        change: Changes the measurements, a frame with a row a period, in place. An angle that is
            not measured, NaN, is in Python the one that was commanded, and at first level.
    """
    file = folder / "reference_run.csv"
    run = pd.read_csv(file)
    change(run)
    parts = control_of(chosen)
    controller = Controller(parts.law, parts.observer, parts.reference, parts.period)
    supervisor = Supervisor(parts.limits, parts.period)
    y = run[["x", "phi", "y", "theta"]].to_numpy()[:, None]
    for event in (Event.INITIALISE, Event.POWERED, Event.START):
        supervisor.handle(event)
    supervisor.angle = np.nan_to_num(y[0][:, 1::2])
    for k, (given, age, touched) in enumerate(zip(y, run.age, run.touched, strict=True)):
        felt, seen = np.array([touched > 0]), given.copy()
        seen[:, 1::2] = np.where(np.isnan(seen[:, 1::2]), supervisor.angle, seen[:, 1::2])
        measured = Measurement(k * parts.period, seen, np.array([age]), felt)
        if not k:
            controller.start(measured)
        supervisor.watch(seen, felt)
        rate = supervisor.clamp(controller.command(measured).rate)
        controller.applied(rate)
        run.loc[k, ["rate_phi", "rate_theta"]] = rate[0]
    assert supervisor.all_running, supervisor.reason
    run.to_csv(file, index=False, na_rep="nan")
