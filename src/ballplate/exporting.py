"""The rig of a scenario for the tools of others: an FMU."""

from __future__ import annotations

from pathlib import Path
from typing import Unpack

from ballplate.changes import Changes, Settings, changes_of, scenario_of
from ballplate.reporter import Reporter, default
from twin.errors import RecordError
from twin.shipped import find

EXACT = {"plant.kind": "lagrange"}
QUIET = {
    f"{key}.variance": [0, 0] for key in ("sensors.touch", "sensors.encoders", "disturbance")
} | {"sensors.touch.dead_time_spread": 0}
"""Without any noise; a vibration that is random is left out, too."""


def fmu(
    scenario: str | Path,
    file: str | Path,
    settings: Settings = (),
    *,
    fmi: int = 2,
    wished: bool = False,
    reporter: Reporter | None = None,
    **changes: Unpack[Changes],
) -> Path:
    """Write the rig of a scenario as an FMU for co-simulation: C source, and a binary for Linux.

    The rig is the exact equations with rolling friction, drives, touch screen, encoders and limits;
    the mechanism is not in it. ``ballplate export circle rig.fmu`` does the same.

    Args:
        scenario: A shipped scenario, one of ``scenarios()``, or a TOML file.
        file: The file, its ending ``.fmu``.
        settings: What is changed of it, by dotted keys or as texts ``KEY=VALUE``.
        fmi: Version of the standard, 2 for FMI 2.0 or 3 for FMI 3.0.
        wished: Whether the scenario's reference is an output, too, with two derivatives.
        reporter: Who is told why there is no binary in it.
        changes: What is changed of it, by tables: ``plant={"friction": {"rolling_mm": 0}}``.

    Returns:
        The file.

    Raises:
        TwinError: If there is no such scenario, the exact equations cannot follow it, or the file
            cannot be written.
    """
    path = Path(file)
    if path.suffix != ".fmu":
        raise RecordError(f"{path}: an FMU's file must end in .fmu")
    find(str(scenario))
    said = [*changes_of(settings, changes), *changes_of(EXACT, {})]
    chosen = scenario_of(scenario, said)
    still = QUIET | ({"plant.servo.vibration": 0} if chosen.plant.servo.vibration_wander else {})
    quiet = scenario_of(scenario, [*said, *changes_of(still, {})])
    from twin.fmu.export import export

    if lacking := export(path, chosen, quiet, fmi=fmi, wished=wished):
        (reporter or default()).warn(f"{path}: source only, without a binary: {lacking}")
    return path
