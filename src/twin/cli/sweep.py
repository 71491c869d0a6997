"""The command sweep: the tracking error over the values of a key, as table and curve."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from twin.cli import completion as tab
from twin.cli.options import JSON, LAW, PLANT, PROCESSES, SETTING, VARY, with_plant
from twin.cli.output import Terminal, print_json, print_table, say, warn
from twin.shipped import find

if TYPE_CHECKING:
    from ballplate.sweeping import Sweep


@click.command()
@click.argument("scenario", shell_complete=tab.scenarios)
@click.argument("values", metavar="KEY=FIRST:LAST:NUMBER", shell_complete=tab.settings)
@LAW
@SETTING
@PLANT
@VARY
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

    KEY=0:0.5:6 takes 6 values from 0 to 0.5, KEY=[1, 2, 5] those of the list. --vary gives a curve
    for each value of another key, as in controller.kind=[afl,lqr]. Of the runs the indicators are
    kept, in sweep.csv.
    """
    changed = with_plant(overrides, plant)
    find(scenario)  # a wrong name is told before anything heavy is imported
    from ballplate.sweeping import sweep as run_sweep
    from twin.run.files import run_folder
    from twin.scenario.variants import parsed, swept, varied

    (key, points), curves = swept(values), parsed(vary)
    named = (values.replace(":", ".."), *varied(curves), *changed)
    folder = out or run_folder(f"sweep-{Path(scenario).stem}", named)
    done = run_sweep(
        scenario,
        {key: points, **curves},
        settings=changed,
        out=folder,
        processes=processes,
        reporter=Terminal(),
    )
    if as_json:
        print_json({"title": done.title, "key": key, "values": points, "runs": done.curves})
    else:
        _show(done)
        _tell(done)
        say(f"written to {folder}/: sweep.png, sweep.csv", whole=True)
    return int(not done.finished)


def _tell(done: Sweep) -> None:
    """Why runs failed, each reason once."""
    for reason in dict.fromkeys(row["reason"] for row in done.rows if row["outcome"] == "failed"):
        warn(reason)
    if any(row["outcome"] == "not run" for row in done.rows):
        warn("interrupted: what had not ended is not in the table")


def _show(done: Sweep) -> None:
    from ballplate.sweeping import named
    from twin.page import digits
    from twin.report.numbers import FIRST, LABELS

    keys = [key for key in FIRST if any(each.get(key) is not None for each in done.rows)]
    curves = done.curves
    several = len(curves) > 1

    def cell(run: Mapping[str, Any], key: str) -> str:
        if run["outcome"] == "finished":
            return digits(run.get(key), LABELS[key][1])
        when = f" at {run['outcome_time']:.3g} s" if run["outcome_time"] else ""
        return f"{run['outcome']}{when}"

    chosen = keys[:1] if several else keys
    heads = curves if several else [f"{LABELS[key][0]} [{LABELS[key][1]}]" for key in keys]
    rows = (
        [named(value), *(cell(runs[at], key) for runs in curves.values() for key in chosen)]
        for at, value in enumerate(done.values)
    )
    say(done.title, style="bold")
    print_table((done.keys[0], *(heads if keys else ())), rows, right=slice(0, None))
    if several and keys:
        label, unit = LABELS[keys[0]]
        say(f"{label} in {unit}", style="dim")
