"""What of a simulation is shown: some numbers many times a second, and words when they change."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

COLUMNS = (
    "time",
    "x",
    "y",
    "phi",
    "theta",
    "goal_x",
    "goal_y",
    "desired_x",
    "desired_y",
    "ghost_x",
    "ghost_y",
    "error",
    "ghost_error",
    "effort",
    "factor",
)
"""Numbers of one picture: s, m, rad; the effort is the RMS of the plate's acceleration, rad/s^2,
since the picture before; ``factor`` is the simulated seconds a second of the clock."""


class Errors:
    """Root mean square distances of rig and clean model from where the ball shall be, so far."""

    def __init__(self) -> None:
        self._sums: list[tuple[float, float, float]] = []

    def add(self, rows: Sequence[Sequence[float]]) -> None:
        """Take pictures in, oldest first; one before the last one forgets what followed it."""
        for row in rows:
            now = dict(zip(COLUMNS, row, strict=True))
            while self._sums and self._sums[-1][0] >= now["time"]:
                self._sums.pop()
            _, rig, clean = self._sums[-1] if self._sums else (0.0, 0.0, 0.0)
            squares = now["error"] ** 2, now["ghost_error"] ** 2
            self._sums.append((now["time"], rig + squares[0], clean + squares[1]))

    @property
    def rms(self) -> tuple[float, float]:
        """Of rig and clean model in m; NaN of a ball that has left the plate."""
        if not self._sums:
            return 0.0, 0.0
        _, rig, clean = self._sums[-1]
        return math.sqrt(rig / len(self._sums)), math.sqrt(clean / len(self._sums))


class Status(NamedTuple):
    """What the page says in words; sent when it changes.

    Attributes:
        tables: The scenario as it is now.
        paused: Whether time stands still.
        ended: How the run ended, if it has: only going back goes on from there.
        message: What was done or refused last.
        wrong: Whether that message is of something refused.
    """

    tables: Mapping[str, Any]
    paused: bool = False
    ended: str = ""
    message: str = ""
    wrong: bool = False


Show = Callable[[tuple[float, ...]], None]
"""Is given the numbers of a picture, in the order of ``COLUMNS``."""
Tell = Callable[[Status], None]


class Said:
    """What was said last, told only when it changes.

    Args:
        tell: Is told.
    """

    def __init__(self, tell: Tell) -> None:
        self._tell = tell
        self._status = Status({})
        self._told: Status | None = None

    def note(self, message: str, *, wrong: bool = False) -> None:
        """Have a message to be told next."""
        self._status = self._status._replace(message=message, wrong=wrong)
        if wrong:
            self._told = None  # told again, as the page may show what was refused

    def say(self, tables: Mapping[str, Any], *, paused: bool, ended: str) -> None:
        """Tell how things are, with the last message, if anything has changed."""
        self._status = now = self._status._replace(tables=tables, paused=paused, ended=ended)
        if now != self._told:
            self._told = now
            self._tell(now)
