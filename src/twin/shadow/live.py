"""The twin beside a run in progress: another process asks it and says what it says."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import closing

import numpy as np

from twin.scenario.schema import Scenario
from twin.shadow.diagnosis import Alarm
from twin.shadow.follow import MARGIN, SETTLING, LiveFollower
from twin.shadow.horizon import BAND
from twin.shadow.report import Shown, Tell, drawing
from twin.view.live_process import Address, SharedRingBuffer, step_back

EVERY = 0.2
"""Seconds between two looks for new rows."""
MOST = 1000
"""Rows taken at a time, so that one sees a twin that is behind a fast run go on."""
SCORE_EVERY = 10.0
"""Seconds of the run between two lines with its score."""


def work(buffer: Address, scenario: Scenario, shown: Shown | None) -> None:
    """Ask the twin until the writer has ended, or is gone; the body of the process.

    Args:
        buffer: Where the rows come from.
        scenario: What is run.
        shown: Where the twin is drawn; None for nowhere.
    """
    step_back()
    tell: Tell = (lambda _, __: None) if shown is None else drawing(scenario, shown)
    commentary = Commentary(LiveFollower(scenario, "the run"), _print)
    with closing(SharedRingBuffer(*buffer)) as ring:
        for block in ring.blocks(EVERY, MOST):
            if block:
                commentary.take(block, tell)
        commentary.end(tell, ring.dropped)


class Commentary:
    """What is printed of a run and its twin: a line now and then, one an alarm, one its causes.

    Args:
        follower: The twin.
        line: Prints a line.
    """

    def __init__(self, follower: LiveFollower, line: Callable[[str], None]) -> None:
        self._follower, self._line = follower, line
        self._replays, self._alarms, self._scored = 0, 0, 0.0

    def take(self, rows: dict[str, np.ndarray], tell: Tell) -> None:
        """Take in rows, and ask the twin if it is time, more than once if they are many.

        Args:
            rows: Columns of the record, shape (K,) each.
            tell: Is told what is new.
        """
        period = self._follower.period
        every = max(1, round(1.0 / period))
        for first in range(0, len(rows["time"]), every):
            part = {name: values[first : first + every] for name, values in rows.items()}
            if self._follower.take(part):
                self._say(self._follower.ask(), tell)

    def end(self, tell: Tell, dropped: int) -> None:
        """Say what is left to be said.

        Args:
            tell: Is told what is new.
            dropped: Rows that were missed.
        """
        self._say(self._follower.ask(whole=True), tell)
        self._score(0.0)
        if dropped:
            self._line(f"twin: missed {dropped} rows of the run; its page has them all")

    def _say(self, explained: list[Alarm], tell: Tell) -> None:
        said = self._follower.said
        events = []
        for alarm in said.alarms[self._alarms :]:
            left = "" if alarm.causes else f"; causes at {alarm.time + SETTLING + MARGIN:.0f} s"
            events.append(
                (alarm.time, f"alarm at {alarm.time:.1f} s: reality has left the model{left}")
            )
        events += [(alarm.time, f"alarm at {alarm.words}") for alarm in explained]
        self._alarms = len(said.alarms)
        for _, text in events:
            self._line(f"twin: {text}")
        new = None
        if said.replays is not None:
            which = np.arange(len(said.replays.time)) >= self._replays
            self._replays = len(which)
            new = said.replays.take(which)
        self._score(SCORE_EVERY)
        tell(new, events)

    def _score(self, every: float) -> None:
        """A line with the score since the last one, if that is long enough ago."""
        run = self._follower.said.replays
        if run is None or not len(run.time):
            return
        end = run.time + run.ahead
        if end[-1] - self._scored < max(every, 1e-9):
            return
        of_late = run.take(run.counted & (end > self._scored))
        self._scored = float(end[-1])
        if not len(of_late.time):
            self._line(f"twin: {end[-1]:.0f} s, cannot tell: the ball rests or is not seen")
            return
        inside = 100 * float((of_late.square <= BAND).mean())
        self._line(
            f"twin: {end[-1]:.0f} s, score {np.median(of_late.score):.2f} (1: as predicted), "
            f"{inside:.0f} % of {len(of_late.time)} replays in their 95 % band"
        )


def _print(line: str) -> None:
    """A line of its own, over a progress bar if there is one."""
    over = "\r\x1b[K" if sys.stderr.isatty() else ""
    sys.stderr.write(f"{over}{line}\n")
    sys.stderr.flush()
