"""The command explain: how much of a scenario's error each effect causes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.markup import escape

from twin.cli import completion as tab
from twin.cli.options import JSON, LAW, PROCESSES, SETTING
from twin.cli.output import console, print_json, print_table, progress
from twin.shipped import find
from twin.writing import check_writable, write_json

if TYPE_CHECKING:
    from twin.explain.attribution import EffectCase, Explanation


@click.command()
@click.argument("scenario", shell_complete=tab.scenarios)
@LAW
@SETTING
@click.option(
    "--typical",
    is_flag=True,
    help="Add the effects that the scenario lacks, at the size a real rig may have.",
)
@click.option("--out", type=click.Path(path_type=Path), help="Folder [runs/explain-SCENARIO].")
@PROCESSES
@JSON
def explain(
    scenario: str,
    overrides: tuple[str, ...],
    out: Path | None,
    processes: int | None,
    *,
    typical: bool,
    as_json: bool,
) -> int:
    """Attribute the tracking error to effects: run with all, without each, and with each alone."""
    find(scenario)  # a wrong name is told before anything heavy is imported
    from twin.explain.attribution import explain as explain_scenario
    from twin.explain.attribution import plan, summary
    from twin.explain.effects import with_typical
    from twin.explain.plot import draw
    from twin.scenario import load
    from twin.scenario.load import titled

    chosen = titled(load(scenario, overrides), overrides)
    if typical:
        chosen = with_typical(chosen)
    folder = out or Path("runs") / f"explain-{Path(scenario).stem}"
    check_writable(folder)
    runs = len({case.model_dump_json() for case in plan(chosen).values()})
    with progress(f"{runs} runs of {chosen.title}", runs) as advance:
        found = explain_scenario(chosen, advance, processes)
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
    from twin.explain.effects import EFFECTS, present

    percent = found.whole.percent is not None
    what = "tracking error e_tt [%]" if percent else "RMS distance [mm]"
    console.print(f"[bold]{escape(found.scenario.title)}[/bold]: {what}")

    def size(case: EffectCase | None) -> float | None:
        if case is None:
            return None
        return case.percent if percent else None if case.rms is None else 1000 * case.rms

    def shown(case: EffectCase, base: EffectCase) -> tuple[str, str]:
        value, start = size(case), size(base)
        if value is None:
            return case.outcome.split(" at ", maxsplit=1)[0], "-"
        return f"{value:.2f}", "-" if start is None else f"{value - start:+.2f}"

    def percentage(share: float | None) -> str:
        return "-" if share is None else f"{100 * share:z.1f} %"

    rows = [
        (
            part.effect.label,
            *shown(part.without, found.whole),
            *shown(part.alone, found.none),
            percentage(part.share),
        )
        for part in found.contributions
    ]
    for label, share in (("effects on one another", found.rest), ("left with none", found.base)):
        if share is not None:
            rows.append((label, "", "", "", "", percentage(share)))
    heads = ("effect", "all but this", "change", "this alone", "change", "share")
    print_table(heads, rows, right=slice(1, None))
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
