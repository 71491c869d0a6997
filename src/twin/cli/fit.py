"""The command fit: parameters from a table of measured indicators."""

from __future__ import annotations

from pathlib import Path

import click

from twin.cli.options import JSON, PROCESSES, SCHEDULER
from twin.cli.output import console, print_json, print_table, print_titles, progress, say
from twin.shipped import chosen, shipped_in, titles
from twin.writing import check_writable


@click.command()
@click.argument("table", required=False)
@click.option("--no-leave-out", is_flag=True, help="Do not fit again without each group.")
@PROCESSES
@SCHEDULER
@click.option("--out", type=click.Path(path_type=Path), help="Folder [runs/fit-NAME].")
@JSON
def fit(
    table: str | None,
    processes: int | None,
    scheduler: str | None,
    out: Path | None,
    *,
    no_leave_out: bool,
    as_json: bool,
) -> int:
    """Fit parameters to measured indicators of many experiments, where no logs were kept.

    TABLE is a shipped name, without one those are listed, or a TOML file: scenarios with what was
    measured and how certain that is, and the parameters to find, with their ranges. Finished runs
    are kept: an interrupted fit continues where it stopped. Writes report.html and fit.json; exit
    code 1 if no parameter is seen.
    """
    known = shipped_in("fits")
    if table is None:
        print_titles(titles(known), as_json=as_json)
        return 0
    chosen("table", table, known)  # a wrong name is told before anything heavy is imported
    from twin.fit.fit import fit as fit_table
    from twin.fit.report import row, sentences, write
    from twin.fit.runs import Runs
    from twin.fit.schema import read
    from twin.study.experiments import Store, executors

    about = read(table)
    folder = out or Path("runs") / f"fit-{Path(table).stem}"
    check_writable(folder)
    store = Store(folder)
    with executors(processes, scheduler) as (executor, count):
        runs = Runs(about, store, executor=executor, processes=count)
        with progress(about.title, 1.0) as advance:
            found = fit_table(about, runs, leave_out=not no_leave_out, advance=advance)
    write(found, folder)
    if as_json:
        print_json(found.as_dict())
    else:
        heads = ("parameter", "value", "95 %", "without one group", "unit", "verdict")
        print_table(heads, map(row, found.estimates))
        say(sentences(found)[0], *sentences(found)[len(found.estimates) + 1 :])
        console.print(f"written to {folder}/: report.html, fit.json")
    return int(all(each.verdict != "seen" for each in found.estimates))
