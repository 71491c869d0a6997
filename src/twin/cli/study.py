"""The command study: many runs, and what they say about the parameters."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.filesize import decimal

from ballplate.studies import carried_out, work_of
from twin.cli import completion as tab
from twin.cli.options import JSON, LAW, PROCESSES, SCHEDULER
from twin.cli.output import Terminal, console, duration, errors, print_json, print_titles, say
from twin.jobs import cores
from twin.shipped import chosen, shipped_in, titles
from twin.writing import check_writable

if TYPE_CHECKING:
    from twin.study.answers import Answer
    from twin.study.schema import Study
    from twin.study.work import Work


BYTES = 800
"""Size of a run on disk, generously: its row in a chunk, and in rows.parquet and rows.csv."""


@click.command()
@click.argument("study", required=False, shell_complete=tab.studies)
@click.option("--samples", type=click.IntRange(min=2), help="Override the study's samples.")
@click.option("--seeds", type=click.IntRange(min=1), help="Override the study's seeds.")
@click.option("--plan", is_flag=True, help="Print the number, time and size of the runs; run none.")
@PROCESSES
@SCHEDULER
@click.option("--out", type=click.Path(path_type=Path), help="Folder [runs/study-NAME].")
@LAW
@JSON
def study(
    study: str | None,
    samples: int | None,
    seeds: int | None,
    processes: int | None,
    scheduler: str | None,
    out: Path | None,
    *,
    plan: bool,
    as_json: bool,
) -> int:
    """Run a study: a shipped one by name, or a TOML file; without a name, list them.

    Finished runs are kept: an interrupted study continues where it stopped, a finished one answers
    at once, a changed one runs only what changed.
    """
    known = shipped_in("studies")
    if study is None:
        print_titles(titles(known), as_json=as_json)
        return 0
    chosen("study", study, known)  # a wrong name is told before anything heavy is imported
    with errors.status(f"{study}: checking every run ..."):
        work = work_of(study, {"samples": samples, "seeds": seeds})
    folder = out or Path("runs") / f"study-{Path(study).stem}"
    if plan:
        check_writable(folder)
        return _plan(work, folder, processes, scheduler, as_json=as_json)
    done = carried_out(
        work, out=folder, processes=processes, scheduler=scheduler, reporter=Terminal()
    )
    from twin.study.report import endings

    about, found = work.study, done.answers
    if as_json:
        print_json(_numbers(about, found))
    else:
        _show(about, found)
        say(*endings(work, done.rows))
        console.print(f"written to {folder}/: report.html, figures/, rows.parquet, rows.csv")
    return 0


def _plan(
    work: Work, folder: Path, processes: int | None, scheduler: str | None, *, as_json: bool
) -> int:
    from twin.study.cluster import Cluster
    from twin.study.experiments import Store, remaining, seconds

    with nullcontext() if scheduler is None else Cluster(scheduler) as cluster:
        processes = processes or (cluster.workers if cluster else cores())
    store = Store(folder)
    known, chunks = remaining(work.tasks, store, processes)
    total = work.different
    left = total - known.num_rows
    each = seconds(work.jobs(chunks[0])) if chunks else 0.0
    if as_json:
        counts = {"runs": total, "finished": known.num_rows, "left": left, "batches": len(chunks)}
        cost = {"processes": processes, "duration": left * each / processes, "size": left * BYTES}
        print_json({**counts, **cost, "units": {"duration": "s", "size": "byte"}})
        return 0
    if not chunks:
        console.print(f"{total} runs, all of them finished")
        return 0
    console.print(
        f"{total} runs, {known.num_rows} of them finished; {left} left in {len(chunks)} "
        f"batches take about {duration(left * each / processes)} on {processes} processors "
        f"({each:.2f} s per run, measured here on one) and {decimal(left * BYTES)} on disk"
    )
    return 0


def _numbers(about: Study, found: list[Answer]) -> dict[str, object]:
    from twin.study.report import sentences

    def number(value: float) -> float | None:
        return value if value == value else None  # noqa: PLR0124

    return {
        "study": about.title,
        "metric": about.metrics[0],
        "variants": {
            answer.variant: {
                "median": number(answer.whole.median),
                "low": number(answer.whole.low),
                "high": number(answer.whole.high),
                "runs": answer.whole.runs,
                "failed": answer.whole.failed,
                "chance_to_fail": answer.whole.chance,
                "indices": {
                    index.key: {
                        "value": number(index.value) if index.decided else None,
                        "half_width": number(index.half),
                        "decided": index.decided,
                    }
                    for index in answer.indices
                },
                "slopes": [
                    {"parameter": curve.key, "where": curve.where, "slope": curve.slope}
                    for curve in answer.curves
                ],
                "notes": answer.notes,
            }
            for answer in found
        },
        "answer": sentences(about, found),
    }


def _show(about: Study, found: list[Answer]) -> None:
    from rich.markup import escape

    from twin.page import terminal
    from twin.study.report import compared, grids, sentences

    console.print(f"[bold]{escape(about.title)}[/bold]: {about.metrics[0]}")
    for table in (*grids(about, found), compared(about, found)):
        say(table.title)
        console.print(terminal(table))
    say(*sentences(about, found))
