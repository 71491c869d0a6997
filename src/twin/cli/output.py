"""What the commands print: tables for people, JSON for programs, progress for waiting."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from time import monotonic
from typing import Any

import click
from rich.console import Console
from rich.text import Text

from ballplate.reporter import Advance, Reporter
from twin.page import Table, terminal
from twin.report.numbers import IndicatorRow, all_rows, first_rows
from twin.report.numbers import indicators as table_of
from twin.shipped import shipped_in
from twin.shipped import titles as titles_of

LINE_EVERY = 10.0
"""Seconds between two lines of progress where there is no terminal."""

console = Console(highlight=False, width=None if sys.stdout.isatty() else 140)
errors = Console(stderr=True, highlight=False)


Shown = str | Text | Table
"""A sentence, one in a style, or a table."""


def bold(sentence: str) -> Text:
    """A sentence that is asked for first."""
    return Text(sentence, style="bold")


def dim(sentence: str) -> Text:
    """A sentence for whom the others were not enough."""
    return Text(sentence, style="dim")


def json_wanted() -> bool:
    """Whether the command that runs was given ``--json``."""
    context = click.get_current_context(silent=True)
    return context is not None and bool(context.meta.get("json"))


def show(
    found: Mapping[str, Any] | Sequence[Any],
    shown: Iterable[object],
    folder: str | Path | None = None,
    files: str = "",
    replaced: str = "",
) -> None:
    """Print what a command found: for programs one JSON value, for people tables and sentences.

    Args:
        found: What ``--json`` prints.
        shown: What people read, in this order; taken only where it is printed.
        folder: Where it was written; None for nowhere.
        files: Its files there, in words.
        replaced: What it replaced there, in words.
    """
    if json_wanted():
        click.echo(json.dumps(found, indent=2, allow_nan=False))
        return
    for each in shown:
        if isinstance(each, Table):
            say(*([each.title] if each.title else []))
            console.print(terminal(each))
        else:
            console.print(each, markup=False, soft_wrap=not console.is_terminal)
    if folder is not None:
        say(f"written to {folder}/{replaced}: {files}")


def show_titles(titles: Mapping[str, str]) -> None:
    """Print what there is to run, name to title, one line each."""
    width = max(map(len, titles), default=0)
    lines = (Text.assemble((f"{name:<{width}}", "bold"), "  ", titles[name]) for name in titles)
    show(titles, lines)


def listed(folder: str) -> int:
    """Print what is shipped in a folder of scenarios/; the exit code of that."""
    show_titles(titles_of(shipped_in(folder)))
    return 0


def say(*lines: str) -> None:
    """Lines as they are, not wrapped."""
    for line in lines:
        console.print(line, markup=False, soft_wrap=True)


def indicators(
    runs: Mapping[str, Mapping[str, Any]], *, everything: bool = False
) -> Iterator[Table]:
    """Indicators of runs, one column per run; those that apply to none are left out.

    Where the columns do not fit side by side, each run has a line, or, of every indicator, the
    columns stand in several tables.

    Args:
        runs: Heading to summary.
        everything: Whether every indicator is asked for, or those that come first.
    """
    headings, summaries = list(runs), list(runs.values())
    rows = (all_rows if everything else first_rows)(summaries)
    most = _fitting(headings, rows)
    if not everything and most < len(headings):
        heads = ("", *(f"{row.label} [{row.unit}]" for row in rows))
        yield Table("", heads, list(zip(headings, *(row.values for row in rows), strict=True)))
        return
    for some in range(0, len(headings), most):
        part = slice(some, some + most)
        its = (all_rows if everything else first_rows)(summaries[part])
        yield table_of("", its, headings[part])


def reasons(runs: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Why runs ended early, one line each; heading to summary."""
    return [
        f"{heading}: {its['outcome']} at {its['outcome_time']:.3f} s: {its['reason']}"
        for heading, its in runs.items()
        if its.get("reason")
    ]


def _fitting(headings: Sequence[str], rows: Sequence[IndicatorRow]) -> int:
    """How many runs fit as columns on the terminal, at least one."""
    names = max((len(row.label) + len(row.unit) for row in rows), default=0)
    widest = max(
        (len(cell) for cells in (headings, *(row.values for row in rows)) for cell in cells),
        default=0,
    )
    return max(1, (console.width - names - 7) // (widest + 3))


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

    @contextmanager
    def progress(self, what: str, total: float, unit: str = "") -> Iterator[Advance]:
        """Progress of some work: a bar on a terminal, elsewhere a line now and then.

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

    def warn(self, message: str) -> None:
        """One line about something that is allowed but not wise."""
        click.echo(f"ballplate: warning: {message}", err=True)

    def note(self, line: str, *, weighty: bool = False) -> None:
        """A line, dim unless it is weighty."""
        style = None if weighty else "dim"
        errors.print(line, style=style, highlight=False, markup=False)

    def name_of(self, argument: str) -> str:
        """The option that an argument is."""
        return OPTIONS.get(argument, f"--{argument}")


TERMINAL = Terminal()
progress, warn = TERMINAL.progress, TERMINAL.warn
