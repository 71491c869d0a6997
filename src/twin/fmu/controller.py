"""The controller of a scenario as an FMU: around exactly the C source that ``export`` writes.

A communication step from a time t is one control period: it takes in what is measured at t, and its
outputs afterwards are the commands from t to the next period. The controller must therefore be
stepped before the rig; where both are stepped at once, each command is one period late.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from controllers.fmu import RATE_OUTPUTS
from twin.base.data_file import read_packaged
from twin.base.errors import TwinError
from twin.base.page import render_template
from twin.board.program import CONTROLLER_NAME
from twin.board.source import TEMPLATE_FOLDER, controller_parts, controller_sources
from twin.fmu.export import (
    FMI_SOURCES,
    MAX_REFERENCE_S,
    Variable,
    add_token,
    read_sources,
    reference_files,
    write_fmu,
)
from twin.run.controller_building import control_of
from twin.run.controller_source import reference_run
from twin.scenario.schema import Scenario

MODEL_SOURCES = ("model.h", "model.c")
"""The C source between the functions of FMI and the controller."""
MEASURED_COLUMNS = {
    **{each: f"measured_{each}" for each in ("x", "phi", "y", "theta")},
    "age": "age",
    "touched": "touched",
}
"""Columns of a reference run that are measured, and the inputs that they are."""
REFERENCE_ABOUT = "Measurements of a run and commands of the controller in Python"
"""Description of the reference."""


def export_fmu(
    path: Path,
    scenario: Scenario,
    *,
    fmi: int = 2,
    real: str = "double",
    reference_inputs: bool = False,
) -> str:
    """Write the controller of a scenario as an FMU for co-simulation.

    Args:
        path: The file.
        scenario: The scenario.
        fmi: Version of the standard, 2 or 3.
        real: Type of the controller's numbers, ``double`` or ``float``; variables are ``double``.
        reference_inputs: Whether the desired position and its derivatives are inputs, in place of
            the scenario's reference.

    Returns:
        Why there is no binary in it, in words; empty if there is one.

    Raises:
        TwinError: If the controller has no form in C, it plans ahead and is to have its reference
            as inputs, or the file cannot be written.
    """
    if fmi not in FMI_SOURCES:
        raise TwinError(f"fmi: must be 2 or 3, got {fmi}")
    parts = controller_parts(CONTROLLER_NAME, control_of(scenario), real)
    if reference_inputs and parts["plan"] is not None:
        raise TwinError(
            f"reference_inputs: '{parts['law']}' plans ahead along the scenario's reference"
        )
    variables = list_variables(scenario.rig.period, reference_inputs=reference_inputs)
    given = {"period": scenario.rig.period, "reference_inputs": reference_inputs}
    written = controller_sources(parts) | read_sources(*FMI_SOURCES[fmi])
    for name in MODEL_SOURCES:
        written[name] = render_template(TEMPLATE_FOLDER / f"{name}.j2", **given)
    return write_fmu(
        path,
        variables,
        *add_token(written, variables),
        reference(scenario, reference_inputs=reference_inputs),
        fmi=fmi,
        description=f"Controller of: {scenario.title}. Law {parts['law']}, observer "
        f"{parts['observer']}, {'Smith predictor' if parts['ring'] else 'no predictor'}.",
        independent=("Outputs", "InitialUnknowns"),
        step=scenario.rig.period,
        duration=scenario.duration,
    )


def list_variables(period: float, *, reference_inputs: bool = False) -> list[Variable]:
    """All variables of a controller with a period in s, in the order of their value references."""
    tables: dict[str, Any] = read_packaged("twin.fmu", "controller.toml")
    listed = [*tables["signal"], *tables["reference"] * reference_inputs]
    found = [Variable(**each) for each in listed]
    return [*found, *(Variable(start=period, **each) for each in tables["own"])]


def reference(scenario: Scenario, *, reference_inputs: bool) -> dict[str, str]:
    """Measurements of a run of the twin and the commands of Python, as files of an archive."""
    run = reference_run(scenario, min(scenario.duration, MAX_REFERENCE_S))
    time = scenario.rig.period * np.arange(len(run) + 1)
    columns = dict(MEASURED_COLUMNS)
    if reference_inputs:
        desired = [each for each in run.columns if each.startswith("desired_")]
        tables = read_packaged("twin.fmu", "controller.toml")
        columns |= dict(zip(desired, (each["name"] for each in tables["reference"]), strict=True))
    inputs = run[list(columns)].rename(columns=columns)
    inputs = pd.concat([inputs, inputs.iloc[-1:]], ignore_index=True)
    rates = list(RATE_OUTPUTS)
    outputs = pd.DataFrame(np.vstack([np.zeros((1, 2)), run[rates]]), columns=rates)
    for table in (inputs, outputs):
        table.insert(0, "time", time)
    return reference_files(inputs, outputs, REFERENCE_ABOUT)
