"""The command tune: fields of a controller over a family of rigs, with a certificate."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from twin.cli.options import JSON, LAW, PROCESSES, SCHEDULER, SETTING
from twin.cli.output import (
    console,
    duration,
    print_json,
    print_table,
    print_titles,
    progress,
    say,
)
from twin.shipped import chosen, shipped_in, titles
from twin.writing import check_writable

if TYPE_CHECKING:
    from twin.tune.schema import Tune
    from twin.tune.trials import Trials
    from twin.tune.tune import TuneResult


@click.command()
@click.argument("tune", required=False)
@SETTING
@click.option("--candidates", type=click.IntRange(min=2), help="Override the tune's candidates.")
@click.option("--certificate", type=click.IntRange(min=1), help="Override its fresh rigs.")
@click.option("--plan", is_flag=True, help="Print the number and time of the runs; run none.")
@PROCESSES
@SCHEDULER
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
    known = shipped_in("tunes")
    if tune is None:
        print_titles(titles(known), as_json=as_json)
        return 0
    chosen("tune", tune, known)  # a wrong name is told before anything heavy is imported
    from twin.tune.schema import read

    about = read(tune, candidates=candidates, certificate=certificate, set=overrides)
    from twin.study.experiments import Store, executors
    from twin.tune.report import sentences, write
    from twin.tune.search import library
    from twin.tune.trials import Trials
    from twin.tune.tune import tuned

    library()
    folder = out or Path("runs") / f"tune-{Path(tune).stem}"
    check_writable(folder)
    store = Store(folder)
    with executors(processes, scheduler) as (executor, count):
        trials = Trials(about, store, executor=executor, processes=count)
        if plan:
            _plan(about, trials, count, as_json=as_json)
            return 0
        with progress(about.title, 1.0) as advance:
            found = tuned(trials, advance)
    write(trials, found, folder)
    if as_json:
        print_json(found.as_dict())
        return int(not found.good)
    _show(found)
    say(*sentences(found))
    console.print(f"written to {folder}/: report.html, tune.json, tuned.toml")
    console.print(f"try: ballplate run circle --set parameters={folder / 'tuned.toml'}")
    return int(not found.good)


def _plan(about: Tune, trials: Trials, processes: int, *, as_json: bool) -> None:
    from twin.tune.tune import planned_runs

    search, verdict, fresh = planned_runs(about)
    seconds = trials.seconds(search, verdict + fresh) / processes
    if as_json:
        counts = {"search": search, "verdict": verdict, "certificate": fresh}
        cost = {"processes": processes, "duration": seconds, "units": {"duration": "s"}}
        print_json({**counts, **cost})
        return
    console.print(
        f"about {search} runs of the search ({about.candidates} candidates on "
        f"{', '.join(map(str, about.rigs))} rigs in {len(about.tasks)} tasks), "
        f"{verdict} of the verdict and {fresh} of the certificate take about "
        f"{duration(seconds)} on {processes} processors (measured here on one)"
    )


def _show(found: TuneResult) -> None:
    from twin.tune.report import fields_table, task_table

    print_table(("field", "searched", "before", "after", "unit"), fields_table(found))
    head = ("task", "", "judged by", "median", "90 %", "largest", "cost 1 at", "finished", "effort")
    print_table(head, task_table(found))
