"""What of a simulation is shown: some numbers many times a second, and words when they change."""

from __future__ import annotations

from collections.abc import Callable, Mapping
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
