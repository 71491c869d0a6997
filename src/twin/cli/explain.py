"""The command explain: which effect makes how much of a scenario's error."""

from __future__ import annotations

import os
from pathlib import Path

import click
from rich.table import Table

from twin.cli.options import JSON, SETTING, check_writable
from twin.cli.output import console, print_json, progress
from twin.explain.divide import Case, Explanation, plan, summary
from twin.explain.divide import explain as explain_scenario
from twin.explain.effects import EFFECTS, present, with_typical
from twin.explain.picture import draw
from twin.run.record import write_json
from twin.scenario import load

PROCESSES = min(2, os.cpu_count() or 1)


@click.command()
@click.argument("scenario")
@SETTING
@click.option(
    "--typical",
    is_flag=True,
    help="First give the effects that the scenario lacks the size a real rig may have.",
)
@click.option("--out", type=click.Path(path_type=Path), help="Folder [runs/explain-SCENARIO].")
@JSON
def explain(
    scenario: str, overrides: tuple[str, ...], out: Path | None, *, typical: bool, as_json: bool
) -> int:
    """Run a scenario with all effects, without each, and with each alone: who makes the error?"""
    chosen = load(scenario, overrides)
    if typical:
        chosen = with_typical(chosen)
    folder = out or Path("runs") / f"explain-{Path(scenario).stem}"
    check_writable(folder)
    runs = len({case.model_dump_json() for case in plan(chosen).values()})
    with progress(f"{runs} runs of {chosen.title}", runs) as advance:
        found = explain_scenario(chosen, advance, PROCESSES)
    numbers = summary(found)
    write_json(folder / "explain.json", numbers)
    draw(folder / "picture.png", found)
    if as_json:
        print_json(numbers)
    else:
        _show(found)
        console.print(f"written to {folder}/: picture.png, explain.json")
    return 0 if found.whole.rms is not None else 1


def _show(found: Explanation) -> None:
    percent = found.whole.percent is not None
    what = "tracking error e_tt [%]" if percent else "RMS distance [mm]"
    console.print(f"[bold]{found.scenario.title}[/bold]: {what}")
    table = Table(
        "effect", "all but this", "change", "this alone", "change", "share", header_style="bold"
    )
    for column in table.columns[1:]:
        column.justify = "right"

    def size(case: Case | None) -> float | None:
        if case is None:
            return None
        return case.percent if percent else None if case.rms is None else 1000 * case.rms

    def shown(case: Case, base: Case) -> tuple[str, str]:
        value, start = size(case), size(base)
        if value is None:
            return case.outcome.split(" at ", maxsplit=1)[0], "-"
        return f"{value:.2f}", "-" if start is None else f"{value - start:+.2f}"

    for part in found.parts:
        share = "-" if part.share is None else f"{100 * part.share:z.1f} %"
        less, alone = shown(part.without, found.whole), shown(part.alone, found.none)
        table.add_row(part.effect.label, *less, *alone, share)
    if found.rest is not None:
        table.add_row("effects on one another", "", "", "", "", f"{100 * found.rest:z.1f} %")
    if found.base is not None:
        table.add_row("left with none", "", "", "", "", f"{100 * found.base:z.1f} %")
    console.print(table)
    for label, case in (
        ("all effects", found.whole),
        ("none of them", found.none),
        ("none, on the exact equations", found.exact),
    ):
        if case is not None:
            value = size(case)
            console.print(f"{label}: {case.outcome if value is None else f'{value:.2f}'}")
    has = present(found.scenario)
    lacking = [effect.label for effect in EFFECTS if effect not in has]
    if lacking:
        console.print(f"not in this scenario: {', '.join(lacking)}")
