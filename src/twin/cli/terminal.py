"""What the package `ballplate` is told of the terminal: where progress and warnings go."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from ballplate.reporter import Advance, Reporter
from twin.cli import output

if TYPE_CHECKING:
    from ballplate.running import Attach
    from twin.cli.viewing import Viewing
    from twin.scenario import Scenario

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
        return output.progress(what, total, unit)

    def warn(self, message: str) -> None:
        """One line."""
        output.warn(message)

    def note(self, line: str, *, weighty: bool = False) -> None:
        """A line, dim unless it is weighty."""
        style = None if weighty else "dim"
        output.errors.print(line, style=style, highlight=False, markup=False)

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
