"""The options --rig and --reset: a real rig, or the emulated one, in place of the simulation."""

from __future__ import annotations

import click

from ballplate.hardware import EMULATED

__all__ = ["EMPTY_RIG", "EMULATED", "RESET", "RIG"]

RIG = click.option(
    "--rig",
    metavar="FILE",
    help="Rig file, or `emulated` for the virtual rig.",
)
EMPTY_RIG = click.option(
    "--rig",
    metavar="FILE",
    default=EMULATED,
    help="Rig file [`emulated`, the virtual rig]; ball off, plate level.",
)
RESET = click.option(
    "--reset", is_flag=True, help="With --rig: reset faults found in the drives when switching on."
)
