"""What is told while a run is followed, and where it is drawn."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from twin.shadow.horizon import Replays

Tell = Callable[[Replays | None, list[tuple[float, str]]], None]
"""Is given new replays, and times and texts of what happened."""


class Shown(NamedTuple):
    """Where the twin is drawn beside the run: the viewer, its recording, the run's name there."""

    url: str
    recording: str
    name: str
