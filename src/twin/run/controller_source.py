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
from twin.run.assemble import assemble
from twin.run.controller_building import control_of, own_errors
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
            cannot be written or holds anything else.
    """
    name = file.stem
    if not NAME_PATTERN.fullmatch(name) or name in RESERVED_NAMES:
        raise RecordError(f"{file}: names in C begin with the name: a-z, 0-9 and _, no keyword")
    _check_own(file)
    texts = sources(name, control_of(scenario), real)
    run = reference_run(scenario, scenario.duration)
    texts["reference_run.csv"] = run.to_csv(index=False, lineterminator="\n")
    folder = file.with_suffix("")
    for each, text in texts.items():
        write_whole(folder / each, text)
    return folder


def _check_own(file: Path) -> None:
    """Make sure that the folder of a C file is empty, or of an earlier export of this name.

    Raises:
        RecordError: If it holds anything else.
    """
    folder = file.with_suffix("")
    try:
        foreign = folder.exists() and (not folder.is_dir() or any(folder.iterdir()))
        source = folder / file.name
        if foreign and source.is_file():
            foreign = EXPORT_MARK not in source.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise RecordError(f"{folder}: cannot be read: {error.strerror or error}") from error
    if foreign:
        raise RecordError(
            f"{folder}: is no folder of an earlier export; give {file.name} another name or place"
        )


EXPORT_MARK = "Written by `ballplate export`"
"""Text in each C file of an export."""
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
