"""Output of the commands: tables for people, JSON for programs, progress for waiting."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.text import Text

from ballplate.reporter import Advance, Reporter, format_progress, now_and_then
from twin.base.errors import printable
from twin.base.page import Table, terminal
from twin.base.shipped import shipped_in
from twin.base.shipped import titles as titles_of
from twin.run.tables import FIRST_LABELS, ORDERED_LABELS, by_run
from twin.run.tables import indicators as table_of

SIDE_BY_SIDE = 4
"""Runs that a table has columns for."""

console = Console(highlight=False, width=None if sys.stdout.isatty() else 140)
errors = Console(stderr=True, highlight=False)


Shown = str | Text | Table
"""A sentence, one in a style, or a table."""


def bold(sentence: str) -> Text:
    """A sentence that is asked for first."""
    return Text(printable(sentence, keep="\n"), style="bold")


def dim(sentence: str) -> Text:
    """A sentence for whom the others were not enough."""
    return Text(printable(sentence, keep="\n"), style="dim")


def json_wanted() -> bool:
    """Whether the command that runs was given ``--json``."""
    context = click.get_current_context(silent=True)
    return context is not None and bool(context.meta.get("json"))


def show(
    found: Mapping[str, Any] | Sequence[Any],
    shown: Iterable[object],
    folder: str | Path | None = None,
    files: str = "",
) -> None:
    """Print what a command found: for programs one JSON value, for people tables and sentences.

    Args:
        found: What ``--json`` prints.
        shown: What people read, in this order; taken only where it is printed.
        folder: Where it was written; None for nowhere.
        files: Its files there, in words.
    """
    if json_wanted():
        to = click.get_current_context().meta["output"]
        click.echo(json.dumps(found, indent=2, allow_nan=False), file=to)
        return
    for each in shown:
        if isinstance(each, Table):
            say(*([each.title] if each.title else []))
            console.print(terminal(each))
        elif isinstance(each, str):
            console.print(
                printable(each, keep="\n\t"), markup=False, soft_wrap=not console.is_terminal
            )
        else:
            console.print(each, markup=False, soft_wrap=not console.is_terminal)
    if folder is not None:
        say(f"written to {folder}/: {files}")


def list_written(folder: Path, *names: str) -> str:
    """Those of some files that are in a folder, in words; a part that writes one may be missing."""
    return ", ".join(name for name in names if (folder / name).exists()) or "nothing"


def show_titles(titles: Mapping[str, str]) -> None:
    """Print what there is to run, name to title, one line each."""
    width = max(map(len, titles), default=0)
    lines = (Text.assemble((f"{name:<{width}}", "bold"), "  ", titles[name]) for name in titles)
    show(titles, lines)


def print_shipped(folder: str) -> int:
    """Print what is shipped in a folder of scenarios/; the exit code of that."""
    show_titles(titles_of(shipped_in(folder)))
    return 0


def say(*lines: str) -> None:
    """Lines as they are, not wrapped."""
    for line in lines:
        console.print(printable(line, keep="\n\t"), markup=False, soft_wrap=True)


def indicators(
    runs: Mapping[str, Mapping[str, Any]], *, everything: bool = False
) -> Iterator[Table]:
    """Indicators of runs, one column per run; those that apply to none are left out.

    Of many runs each has a line, or, of every indicator, the columns stand in several tables.

    Args:
        runs: Heading to summary.
        everything: Whether every indicator is asked for, or those that come first.
    """
    if len(runs) > SIDE_BY_SIDE and not everything:
        yield by_run(runs)
        return
    names = list(runs)
    for some in range(0, len(names), SIDE_BY_SIDE):
        its = {name: runs[name] for name in names[some : some + SIDE_BY_SIDE]}
        yield table_of("", its, ORDERED_LABELS if everything else FIRST_LABELS)


def reasons(runs: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Why runs ended early, one line each; heading to summary."""
    return [
        f"{heading}: {its['outcome']} at {its['outcome_time']:.3f} s: {its['reason']}"
        for heading, its in runs.items()
        if its.get("reason")
    ]


OPTION_NAMES = {
    "on": "--rig",
    "variants": "--with",
    "faults": "--fault",
    "since": "--from",
    "until": "--to",
}
"""Arguments of the package that differ in name from their option."""


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
        if not errors.is_terminal:
            say_line = partial(click.echo, err=True)
            begin = f": {format_progress(0, total, unit, '')}" if unit else ""
            say_line(f"{what}{begin} ...")
            yield now_and_then(what, total, unit, say_line)
            return
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        columns = (TextColumn("{task.description}", markup=False), BarColumn(24))
        more = (TimeRemainingColumn(), TextColumn("{task.fields[text]}", markup=False))
        with Progress(*columns, *more, console=errors, transient=True) as bar:
            task = bar.add_task(what, total=total, text="")

            def advance(done: float, note: str = "", /) -> None:
                bar.update(task, completed=done, text=format_progress(done, total, unit, note))

            yield advance

    def warn(self, message: str) -> None:
        """One line about something that is allowed but not wise."""
        click.echo(f"ballplate: warning: {printable(message)}", err=True)

    def note(self, line: str, *, weighty: bool = False) -> None:
        """A line, dim unless it is weighty."""
        style = None if weighty else "dim"
        errors.print(printable(line, keep="\n"), style=style, highlight=False, markup=False)

    def name_of(self, argument: str) -> str:
        """The option that an argument is."""
        return OPTION_NAMES.get(argument, f"--{argument.replace('_', '-')}")


TERMINAL = Terminal()
progress, warn = TERMINAL.progress, TERMINAL.warn
