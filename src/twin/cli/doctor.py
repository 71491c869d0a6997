"""The command doctor: the checks before a rig is brought up, line by line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from twin.cli.options import EMULATED, JSON, SETTING
from twin.cli.output import console, errors, print_json
from twin.doctor.check import CheckStatus
from twin.shipped import find

if TYPE_CHECKING:
    from twin.doctor.check import Ask, CheckResult
    from twin.scenario import Scenario
    from twin.scenario.rig import RigFile


COLOURS = {CheckStatus.PASS: "green", CheckStatus.WARN: "yellow", CheckStatus.FAIL: "bold red"}


@click.command()
@click.option(
    "--rig",
    metavar="FILE",
    default=EMULATED,
    help="Rig file [`emulated`, the virtual rig].",
)
@click.option("--scenario", default="circle", help="Scenario that the rig is to run [circle].")
@click.option("--move", is_flag=True, help="Enable the drives and tilt the plate by a degree.")
@click.option("--reset", is_flag=True, help="Reset faults found in the drives.")
@click.option("--udev", is_flag=True, help="Only print the udev rules for a touch panel on USB.")
@SETTING
@JSON
def doctor(
    rig: str,
    scenario: str,
    overrides: tuple[str, ...],
    *,
    move: bool,
    reset: bool,
    udev: bool,
    as_json: bool,
) -> int:
    """Check everything that a rig needs before it is brought up, and say what to do."""
    if udev:
        from twin.devices.lumio.transports import UDEV_RULES

        click.echo(UDEV_RULES.read_text(encoding="utf-8"), nl=False)
        return 0
    find(scenario)  # a wrong name is told before anything heavy is imported
    from twin.doctor.check import next_step
    from twin.doctor.examine import examine
    from twin.scenario import load

    chosen = load(scenario, overrides)
    found: list[CheckResult] = []
    with rig_file(rig, chosen) as (file, ask):
        for result in examine(chosen, file, ask, move=move, reset=reset):
            found.append(result)
            if not as_json:
                _print(result)
    counts = {status: sum(each.status is status for each in found) for status in CheckStatus}
    if as_json:
        print_json([each.as_dict() for each in found])
    else:
        console.print(", ".join(f"{count} {status}" for status, count in counts.items()))
        console.print(next_step(found, rig, move=move), markup=False, soft_wrap=True)
    return 1 if counts[CheckStatus.FAIL] else 0


def _print(result: CheckResult) -> None:
    colour = COLOURS[result.status]
    console.print(f"[{colour}]{result.status}[/{colour}]  {result.what}: ", end="")
    advice = f" -> {result.advice}" if result.advice else ""
    console.print(f"{result.seen}{advice}", markup=False, soft_wrap=True)


@contextmanager
def rig_file(name: str, scenario: Scenario) -> Iterator[tuple[RigFile, Ask]]:
    """The rig file, and who puts and lifts the ball."""
    from twin.emulator.process import emulated
    from twin.scenario.rig import check_rig, read_rig

    if name != EMULATED:
        yield read_rig(Path(name)), _ask
        return
    with emulated(scenario) as virtual:
        yield check_rig(virtual.tables, EMULATED), virtual.tell
        errors.print(virtual.lag(), style="dim", highlight=False)


def _ask(word: str) -> str:
    from twin.doctor.touch import EDGES

    if word == "edge":
        question = "which edges of the plate dipped, the short or the long ones?"
        answer: str = click.prompt(question, type=click.Choice(list(EDGES)), err=True)
        return answer
    if word == "watch":
        ready = "lift the ball off and watch the edges of the plate; Enter when you are ready"
        click.prompt(ready, default="", show_default=False, err=True)
        return ""
    click.echo(f"please {request(word)} now", err=True)
    return ""


def request(word: str) -> str:
    """What a person is asked to do, in words."""
    match word.split():
        case ["touch", x, y]:
            return f"touch the plate at x {float(x):+g}, y {float(y):+g} mm and hold"
        case ["put"]:
            return "put the ball on the plate"
    return "lift the ball or the finger off"
