"""States of a driven rig that are kept, to go back to."""

from __future__ import annotations

from typing import NamedTuple

from twin.play.driven import Driven
from twin.run.state import Snapshot

EVERY = 1.0
"""Simulated seconds from one state to the next."""
RECENT = 30.0
"""Seconds for which all of them are kept."""
LATER = 5.0
"""Seconds from one to the next of those before."""


class Kept(NamedTuple):
    """A state.

    Attributes:
        time: Of it, s.
        row: Rows of the record before it.
        driven: What had been driven.
        rig: State of the rig and its controller.
        ghost: Of the clean model and its controller.
        acted: Whether something was done at this moment that the record's scenario does not say.
    """

    time: float
    row: int
    driven: Driven
    rig: Snapshot
    ghost: Snapshot
    acted: bool = False


class States:
    """The states in the order of time, fewer of long ago."""

    def __init__(self) -> None:
        self.all: list[Kept] = []

    def due(self, time: float) -> bool:
        """Whether it is time for another one."""
        return not self.all or time > self.all[-1].time + EVERY - 1e-9

    def keep(self, state: Kept) -> None:
        """Take one in; of two at one moment the later one counts."""
        if self.all and abs(self.all[-1].time - state.time) < 1e-9:
            former = self.all.pop()
            state = state._replace(acted=state.acted or former.acted)
        self.all.append(state)
        self._thin(state.time)

    def back_to(self, time: float) -> Kept:
        """The last one before a time in s; all that follow are forgotten."""
        while len(self.all) > 1 and self.all[-1].time > time + 1e-9:
            self.all.pop()
        return self.all[-1]

    def _thin(self, now: float) -> None:
        """Leave out what has just become old and is close to the one before."""
        old = next((i for i, each in enumerate(self.all) if each.time > now - RECENT), 0) - 1
        if old > 1 and not self.all[old].acted:
            apart = self.all[old].time - self.all[old - 1].time
            if apart < LATER - 1e-9:
                del self.all[old]
