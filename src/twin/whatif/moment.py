"""A moment of a run, from which futures go on: where a rig and its controller are then."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from controllers.arrays import Array
from controllers.controller import Controller
from controllers.interfaces import Measurement
from twin.scenario.schema import Scenario
from twin.sim.rig import SimulatedRig

LOOK_BACK = 1.0
"""Time in s before a moment over which twin and record are compared."""


class Recorded(NamedTuple):
    """What a record or a log says, for comparison.

    Attributes:
        time: In s, shape (K,).
        ball: True or smoothed position in m, shape (K, 2); NaN where there is none.
        plate: Plate angles (phi, theta) in rad, shape (K, 2).
        u: Applied plate accelerations in rad/s^2, shape (K, 2).
    """

    time: Array
    ball: Array
    plate: Array
    u: Array


@dataclass(frozen=True, kw_only=True)
class Moment:
    """A moment of a run.

    Attributes:
        name: Of the run.
        at: Its time, s; a whole number of periods.
        scenario: Of the run.
        recorded: What was recorded before and after it, for comparison.
        columns: All of it, by the names of a record.
        exact: Whether the state is the run's own to the bit, or estimated.
        before_mm: Largest distance in mm of twin and record over the last second before it; None
            if there is no such second.
        controller: Makes a controller of the run, as it is at the moment.
        put: Puts a rig, switched on, to where it is then; gives the measurement of the period.
        gaps: Beginning and end in s of where the record has nothing.
        notes: What should be known of it, a sentence each.
    """

    name: str
    at: float
    scenario: Scenario
    recorded: Recorded
    columns: Mapping[str, Array]
    exact: bool
    before_mm: float | None
    controller: Callable[[], Controller]
    put: Callable[[SimulatedRig], Measurement]
    gaps: tuple[tuple[float, float], ...] = ()
    notes: tuple[str, ...] = ()


def take_over(new: Controller, old: Controller, was: Scenario, now: Scenario) -> None:
    """Give a controller, just started, what stays of the one before it.

    Args:
        new: The controller.
        old: The one before it, in its state.
        was: Scenario of the old one.
        now: Of the new one.
    """
    new.rate = old.rate
    if now.controller == was.controller:
        new.memory = old.memory
    if (now.observer, now.predictor) == (was.observer, was.predictor):
        new.observer = old.observer
    else:
        new.observer.start(old.observer.x)
    if now.reference == was.reference:
        new.reference = old.reference
