"""What the commands print: tables for people, JSON for programs, progress for waiting."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from time import monotonic
from typing import Any

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from twin.report.numbers import LABELS as INDICATORS
from twin.report.numbers import shown

LABELS = {**INDICATORS, "real_time_factor": ("faster than real time", "×")}
"""Indicator to the words and the unit it is printed with."""

LINE_EVERY = 10.0
"""Seconds between two lines of progress where there is no terminal."""

console = Console(highlight=False, width=None if sys.stdout.isatty() else 140)
errors = Console(stderr=True, highlight=False)


def print_json(content: Mapping[str, Any] | Sequence[Any]) -> None:
    """One JSON value on standard output, nothing else."""
    click.echo(json.dumps(content, indent=2, allow_nan=False))


def warn(message: str) -> None:
    """One line on standard error about something that is allowed but not wise."""
    click.echo(f"ballplate: warning: {message}", err=True)


def print_metrics(runs: Mapping[str, Mapping[str, Any]]) -> None:
    """A table of indicators, one column a run; indicators that apply to none are left out."""
    table = Table("", *runs, "unit", header_style="bold")
    for column in table.columns[1:-1]:
        column.justify = "right"
    for key, (label, unit) in LABELS.items():
        values = [summary.get(key) for summary in runs.values()]
        if any(value is not None for value in values):
            table.add_row(label, *(shown(value, unit) for value in values), unit)
    console.print(table)
    for label, summary in runs.items():
        if summary.get("reason"):
            console.print(
                f"{label}: {summary['outcome']} at {summary['outcome_time']:.3f} s: "
                f"{summary['reason']}"
            )


@contextmanager
def progress(what: str, total: float) -> Iterator[Callable[[float], None]]:
    """A bar on a terminal's standard error; elsewhere a line at the begin and now and then."""
    if not errors.is_terminal:
        click.echo(f"{what} ...", err=True)
        yield _lines(what, total)
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=errors, transient=True) as bar:
        task = bar.add_task(what, total=total)
        yield lambda done: bar.update(task, completed=done)


def _lines(what: str, total: float) -> Callable[[float], None]:
    """Progress as plain lines, none sooner than ``LINE_EVERY`` after the last."""
    last = monotonic()

    def tell(done: float) -> None:
        nonlocal last
        if monotonic() - last > LINE_EVERY:
            click.echo(f"{what}: {min(done / total, 1):.0%}", err=True)
            last = monotonic()

    return tell
