"""The commands study and tune: many runs, and how they are evaluated."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ballplate.studies import StudyResult, screened_work_of
from ballplate.studies import study as run_study
from twin.base.errors import plural
from twin.base.page import Table, Text
from twin.base.shipped import chosen, shipped_in
from twin.base.writing import check_writable
from twin.cli import options
from twin.cli.output import TERMINAL, bold, print_shipped, progress, show

if TYPE_CHECKING:
    from twin.study.answers import Answer
    from twin.study.schema import Study
    from twin.study.screen import Screen
    from twin.study.work import Work


@options.command(example="study friction --plan", reads="--plan")
@click.argument("study", required=False, shell_complete=options.studies)
@click.option("--samples", type=click.IntRange(min=2), help="Override the study's samples.")
@click.option("--seeds", type=click.IntRange(min=1), help="Override the study's seeds.")
@click.option(
    "--engine", type=click.Choice(("python", "c")), help="Simulate in Python or in compiled C."
)
@click.option("--plan", is_flag=True, help="Print the number of the runs; run none.")
@click.option(
    "--screen",
    type=click.IntRange(2, 1000),
    help="So many times as many further points on the exact equations; the ends on the mechanism.",
)
@options.PROCESSES_OPTION
@options.SCHEDULER_OPTION
@click.option("--out", type=options.PATH_TYPE, help="Folder [runs/study-NAME].")
@options.LAW_OPTION
@options.JSON_OPTION
def study(
    study: str | None, out: Path | None, *, plan: bool, screen: int | None, **how: Any
) -> int:
    """Run a study: a shipped one by name, or a TOML file; without a name, list them.

    Finished runs are kept: an interrupted study continues where it stopped, a finished one answers
    at once, a changed one runs only what changed.
    """
    if study is None:
        return print_shipped("studies")
    chosen("study", study, shipped_in("studies"))  # reported before anything heavy is imported
    folder = out or Path("runs") / f"study-{Path(study).stem}"
    if plan:
        keys = {key: how.pop(key) for key in ("samples", "seeds", "engine")}
        work, more = screened_work_of(study, keys, screen, TERMINAL)
        check_writable(folder)
        return _plan_study(work, folder, more, **how)
    done = run_study(study, out=folder, reporter=TERMINAL, screen=screen, **how)
    from twin.study.report import (
        compare_pairs,
        compare_variants,
        drawn_figures,
        endings,
        grids,
    )

    about, found = done.work.study, done.answers
    early = endings(done.work, done.rows)
    shown = (
        bold(f"{done.title}: {about.metrics[0]}"),
        *grids(about, found),
        compare_variants(about, found),
        *compare_pairs(about, found),
        *done.sentences,
        *early,
        *(_describe_screen(done) if done.screened else ()),
    )
    drawn = "figures/, " if drawn_figures(about, found) else ""
    files = f"report.html, {drawn}rows.parquet, rows.csv"
    numbers = _numbers(about, found) | {"endings": early}
    if done.screened:
        from twin.study.screen_report import numbers_of

        numbers["screen"] = numbers_of(done.screened)
        files += ", screened.csv"
    show(numbers, shown, folder, files)
    return 0


def _describe_screen(done: StudyResult) -> Iterator[object]:
    """What the screen of a study found, to print."""
    from twin.study.screen_report import blocks

    if not done.screened:
        return
    for block in blocks(done.work.study, done.screened):
        if isinstance(block, Text):
            yield bold(block.title)
            yield from block.lines
        else:
            yield block


def _plan_study(work: Work, folder: Path, screen: Screen | None, **how: Any) -> int:
    from twin.study.experiments import Store, executors, remaining

    works = [work] if screen is None else [work, screen.paired, screen.wide]
    with executors(**how) as (_, count):
        known, chunks = remaining(
            [task for each in works for task in each.tasks], Store(folder), count
        )
    total = sum(each.different for each in works)
    left = total - known.num_rows
    batches = plural(len(chunks), "batch", "batches")
    summary_line = (
        f"{plural(total, 'run')}, {left} of them left in {batches} on {plural(count, 'processor')}"
    )
    counts = {"runs": total, "finished": known.num_rows, "left": left, "batches": len(chunks)}
    if screen is not None:
        counts["checked_at_most"] = screen.most_checked
        summary_line += (
            f"; {total - work.different} of the runs are on the exact equations, and up to "
            f"{screen.most_checked} more on the mechanism"
        )
    show(counts | {"processes": count}, [summary_line])
    return 0


SUMMARY_COLUMNS = ("median", "low", "high", "runs", "failed")
"""Columns of the summary of all runs of a variant."""


def _numbers(about: Study, found: list[Answer]) -> dict[str, object]:
    from controllers.analysis import number
    from twin.study.report import sentences

    return {
        "study": about.title,
        "metric": about.metrics[0],
        "variants": {
            answer.variant: {
                **{name: number(getattr(answer.whole, name)) for name in SUMMARY_COLUMNS},
                "chance_to_fail": answer.whole.chance,
                "indices": {
                    index.key: {
                        "value": number(index.value) if index.decided or index.negligible else None,
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


@options.command(example="tune afl --candidates 16")
@click.argument("tune", required=False)
@options.SETTING
@click.option("--candidates", type=click.IntRange(min=2), help="Override the tune's candidates.")
@click.option("--certificate", type=click.IntRange(min=1), help="Override its fresh rigs.")
@options.PROCESSES_OPTION
@options.SCHEDULER_OPTION
@click.option("--out", type=options.PATH_TYPE, help="Folder [runs/tune-NAME].")
@options.LAW_OPTION
@options.JSON_OPTION
def tune(tune: str | None, overrides: tuple[str, ...], out: Path | None, **how: Any) -> int:
    """Tune fields of a controller over a family of rigs: a shipped tune by name, or a TOML file.

    Without a name, list the shipped ones. The search is on one draw of the family, the certificate
    on fresh rigs of a second one. Finished runs are kept: an interrupted tune continues where it
    stopped. Writes report.html, tune.json and tuned.toml, which `--set parameters=FILE` lays over
    any scenario; exit code 1 if a constraint is not kept or a fresh rig is lost.
    """
    if tune is None:
        return print_shipped("tunes")
    chosen("tune", tune, shipped_in("tunes"))  # reported before anything heavy is imported
    from twin.tune.trials import read

    budget = {key: how.pop(key) for key in ("candidates", "certificate")}
    about = read(tune, set=overrides, **budget)
    from twin.study.experiments import Store, executors
    from twin.tune.report import (
        FIELD_HEADINGS,
        TASK_HEADINGS,
        fields_table,
        sentences,
        task_table,
        write,
    )
    from twin.tune.search import carry_out_tune, library
    from twin.tune.trials import Trials

    library()
    folder = check_writable(out or Path("runs") / f"tune-{Path(tune).stem}")
    store = Store(folder)
    with executors(**how) as (executor, count):
        trials = Trials(about, store, executor=executor, processes=count)
        with progress(about.title, 1.0) as advance:
            found = carry_out_tune(trials, advance)
    write(trials, found, folder)
    tasks = (*TASK_HEADINGS[:-1], "effort")  # its unit would make the table wider than a terminal
    shown = (
        Table("", FIELD_HEADINGS, fields_table(found), words=range(len(FIELD_HEADINGS))),
        Table("", tasks, task_table(found), words=range(len(tasks))),
        *sentences(found),
    )
    then = f"try: ballplate run circle --set parameters={folder / 'tuned.toml'}"
    files = f"report.html, tune.json, tuned.toml; {then}"
    show(found.as_dict(), shown, folder, files)
    return int(not found.good)
