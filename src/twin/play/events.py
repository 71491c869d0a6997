"""What a person does: events to the one simulation."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple


class Goal(NamedTuple):
    """Where the ball shall go, m, plate axes."""

    x: float
    y: float


class Push(NamedTuple):
    """What the ball's velocity changes by at once, m/s, plate axes."""

    x_rate: float
    y_rate: float


class Settings(NamedTuple):
    """New values of keys of plant, drives, sensors, law, observer and predictor."""

    values: Mapping[str, Any]


class Pause(NamedTuple):
    """Whether time stands still."""

    paused: bool


class Back(NamedTuple):
    """Go back by a time in s, to the last state kept before that; to the beginning at most."""

    seconds: float


class Save(NamedTuple):
    """Save what was driven so far as a run folder."""

    folder: Path


class Told(NamedTuple):
    """No person's: something that was begun elsewhere is done, or failed; said in words."""

    message: str
    wrong: bool = False


class End(NamedTuple):
    """Nothing follows; what was driven since it was last saved is saved, if there is a folder."""

    folder: Path | None = None


Event = Goal | Push | Settings | Pause | Back | Save | Told | End
Inbox = Callable[[float], Sequence[Event]]
"""Waits for events, at most a time in s, and gives those that have come, oldest first."""
