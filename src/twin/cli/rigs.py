"""The option --rig: a real rig, or the emulated one, in place of the simulation."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from twin.cli.output import errors
from twin.devices.rig import HardwareRig
from twin.errors import ScenarioError
from twin.scenario import Scenario

RIG = click.option(
    "--rig",
    metavar="FILE",
    help="Run on the rig that a TOML file describes, or on 'emulated': a virtual one on the wire.",
)
RESET = click.option(
    "--reset", is_flag=True, help="With --rig: reset faults found in the drives when switching on."
)
EMULATED = "emulated"


@contextmanager
def chosen(rig: str | None, scenario: Scenario, *, reset: bool) -> Iterator[HardwareRig | None]:
    """The rig that was asked for, not switched on; None for the simulation.

    Raises:
        TwinError: If there is no such rig, or its file is wrong.
    """
    if rig is None:
        if reset:
            raise ScenarioError("--reset: a simulated rig has no faults to reset; it needs --rig")
        yield None
        return
    from twin.run.connect import connect  # noqa: PLC0415  loaded when asked for
    from twin.scenario.rig import check_rig, read_rig  # noqa: PLC0415

    if scenario.sensors.ideal:
        raise ScenarioError("--rig: no rig measures its full state; set sensors.ideal=false")
    if rig != EMULATED:
        yield connect(scenario, read_rig(Path(rig)), reset=reset)
        return
    from twin.emulator.serve import emulated  # noqa: PLC0415  loaded when asked for

    with emulated(scenario) as virtual:
        yield connect(scenario, check_rig(virtual.tables, EMULATED), reset=reset)


def tell(rig: HardwareRig) -> None:
    """Say how the real-time loop fared."""
    for line in (*rig.scheduling, *rig.clock.ledger.text()):
        errors.print(line, style="dim", highlight=False)
    for time, note in rig.journal:
        severity = note.condition.severity
        errors.print(f"{time:.3f} s {severity}: {note.text}", highlight=False, markup=False)
