"""The commands of ``ballplate bench``: a law on the public benchmark, and entries verified."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from twin.cli.options import JSON, PATH, PROCESSES, Command, Group
from twin.cli.output import progress, show
from twin.errors import RecordError
from twin.page import Table

if TYPE_CHECKING:
    from twin.bench import BenchScore

HEADS = ("task", "error", "95 % interval", "worst tenth", "balls kept", "95 % interval", "effort")
NOTE = (
    "error: beside that of the reference law on the same rig and noise, interquartile mean; "
    "effort: median of the RMS plate acceleration, rad/s^2"
)


@click.group(cls=Group, example="bench run my_law.py --out entry")
def bench() -> None:
    """The public benchmark: the same tasks on the same 128 rigs for every law."""


@bench.command("list", cls=Command, example="bench list")
@JSON
def list_laws() -> int:
    """List the laws of this project, which are the first entries."""
    from twin.bench import Benchmark

    laws = {name: law.title for name, law in Benchmark().about.laws.items()}
    show(laws, [Table("", ("law", "title"), list(laws.items()), words=(0, 1))])
    return 0


@bench.command(cls=Command, example="bench run my_law.py --out entry")
@click.argument("entry")
@click.option("--out", type=PATH, help="Folder of the entry [runs/bench-ENTRY].")
@PROCESSES
@JSON
def run(entry: str, out: Path | None, processes: int | None) -> int:
    """Run an entry: a law's file, a folder with an entry.toml, or a law of ``bench list``.

    Code of an entry runs in a process of its own that sees measurements and nothing else. Finished
    runs are kept: an interrupted command goes on where it was.
    """
    from twin.bench import Benchmark
    from twin.study.experiments import Store
    from twin.writing import check_writable

    benchmark = Benchmark()
    name, about, place = benchmark.entry(entry)
    folder = check_writable(out or Path("runs") / f"bench-{name}")
    count = len(benchmark.points) * benchmark.about.seeds * len(benchmark.about.tasks)
    with progress(about.title, count, "runs") as advance:
        rows = benchmark.carried_out(
            about,
            place,
            Store(folder),
            processes=processes,
            progress=lambda done, lost: advance(done, f"{lost} not finished"),
        )
    found = benchmark.write(folder, about, place, rows)
    files = "entry.toml, runs.parquet, scores.json, commands.npz"
    show([each._asdict() for each in found], [_table(about.title, found)], folder, files)
    return 0


@bench.command(cls=Command, example="bench verify entry")
@click.argument("entry", required=False, type=PATH)
@JSON
def verify(entry: Path | None) -> int:
    """Verify an entry: its scores, and its commands replayed; none of its code is run.

    Without one the benchmark itself: its files, and errors of its laws on the first rigs. Exit code
    1 where anything differs.
    """
    from twin.bench import Benchmark

    benchmark = Benchmark()
    wrong = list(benchmark.differences() if entry is None else benchmark.replayed(entry))
    what = "the benchmark" if entry is None else str(entry)
    show(wrong, wrong or [f"{what}: as it was frozen" if entry is None else f"{what}: as told"])
    return 1 if wrong else 0


@bench.command(cls=Command, example="bench table runs/bench-lqr runs/bench-afl")
@click.argument("entries", nargs=-1, required=True, type=PATH)
@JSON
def table(entries: Sequence[Path]) -> int:
    """Put finished entries side by side: the relative error of each in each task."""
    found = {str(each): _scores(each) for each in entries}
    tasks = [each["task"] for each in next(iter(found.values()))]
    cells = [
        (name, *(f"{each['error']:.3g} ({each['kept']} kept)" for each in its))
        for name, its in found.items()
    ]
    show(found, [Table("", ("entry", *tasks), cells, words=(0,))])
    return 0


def _scores(folder: Path) -> list[dict[str, Any]]:
    try:
        found: list[dict[str, Any]] = json.loads((folder / "scores.json").read_bytes())["scores"]
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise RecordError(f"{folder}: holds no finished entry: {error}") from error
    return found


def _table(title: str, scores: Sequence[BenchScore]) -> Table:
    def cells() -> Iterator[tuple[str, ...]]:
        for each in scores:
            yield (
                each.task,
                f"{each.error:.3f}",
                f"{each.low:.3f} to {each.high:.3f}",
                f"{each.worst:.3f}",
                str(each.kept),
                f"{100 * each.kept_low:.1f} to {100 * each.kept_high:.1f} %",
                f"{each.effort:.2f}",
            )

    return Table(title, HEADS, list(cells()), words=(0,), note=NOTE)
