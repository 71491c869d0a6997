"""A live summary of a run on the terminal, printed by another process."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, field

import numpy as np
from rich.console import Console
from rich.live import Live
from rich.markup import escape
from rich.table import Table

from controllers.arrays import Array
from twin.hal.supervisor import State
from twin.run.assemble import build_reference
from twin.run.finished import states_of
from twin.scenario.schema import Scenario
from twin.view.live_process import Address, SharedRingBuffer, step_back

SHOWN_EVERY = 0.5
"""Seconds between two updates on a terminal; half a kilobyte each."""
LINE_EVERY = 5.0
"""Seconds between two lines where there is no terminal."""


@dataclass
class Summary:
    """The state of a run in progress, in a few words.

    Args:
        scenario: What is run.
    """

    scenario: Scenario
    rows: Mapping[str, Array] = field(default_factory=dict)
    dropped: int = 0
    worst: float = 0.0

    def __post_init__(self) -> None:
        """Prepare the reference."""
        self._reference = build_reference(self.scenario)
        self._error: Array = np.empty(0)
        self._begun, self._first = 0.0, 0.0

    def take(self, rows: Mapping[str, Array]) -> None:
        """Take in new rows, all columns equally long."""
        if not rows or not len(rows["time"]):
            return
        if not self.rows:
            self._begun, self._first = time.monotonic(), float(rows["time"][-1])
        ball = states_of(rows)[:, 0::4]
        distance = np.hypot(*(self._reference(rows["time"])[0] - ball).T)
        last = round(1.0 / self.scenario.rig.period)
        self._error = np.concatenate((self._error, distance))[-last:]
        self.worst = max(self.worst, float(distance.max()))
        self.rows = {name: column[-1:] for name, column in rows.items()}

    def fields(self) -> dict[str, str]:
        """Label to text, in the order of display; empty before the first row."""
        if not self.rows:
            return {}
        now = float(self.rows["time"][0]) + self.scenario.rig.period
        end = self.scenario.duration
        state = states_of(self.rows)[0]
        shown = {
            "progress": f"{now:.1f} of {end:g} s ({now / end:.0%})",
            "error": f"{1000 * self._error[-1]:.1f} mm (last second "
            f"{1000 * float(np.sqrt((self._error**2).mean())):.1f} mm RMS, "
            f"largest {1000 * self.worst:.1f} mm)",
            "ball": f"x {1000 * state[0]:+.0f}, y {1000 * state[4]:+.0f} mm",
            "plate": f"phi {np.degrees(state[2]):+.2f}, theta {np.degrees(state[6]):+.2f} deg",
            "state": State(int(self.rows["supervisor"][0])).name.lower(),
        }
        spent = time.monotonic() - self._begun
        if spent > 0.5:
            shown["speed"] = f"{(now - self._first) / spent:.2g} x real time"
        late = [name for name in self.rows if name.startswith("late")]
        if late:
            shown["timing"] = f"{1e6 * self.rows[late[0]][0]:.0f} us late"
        if self.dropped:
            shown["missed"] = f"{self.dropped} rows by this summary; the record has them"
        return shown


def work(buffer: Address, scenario: Scenario) -> None:
    """Print until the writer has ended, or is gone; the body of the process."""
    step_back()
    with closing(SharedRingBuffer(*buffer)) as ring:
        _print(ring, scenario)


def _print(ring: SharedRingBuffer, scenario: Scenario) -> None:
    summary = Summary(scenario)
    console = Console(stderr=True, highlight=False)
    every = SHOWN_EVERY if console.is_terminal else LINE_EVERY
    screen = Live(console=console, transient=True, auto_refresh=False)
    with screen if console.is_terminal else console:
        for block in ring.blocks(every):
            summary.take(block)
            summary.dropped = ring.dropped
            shown = summary.fields()
            if shown and console.is_terminal:
                screen.update(_table(scenario.title, shown), refresh=True)
            elif shown:
                line = ", ".join(
                    text if key != "error" else f"error {text}"
                    for key, text in shown.items()
                    if key != "plate"
                )
                sys.stderr.write(f"{line}\n")
                sys.stderr.flush()


def _table(title: str, shown: Mapping[str, str]) -> Table:
    table = Table(title=escape(title), title_justify="left", show_header=False, box=None)
    for word, text in shown.items():
        table.add_row(f"[bold]{word}[/bold]", text)
    return table
