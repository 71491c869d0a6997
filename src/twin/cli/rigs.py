"""The option --rig: a real rig, or the emulated one, in place of the simulation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from twin.cli.output import errors
from twin.errors import ScenarioError

if TYPE_CHECKING:
    from twin.devices.rig import HardwareRig
    from twin.scenario import Scenario

RIG = click.option(
    "--rig",
    metavar="FILE",
    help="Rig file, or `emulated` for the virtual rig.",
)
RESET = click.option(
    "--reset", is_flag=True, help="With --rig: reset faults found in the drives when switching on."
)
EMULATED = "emulated"


SIMULATION_ONLY = ("plant.", "sensors.", "disturbance.", "rig.cams", "rig.cam_")
"""Beginnings of the keys that describe a simulated rig and mean nothing to a real one."""


@contextmanager
def chosen(
    rig: str | None, scenario: Scenario, overrides: Sequence[str] = (), *, reset: bool
) -> Iterator[HardwareRig | None]:
    """The requested rig, not switched on; None for the simulation.

    Args:
        rig: Rig file, ``emulated`` or None.
        scenario: What is to run on it.
        overrides: What the command changes of the scenario.
        reset: Whether faults found in the drives are reset.

    Raises:
        TwinError: If there is no such rig, or its file is wrong.
    """
    if rig is None:
        if reset:
            raise ScenarioError("--reset: a simulated rig has no faults to reset; it needs --rig")
        yield None
        return
    from twin.run.connect import connect
    from twin.scenario.rig import check_rig, read_rig

    if scenario.sensors.ideal:
        raise ScenarioError("--rig: no rig measures its full state; set sensors.ideal=false")
    if rig != EMULATED:
        if scenario.change:
            raise ScenarioError(
                f"--rig {rig}: [[change]] changes a simulated rig, never a real one; leave it out"
            )
        for text in overrides:
            key = text.partition("=")[0].strip()
            if key.startswith(SIMULATION_ONLY):
                raise ScenarioError(
                    f"--rig {rig}: {key} describes a simulated rig and changes nothing of a real "
                    "one; leave it out, or set what the rig has in its file"
                )
        yield connect(scenario, read_rig(Path(rig)), reset=reset)
        return
    from twin.emulator.changes import follow_changes
    from twin.emulator.serve import emulated
    from twin.run.plants import build_plant

    # what a virtual rig knows of its cams is part of its scenario
    known = build_plant([scenario])[1]
    with emulated(scenario) as virtual:
        tables = check_rig(virtual.tables, EMULATED)
        host = connect(scenario, tables, reset=reset, transmission=known)
        follow_changes(host, scenario, known, virtual.begin)
        yield host
        errors.print(virtual.tell("lag"), style="dim", highlight=False)


def print_timing(rig: HardwareRig) -> None:
    """Print the timing of the real-time loop, and the conditions that were detected."""
    for line in (*rig.scheduling, *rig.clock.timing.text()):
        errors.print(line, style="dim", highlight=False)
    for time, note in rig.journal:
        severity = note.condition.severity
        errors.print(f"{time:.3f} s {severity}: {note.text}", highlight=False, markup=False)
