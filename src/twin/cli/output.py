"""What the commands print: tables for people, JSON for programs, progress for waiting."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

import click
from rich.console import Console
from rich.markup import escape

from ballplate.reporter import Advance, Reporter
from twin.report.numbers import IndicatorRow, all_rows, first_rows

if TYPE_CHECKING:
    from ballplate.running import Attach
    from twin.cli.options import Viewing
    from twin.scenario import Scenario


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


def print_titles(titles: Mapping[str, str], *, as_json: bool) -> None:
    """What there is to run, name to title, one line each."""
    if as_json:
        print_json(titles)
        return
    width = max(map(len, titles), default=0)
    for name, title in titles.items():
        console.print(f"[bold]{name:<{width}}[/bold]  {title}")


def print_metrics(runs: Mapping[str, Mapping[str, Any]], *, everything: bool = False) -> None:
    """A table of indicators, one column per run; indicators that apply to none are left out.

    Where the columns do not fit side by side, each run has a line, or, of every indicator, the
    columns stand in several tables.

    Args:
        runs: Heading to summary.
        everything: Whether to print every indicator, or those that are asked for first.
    """
    headings, summaries = list(runs), list(runs.values())
    if everything:
        most = _fitting(headings, all_rows(summaries))
        for some in range(0, len(headings), most):
            part = slice(some, some + most)
            _print_columns(headings[part], all_rows(summaries[part]))
    else:
        rows = first_rows(summaries)
        if _fitting(headings, rows) < len(headings):
            _print_lines(headings, rows)
        else:
            _print_columns(headings, rows)


def print_reasons(runs: Mapping[str, Mapping[str, Any]]) -> None:
    """Why runs ended early, one line each; heading to summary."""
    for heading, its in runs.items():
        if its.get("reason"):
            say(f"{heading}: {its['outcome']} at {its['outcome_time']:.3f} s: {its['reason']}")


def _fitting(headings: Sequence[str], rows: Sequence[IndicatorRow]) -> int:
    """How many runs fit as columns on the terminal, at least one."""
    names = max((len(row.label) + len(row.unit) for row in rows), default=0)
    widest = max(
        (len(cell) for cells in (headings, *(row.values for row in rows)) for cell in cells),
        default=0,
    )
    return max(1, (console.width - names - 7) // (widest + 3))


def _print_columns(headings: Sequence[str], rows: Sequence[IndicatorRow]) -> None:
    lines = ((row.label, *row.values, row.unit) for row in rows)
    print_table(("", *headings, "unit"), lines, right=slice(1, -1))


def _print_lines(headings: Sequence[str], rows: Sequence[IndicatorRow]) -> None:
    columns = zip(headings, *(row.values for row in rows), strict=True)
    print_table(("", *(f"{row.label} [{row.unit}]" for row in rows)), columns, right=slice(1, None))


def print_table(
    headings: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    right: slice = slice(0),
    title: str | None = None,
) -> None:
    """A table of texts.

    Args:
        headings: Of the columns.
        rows: A text a column.
        right: Columns whose texts are aligned right.
        title: Above the table.
    """
    from rich.table import Table

    table = Table(title=title, title_justify="left", header_style="bold")
    for heading in headings:
        table.add_column(escape(heading), overflow="fold")
    for column in table.columns[right]:
        column.justify = "right"
    for row in rows:
        table.add_row(*map(escape, row))
    console.print(table)


def say(*lines: str, style: str | None = None, whole: bool = False) -> None:
    """Lines as they are; ``whole`` ones are not wrapped."""
    for line in lines:
        console.print(line, style=style, markup=False, soft_wrap=whole)


@contextmanager
def progress(what: str, total: float, unit: str = "") -> Iterator[Advance]:
    """Progress on standard error: a bar on a terminal, elsewhere a line now and then.

    Args:
        what: Label of the work.
        total: What ``done`` is when all is done.
        unit: What is counted, as ``runs``; without one the share done is shown.
    """
    meter = Meter(total, unit)
    if not errors.is_terminal:
        click.echo(f"{what}: {total:.0f} {unit} ..." if unit else f"{what} ...", err=True)
        yield _lines(what, meter)
        return
    from rich.progress import BarColumn, Progress, TextColumn

    columns = (TextColumn("{task.description}", markup=False), BarColumn(24))
    text = TextColumn("{task.fields[text]}", markup=False)
    with Progress(*columns, text, console=errors, transient=True) as bar:
        task = bar.add_task(what, total=total, text="")

        def advance(done: float, note: str = "", /) -> None:
            bar.update(task, completed=done, text=meter.text(done, note))

        yield advance


class Meter:
    """Says in words how far some work is, at what rate, and how long the rest will take.

    The rate is that since the first call, so that what was done before does not count.

    Args:
        total: What is done when all is done.
        unit: What is counted; empty for a share.
    """

    def __init__(self, total: float, unit: str = "") -> None:
        self._total, self._unit = total, unit
        self._first: tuple[float, float] | None = None

    def text(self, done: float, note: str = "") -> str:
        """The words for what is done now."""
        now = monotonic()
        begin, before = self._first = self._first or (now, done)
        rate = (done - before) / max(now - begin, 1e-9)
        counted = f"{done:.0f} of {self._total:.0f} {self._unit}"
        parts = [counted if self._unit else f"{min(done / self._total, 1):.0%}"]
        if self._unit and rate > 0:
            parts.append(f"{rate:.2g} per second")
        if rate > 0 and done < self._total:
            parts.append(f"about {duration((self._total - done) / rate)} left")
        return ", ".join((*parts, note) if note else parts)


def _lines(what: str, meter: Meter) -> Advance:
    """Progress as plain lines, none sooner than ``LINE_EVERY`` after the last."""
    last = monotonic()

    def advance(done: float, note: str = "", /) -> None:
        nonlocal last
        text = meter.text(done, note)
        if monotonic() - last > LINE_EVERY:
            click.echo(f"{what}: {text}", err=True)
            last = monotonic()

    return advance


def duration(seconds: float) -> str:
    """A time for people: in s, min or h."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


OPTIONS = {"on": "--rig"}
"""Arguments of the package whose option has another name."""


class Terminal(Reporter):
    """Progress, warnings and notes on standard error."""

    def __init__(self) -> None:
        self._quiet = False

    def progress(self, what: str, total: float, unit: str = "") -> AbstractContextManager[Advance]:
        """A bar on a terminal, elsewhere a line now and then."""
        if self._quiet:
            return super().progress(what, total, unit)
        return progress(what, total, unit)

    def warn(self, message: str) -> None:
        """One line."""
        warn(message)

    def note(self, line: str, *, weighty: bool = False) -> None:
        """A line, dim unless it is weighty."""
        style = None if weighty else "dim"
        errors.print(line, style=style, highlight=False, markup=False)

    def name_of(self, argument: str) -> str:
        """The option that an argument is."""
        return OPTIONS.get(argument, f"--{argument}")

    @contextmanager
    def watching(
        self, viewing: Viewing, scenario: Scenario, folder: Path, *, twin: bool = False
    ) -> Iterator[Attach]:
        """The context of a run that is watched; a live summary takes the place of its progress.

        Args:
            viewing: How.
            scenario: What is run.
            folder: Its folder.
            twin: Whether its twin runs beside it.
        """
        with viewing.of(scenario, folder, twin=twin) as attach:
            self._quiet = viewing.watch
            try:
                yield attach
            finally:
                self._quiet = False
