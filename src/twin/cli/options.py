"""Options that several commands have, among them which rig: real, emulated or simulated."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ballplate.hardware import EMULATED
from twin.cli import completion as tab
from twin.errors import ScenarioError
from twin.shipped import find

if TYPE_CHECKING:
    from twin.scenario import Scenario


def _each_once(_: click.Context, __: click.Parameter, values: tuple[str, ...]) -> tuple[str, ...]:
    """Refuse a key that is given twice: which of both is meant nobody knows."""
    keys = [text.partition("=")[0].strip() for text in values]
    if twice := [key for key in keys if keys.count(key) > 1]:
        raise ScenarioError(f"--set {twice[0]}: given {keys.count(twice[0])} times; give it once")
    return values


SETTING = click.option(
    "--set",
    "overrides",
    multiple=True,
    callback=_each_once,
    metavar="KEY=VALUE",
    help="Change a key of the scenario.",
    shell_complete=tab.settings,
)
PLANT = click.option(
    "--plant",
    type=click.Choice(["mujoco", "lagrange"]),
    help="Simulate the mechanism, or the exact equations.",
)
PROCESSES = click.option(
    "--processes", "-j", type=click.IntRange(min=1), help="Processors to use [all]."
)


VARY = click.option(
    "--vary",
    multiple=True,
    metavar="KEY=[A,B,...]",
    shell_complete=tab.settings,
    help="Run once for each value of a key; repeat the option for all combinations.",
)
SCHEDULER = click.option(
    "--scheduler", metavar="ADDRESS", help="Run on the workers of a Dask scheduler."
)


def _add_laws(_: click.Context, __: click.Parameter, laws: tuple[Path, ...]) -> None:
    if laws:
        from controllers.catalog import add

        for file in laws:
            try:
                add(file)
            except ValueError as error:
                raise ScenarioError(f"--law {error}") from None


LAW = click.option(
    "--law",
    multiple=True,
    type=click.Path(path_type=Path),
    expose_value=False,
    is_eager=True,
    callback=_add_laws,
    help="Take in the laws, observers and references of a Python file; those in laws/ always are.",
)
JSON = click.option("--json", "as_json", is_flag=True, help="Print JSON and nothing else.")

ALL = click.option("--all", "everything", is_flag=True, help="Print every indicator.")


def load_scenario(name: str, overrides: Sequence[str]) -> Scenario:
    """The scenario of a shipped name or a TOML file, with ``KEY=VALUE`` overrides.

    Raises:
        ScenarioError: If it does not exist, which is told before anything heavy is imported, or
            anything in it is unknown or out of range.
    """
    find(name)
    from twin.scenario import load

    return load(name, overrides)


def with_plant(overrides: tuple[str, ...], plant: str | None) -> tuple[str, ...]:
    """The overrides, and that of the option ``--plant``."""
    return (*overrides, f"plant.kind={plant}") if plant else overrides


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
