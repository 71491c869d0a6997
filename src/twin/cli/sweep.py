"""The command sweep: the tracking error over the values of a key, as table and curve."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from twin.cli.one_run import with_plant
from twin.cli.options import JSON, LAW, PLANT, PROCESSES, SETTING, check_writable, load_scenario
from twin.cli.output import console, print_json, progress
from twin.jobs import cores

if TYPE_CHECKING:
    from twin.run.sweep import Sweep


@click.command()
@click.argument("scenario")
@click.argument("values", metavar="KEY=FIRST:LAST:NUMBER")
@LAW
@SETTING
@PLANT
@click.option(
    "--vary",
    multiple=True,
    metavar="KEY=[A,B,...]",
    help="A curve for each value of another key, as in controller.kind=[afl,lqr].",
)
@click.option("--out", type=click.Path(path_type=Path), help="Folder [runs/sweep-...].")
@PROCESSES
@JSON
def sweep(
    scenario: str,
    values: str,
    overrides: tuple[str, ...],
    plant: str | None,
    vary: tuple[str, ...],
    out: Path | None,
    processes: int | None,
    *,
    as_json: bool,
) -> int:
    """Run a scenario over the values of a key: a table and a curve.

    KEY=0:0.5:6 takes 6 values from 0 to 0.5, KEY=[1, 2, 5] those of the list. Of the runs the
    indicators are kept, in sweep.csv.
    """
    changed = with_plant(overrides, plant)
    first = load_scenario(scenario, changed)
    from twin.run.folders import run_folder
    from twin.run.record import write_whole
    from twin.run.sweep import Sweep, as_csv, draw, summaries, swept
    from twin.scenario.load import check, read, resolved, setting
    from twin.scenario.variants import comparison, variants, varied

    key, points = swept(values)
    curves = variants(vary)
    base = [setting(text) for text in changed]
    cases = [
        (
            (curve.heading, at),
            check(*resolved(*read(scenario), [*base, *curve.settings, (key, point)])),
        )
        for curve in curves
        for at, point in enumerate(points)
    ]
    named = (values.replace(":", ".."), *varied(vary), *changed)
    folder = out or run_folder(f"sweep-{Path(scenario).stem}", named)
    check_writable(folder)
    title = comparison(first.title, (values, *vary), changed)
    found = {}
    with progress("sweep", len(cases), "runs") as advance:
        for name, summary in summaries(cases, min(processes or cores(), len(cases))):
            found[name] = summary
            advance(len(found))
    runs = {
        curve.heading: [found[curve.heading, at] for at in range(len(points))] for curve in curves
    }
    done = Sweep(title=title, key=key, values=tuple(points), runs=runs)
    draw(folder / "sweep.png", done)
    table = as_csv(done)
    write_whole(folder / "sweep.csv", lambda file: file.write_text(table, encoding="utf-8"))
    if as_json:
        print_json({"title": title, "key": key, "values": points, "runs": runs})
    else:
        _show(done)
        console.print(f"written to {folder}/: sweep.png, sweep.csv", markup=False, soft_wrap=True)
    return int(any(each["outcome"] != "finished" for each in found.values()))


def _show(done: Sweep) -> None:
    from rich.markup import escape
    from rich.table import Table

    from twin.report.numbers import FIRST, LABELS, shown
    from twin.run.sweep import named

    every = [each for runs in done.runs.values() for each in runs]
    keys = [key for key in FIRST if any(each.get(key) is not None for each in every)]
    console.print(done.title, style="bold", markup=False)
    several = len(done.runs) > 1
    table = Table(header_style="bold")
    table.add_column(escape(done.key), justify="right", overflow="fold")
    for curve in done.runs:
        for key in keys[:1] if several else keys:
            label, unit = LABELS[key]
            heading = curve if several else f"{label} [{unit}]"
            table.add_column(escape(heading), justify="right", overflow="fold")
    for at, value in enumerate(done.values):
        cells = []
        for runs in done.runs.values():
            for key in keys[:1] if several else keys:
                each = runs[at]
                early = each["outcome"] != "finished"
                words = f"{each['outcome']} at {each['outcome_time']:.3g} s"
                cells.append(words if early else shown(each.get(key), LABELS[key][1]))
        table.add_row(escape(named(value)), *cells)
    console.print(table)
    if several and keys:
        label, unit = LABELS[keys[0]]
        console.print(f"{label} in {unit}", style="dim", markup=False)
