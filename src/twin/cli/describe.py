"""The command describe: what may be set, with type, unit, range, default and meaning."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

import click

from twin.cli import completion as tab
from twin.cli.options import JSON, LAW
from twin.cli.output import console, print_json

if TYPE_CHECKING:
    from twin.scenario.describe import Key

WORDS = {"laws": "controller", "observers": "observer", "references": "reference"}
"""What lists all of a kind, and the table of a scenario that names one."""


@click.command()
@click.argument(
    "name", metavar="[KEY|TABLE|KIND]", required=False, default="", shell_complete=tab.names
)
@LAW
@JSON
def describe(name: str, *, as_json: bool) -> int:
    """Describe what a scenario may set: a key, a table, or a law, observer or reference.

    A word is looked for in the names, then in what they mean. `laws`, `observers` and `references`
    list those there are, with one sentence each.
    """
    from twin.scenario.describe import about, described

    if name in WORDS:
        return _kinds(WORDS[name], as_json=as_json)
    found = described(name)
    if as_json:
        print_json([key.as_dict() for key in found])
        return 0
    if sentence := about(name):
        console.print(sentence, style="bold", markup=False)
    if not found:
        console.print("It has no settings.")
    for key in found:
        _print(key)
    if not name:
        console.print("Settings of a law, observer or reference: ballplate describe NAME")
    return 0


def _kinds(table: str, *, as_json: bool) -> int:
    """List the laws, observers or references with one sentence each."""
    from twin.scenario.describe import about
    from twin.scenario.schema import choices

    sentences = {kind: about(f"{table}.{kind}") for kind in choices(table)}
    if as_json:
        print_json(sentences)
        return 0
    for kind, sentence in sentences.items():
        console.print(f"{kind}: {sentence}", markup=False, soft_wrap=True)
    console.print(f"Settings of each: ballplate describe NAME; {table}.kind=NAME takes it")
    return 0


def _print(key: Key) -> None:
    unit = f" {key.unit}" if key.unit and not key.required and key.default is not None else ""
    of = f" ({key.unit})" if key.unit and not unit else ""
    only = "; plant.kind=mujoco only" if key.plants else ""
    console.print(f"{key.key} = {key.value}{unit}", style="bold", markup=False, soft_wrap=True)
    whose = f"{key.kind}: " if key.kind else ""
    facts = f"{whose}{key.type}{of}{f', {key.allowed}' if key.allowed else ''}{only}"
    for text in (key.meaning, f"[{facts}]"):
        for line in textwrap.wrap(text, max(console.width - 4, 40)):
            console.print(f"    {line}", markup=False, soft_wrap=True)
