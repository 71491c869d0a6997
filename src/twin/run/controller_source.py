"""The controller of a scenario as a folder of C source, with a reference run of the twin."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd

from controllers.arrays import Array
from twin.base.errors import RecordError
from twin.base.writing import write_whole
from twin.board.source import sources
from twin.run.assemble import assemble, control_of, own_errors
from twin.scenario.schema import Scenario

NAME_PATTERN = re.compile(r"[a-z][a-z0-9_]{0,40}")
"""Names of the C file without its ending, which begin the names in C."""
RESERVED_NAMES = frozenset({
    "auto", "break", "case", "char", "const", "continue", "default", "do", "double", "else",
    "enum", "extern", "float", "for", "goto", "if", "inline", "int", "long", "register",
    "restrict", "return", "short", "signed", "sizeof", "static", "struct", "switch", "typedef",
    "union", "unsigned", "void", "volatile", "while", "math", "stdio", "stdlib",
})  # fmt: skip
"""Keywords of C99, and headers that the sources include."""


def export(file: Path, scenario: Scenario, *, real: str = "double") -> Path:
    """Write the controller of a scenario as C99 source into a folder.

    Args:
        file: Name of the C file, ``FOLDER/NAME.c``; the folder ``FOLDER/NAME`` is written.
        scenario: The scenario; its run is the reference run.
        real: Type of numbers, ``double`` or ``float``.

    Returns:
        The folder.

    Raises:
        TwinError: If the name is no name in C, the controller has no form in C, or the folder
            cannot be written.
    """
    name = file.stem
    if not NAME_PATTERN.fullmatch(name) or name in RESERVED_NAMES:
        raise RecordError(f"{file}: names in C begin with the name: a-z, 0-9 and _, no keyword")
    texts = sources(name, control_of(scenario), real)
    run = reference_run(scenario, scenario.duration)
    texts["reference_run.csv"] = run.to_csv(index=False, lineterminator="\n")
    folder = file.with_suffix("")
    for each, text in texts.items():
        write_whole(folder / each, text)
    return folder


RUN_COLUMNS = (
    *("x", "phi", "y", "theta", "age", "touched"),
    *(f"desired_{axis}_{order}" for order in range(5) for axis in "xy"),
    *("rate_phi", "rate_theta"),
)
"""Columns of a reference run: measurement, reference and its derivatives, commanded plate rates."""


def reference_run(scenario: Scenario, duration: float) -> pd.DataFrame:
    """A run of the twin under the scenario's own controller: ``RUN_COLUMNS``, SI, a row a period.

    Args:
        scenario: The scenario.
        duration: Longest time in s.
    """
    rig, controller = assemble(scenario, unseen=True)
    rows = list[Array]()
    with own_errors(), rig:
        measured = rig.read()
        # the board knows no plate angle before its first measurement
        rig.supervisor.angle = measured.y[:, 1::2].copy()
        controller.start(measured)
        rig.start()
        for _ in range(round(duration / rig.period)):
            step = controller.command(measured)
            applied = rig.write(step.rate)
            controller.applied(applied)
            desired = controller.reference(measured.time)
            rows.append(
                np.concatenate(
                    [measured.y[0], measured.age, measured.touched, desired.ravel(), applied[0]]
                )
            )
            rig.wait()
            measured = rig.read()
            if not rig.supervisor.all_running:
                break
    return pd.DataFrame(rows, columns=RUN_COLUMNS)
