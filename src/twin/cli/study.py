"""The command study: many runs, and what they say about the parameters."""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from pathlib import Path

import click
from rich.table import Table

from twin.cli.output import console, errors, print_json, progress
from twin.cli.scenarios import JSON, check_writable
from twin.errors import ScenarioError
from twin.study.answers import Answer, answers
from twin.study.carry import carry, missing
from twin.study.report import compared, sentences, write
from twin.study.schema import Study, read
from twin.study.store import Store
from twin.study.work import Task, carry_out, tasks

BYTES = 350
"""Measured size of a run in a chunk's file."""


@click.command()
@click.argument("study")
@click.option("--samples", type=click.IntRange(min=2), help="In place of the study's own.")
@click.option("--seeds", type=click.IntRange(min=1), help="In place of the study's own.")
@click.option("--plan", is_flag=True, help="Say how many runs, how long, how much; run only one.")
@click.option("--processes", type=click.IntRange(min=1), help="Processors to use [all].")
@click.option("--scheduler", metavar="ADDRESS", help="Run on the workers of a Dask scheduler.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder [runs/study-NAME].")
@JSON
def study(
    study: str,
    samples: int | None,
    seeds: int | None,
    processes: int | None,
    scheduler: str | None,
    out: Path | None,
    *,
    plan: bool,
    as_json: bool,
) -> int:
    """Carry out a study: a shipped one by name, or a TOML file.

    What is finished is kept: an interrupted study goes on where it stopped, a finished one answers
    at once, a changed one runs only what changed.
    """
    about = read(study)
    update = {"samples": samples, "seeds": seeds}
    about = about.model_copy(update={k: v for k, v in update.items() if v is not None})
    wanted = tasks(about)
    folder = out or Path("runs") / f"study-{Path(study).stem}"
    check_writable(folder)
    store = Store(folder)
    if plan:
        return _plan(wanted, store, processes)
    with _executor(scheduler) as executor, progress(about.title, len(wanted)) as advance:
        failed = 0

        def tell(done: int, bad: int) -> None:
            nonlocal failed
            if bad > failed:
                failed = bad
                errors.print(f"{bad} of {done} runs so far did not end well", style="dim")
            advance(done)

        rows = carry(wanted, store, executor=executor, processes=processes, progress=tell)
    found = answers(about, wanted, rows)
    write(about, wanted, rows, found, folder)
    if as_json:
        print_json(_numbers(about, found))
    else:
        _show(about, found)
        console.print(f"written to {folder}/: report.html, figures/, rows.parquet, rows.csv")
    return 0


def _plan(wanted: list[Task], store: Store, processes: int | None) -> int:
    left = sum(map(len, missing(wanted, store.rows())))
    begin = time.perf_counter()
    if left:
        carry_out(wanted[:1])
    each = time.perf_counter() - begin
    count = processes or 2
    console.print(
        f"{len(wanted)} runs, {len(wanted) - left} of them finished; {left} left take about "
        f"{left * each / count / 60:.1f} min on {count} processors ({each:.1f} s a run, measured "
        f"now) and {left * BYTES / 1e6:.2f} MB on disk"
    )
    return 0


@contextmanager
def _executor(scheduler: str | None) -> Iterator[Executor | None]:
    """The workers of a Dask scheduler, or nothing."""
    if scheduler is None:
        yield None
        return
    try:
        from distributed import Client  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise ScenarioError(
            "--scheduler: needs the extra cluster: pip install 'ballplate[cluster]'"
        ) from error
    try:
        client = Client(scheduler, timeout=5)
    except (OSError, ValueError) as error:
        raise ScenarioError(f"--scheduler {scheduler}: nobody answers there") from error
    with client:
        yield client.get_executor(pure=False, retries=2)


def _numbers(about: Study, found: list[Answer]) -> dict[str, object]:
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
                        "value": number(index.value),
                        "half_width": number(index.half),
                        "decided": index.decided,
                    }
                    for index in answer.indices
                },
                "slopes": {curve.key: curve.slope for curve in answer.curves},
                "notes": answer.notes,
            }
            for answer in found
        },
        "answer": sentences(about, found),
    }


def _show(about: Study, found: list[Answer]) -> None:
    console.print(f"[bold]{about.title}[/bold]: {about.metrics[0]}")
    table = Table("variant", "median", "5 %", "95 %", "runs", "failed", "chance to fail")
    for answer in found:
        table.add_row(*compared(answer))
    console.print(table)
    for sentence in sentences(about, found):
        console.print(sentence, markup=False)
