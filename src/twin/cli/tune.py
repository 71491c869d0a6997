"""The command tune: fields of a controller over a family of rigs, with a certificate."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import click

from twin.cli.options import JSON, LAW, PROCESSES, SETTING
from twin.cli.output import console, duration, print_json, progress
from twin.writable import check_writable

if TYPE_CHECKING:
    from twin.tune.tune import TuneResult


@click.command()
@click.argument("tune", required=False)
@SETTING
@click.option("--candidates", type=click.IntRange(min=2), help="Override the tune's candidates.")
@click.option("--certificate", type=click.IntRange(min=1), help="Override its fresh rigs.")
@click.option("--plan", is_flag=True, help="Print the number and time of the runs; run none.")
@PROCESSES
@click.option("--scheduler", metavar="ADDRESS", help="Run on the workers of a Dask scheduler.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder [runs/tune-NAME].")
@LAW
@JSON
def tune(
    tune: str | None,
    overrides: tuple[str, ...],
    candidates: int | None,
    certificate: int | None,
    processes: int | None,
    scheduler: str | None,
    out: Path | None,
    *,
    plan: bool,
    as_json: bool,
) -> int:
    """Tune fields of a controller over a family of rigs: a shipped tune by name, or a TOML file.

    Without a name, list the shipped ones. The search is on one draw of the family, the certificate
    on fresh rigs of another. Finished runs are kept: an interrupted tune continues where it
    stopped. Writes report.html, tune.json and tuned.toml, which `--set parameters=FILE` lays over
    any scenario; exit code 1 if a constraint is not kept or a fresh rig is lost.
    """
    from twin.tune.schema import read

    if tune is None:
        return _list(as_json=as_json)
    about = read(tune, candidates=candidates, certificate=certificate, set=overrides)
    from twin.fit.workers import workers
    from twin.jobs import cores
    from twin.study.cluster import Cluster
    from twin.study.store import Store
    from twin.tune.report import sentences, write
    from twin.tune.search import library
    from twin.tune.trials import Trials
    from twin.tune.tune import planned_runs, tuned

    library()
    folder = out or Path("runs") / f"tune-{Path(tune).stem}"
    check_writable(folder)
    store = Store(folder)
    with ExitStack() as stack:
        if plan:
            executor, processes = None, processes or cores()
        elif scheduler is None:
            processes = processes or cores()
            executor = stack.enter_context(workers(processes))
        else:
            executor = cluster = stack.enter_context(Cluster(scheduler))
            processes = processes or cluster.workers
        trials = Trials(about, store, executor=executor, processes=processes)
        if plan:
            search, verdict, fresh = planned_runs(about)
            seconds = trials.seconds(search, verdict + fresh) / processes
            console.print(
                f"about {search} runs of the search ({about.candidates} candidates on "
                f"{', '.join(map(str, about.rigs))} rigs in {len(about.tasks)} tasks), "
                f"{verdict} of the verdict and {fresh} of the certificate take about "
                f"{duration(seconds)} on {processes} processors (measured here on one)"
            )
            return 0
        with progress(about.title, 1.0) as advance:
            found = tuned(trials, advance)
    write(trials, found, folder)
    if as_json:
        print_json(found.as_dict())
        return int(not found.good)
    _show(found)
    for line in sentences(found):
        console.print(line, markup=False)
    console.print(f"written to {folder}/: report.html, tune.json, tuned.toml")
    console.print(f"try: ballplate run circle --set parameters={folder / 'tuned.toml'}")
    return int(not found.good)


def _list(*, as_json: bool) -> int:
    from twin.tune.schema import read, shipped

    found = {name: read(name).title for name in shipped()}
    if as_json:
        print_json(found)
        return 0
    width = max(map(len, found), default=0)
    for name, title in found.items():
        console.print(f"[bold]{name:<{width}}[/bold]  {title}")
    return 0


def _show(found: TuneResult) -> None:
    from rich.table import Table

    from twin.tune.report import fields_table, task_table

    shown = Table("field", "searched", "before", "after", "unit")
    for row in fields_table(found):
        shown.add_row(*row)
    console.print(shown)
    head = ("task", "", "judged by", "median", "90 %", "largest", "cost 1 at", "finished", "effort")
    shown = Table(*head)
    for row in task_table(found):
        shown.add_row(*row)
    console.print(shown)
