"""The command doctor: what a rig's bring-up needs, line by line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from twin.cli.options import JSON, SETTING
from twin.cli.output import console, print_json
from twin.cli.rigs import EMULATED
from twin.doctor.examine import examine
from twin.doctor.finding import Ask, Finding, Verdict
from twin.emulator.serve import emulated
from twin.scenario import Scenario, load
from twin.scenario.rig import RigFile, check_rig, read_rig

COLOURS = {Verdict.PASS: "green", Verdict.WARN: "yellow", Verdict.FAIL: "bold red"}


@click.command()
@click.option("--rig", metavar="FILE", default=EMULATED, help="Rig file, or emulated [emulated].")
@click.option("--scenario", default="circle", help="What the rig is to run [circle].")
@click.option(
    "--move", is_flag=True, help="Let the drives have torque and the plate tilt by a degree."
)
@click.option("--reset", is_flag=True, help="Reset faults found in the drives.")
@SETTING
@JSON
def doctor(
    rig: str,
    scenario: str,
    overrides: tuple[str, ...],
    *,
    move: bool,
    reset: bool,
    as_json: bool,
) -> int:
    """Find and check everything that a rig's bring-up needs, and say what to do."""
    chosen = load(scenario, overrides)
    found: list[Finding] = []
    with rig_file(rig, chosen) as (file, ask):
        for finding in examine(chosen, file, ask, move=move, reset=reset):
            found.append(finding)
            if not as_json:
                _print(finding)
    counts = {verdict: sum(each.verdict is verdict for each in found) for verdict in Verdict}
    if as_json:
        print_json([{**each._asdict(), "verdict": str(each.verdict)} for each in found])
    else:
        console.print(", ".join(f"{count} {verdict}" for verdict, count in counts.items()))
    return 1 if counts[Verdict.FAIL] else 0


def _print(finding: Finding) -> None:
    colour = COLOURS[finding.verdict]
    console.print(f"[{colour}]{finding.verdict}[/{colour}]  {finding.what}: ", end="")
    advice = f" -> {finding.advice}" if finding.advice else ""
    console.print(f"{finding.seen}{advice}", markup=False, soft_wrap=True)


@contextmanager
def rig_file(name: str, scenario: Scenario) -> Iterator[tuple[RigFile, Ask]]:
    """The rig file, and who puts and lifts the ball."""
    if name != EMULATED:
        yield read_rig(Path(name)), _ask
        return
    with emulated(scenario) as virtual:
        yield check_rig(virtual.tables, EMULATED), lambda word: _tell(virtual.tell(word))


def _ask(word: str) -> None:
    words = {"put": "put the ball on the plate", "lift": "lift the ball off"}
    click.echo(f"please {words[word]} now", err=True)


def _tell(_: str) -> None:
    """The emulated rig has done it."""
