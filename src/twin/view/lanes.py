"""States over time, as lanes of the viewer: what the rig was allowed, and what the ball did."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from controllers.arrays import Array
from twin.hal.interface import AXIS_NAMES
from twin.hal.supervisor import State
from twin.run.finished import states_of
from twin.run.metrics import MAX_TURNING_TIME_S, STILL_SPEED_M_S
from twin.scenario.schema import Scenario

Names = NDArray[np.str_]
Mask = NDArray[np.bool_]
Rgb = tuple[int, int, int]

GOOD, CALM, WARNING, BAD = (0, 158, 115), (86, 180, 233), (230, 159, 0), (213, 94, 0)
IDLE_COLOUR = (90, 96, 104)
STATE_COLOURS: dict[str, dict[str, Rgb]] = {
    "supervisor": {
        "off": IDLE_COLOUR,
        "initialising": CALM,
        "ready": CALM,
        "running": GOOD,
        "holding": WARNING,
        "fault": BAD,
    },
    "ball": {"rolls": GOOD, "at rest": CALM, "not detected": BAD},
    "screen": {"new frames": GOOD, "no new frame": WARNING},
    "effort": {"within limits": GOOD, "phi limited": WARNING, "theta limited": WARNING}
    | {"both limited": WARNING},
    "wheels": {"on cams": GOOD, "phi lifted off": BAD, "theta lifted off": BAD}
    | {"both lifted off": BAD},
}
"""The lanes of a run from top to bottom, their states and the colour of each."""
MISSED_FRAMES = 3
"""Frame times after the dead time from which the screen is shown as having no new frame."""
EFFORT_TOLERANCE_RAD_S2 = 0.01
"""Difference of requested and applied plate acceleration from which a limit is shown."""


class Lane(NamedTuple):
    """The states of one thing, where they change.

    Attributes:
        time: Times of the changes in s, shape (K,).
        states: The state from each of these times on.
    """

    time: Array
    states: list[str]


def changes(time: Array, states: Names, before: str | None = None) -> Lane:
    """A state sample by sample, (K,), reduced to its changes; the state before, if there was."""
    first = np.concatenate(([states[0] != before], states[1:] != states[:-1]))
    return Lane(time[first], states[first].tolist())


def looks(name: str) -> rr.StateConfiguration:
    """The colours of a lane of a run."""
    colours = STATE_COLOURS[name]
    return rr.StateConfiguration(values=list(colours), colors=[*colours.values()])


class RunLanes:
    """The lanes of a run, block by block.

    Args:
        scenario: The scenario of the run; its screen gives the times of the frames.
    """

    def __init__(self, scenario: Scenario) -> None:
        touch = scenario.sensors.touch
        frame = 1 / touch.frame_rate if touch.frame_rate else scenario.rig.period
        self._due = touch.dead_time + MISSED_FRAMES * frame
        """Age in s of a position from which a new frame is missing."""
        self._last: dict[str, str] = {}
        self._moved = -np.inf
        """When the ball was faster than at rest for the last time, s."""

    def take(self, rows: Mapping[str, Array]) -> Iterator[tuple[str, Lane]]:
        """The changes within a block of recorded rows, (K,) per column, by the lane's name."""
        for name, states in self._states(rows).items():
            lane = changes(rows["time"], states, self._last.get(name))
            self._last[name] = str(states[-1])
            if lane.states:
                yield name, lane

    def _states(self, rows: Mapping[str, Array]) -> dict[str, Names]:
        """The state of each lane in every row, shape (K,)."""
        supervisor = [State(int(each)).name.lower() for each in rows["supervisor"]]
        found: dict[str, Any] = {"supervisor": np.array(supervisor)}
        still = np.where(self._still(rows), "at rest", "rolls")
        found["ball"] = np.where(find_undetected(rows), "not detected", still)
        if "age" in rows:
            late = rows["age"] > self._due
            found["screen"] = np.where(late, "no new frame", "new frames")
        found["effort"] = _either("within limits", "limited", *find_limited(rows))
        if lifted := find_lifted(rows):
            found["wheels"] = _either("on cams", "lifted off", *lifted)
        return found

    def _still(self, rows: Mapping[str, Array]) -> Mask:
        """Where the ball has been at rest for longer than a turning point takes, shape (K,)."""
        time = rows["time"]
        moves = np.hypot(*states_of(rows)[:, 1::4].T) >= STILL_SPEED_M_S
        last = np.maximum.accumulate(np.where(moves, time, self._moved))
        self._moved = float(last[-1])
        return np.asarray(time - last >= MAX_TURNING_TIME_S)


def find_undetected(rows: Mapping[str, Array]) -> Mask:
    """Where the screen does not detect the ball, (K,); nowhere in a record without the column."""
    return rows.get("touched", np.ones(len(rows["time"]))) < 0.5


def find_lifted(rows: Mapping[str, Array]) -> tuple[Mask, Mask] | None:
    """Where the wheels of phi and theta press on no cam, (K,) each; None in a record of a rig."""
    if "wheel_phi_N" not in rows:
        return None
    return rows["wheel_phi_N"] <= 0, rows["wheel_theta_N"] <= 0


def find_limited(rows: Mapping[str, Array]) -> tuple[Mask, Mask]:
    """Where less plate acceleration is applied than requested, about phi and theta, (K,) each."""
    phi, theta = (
        np.abs(rows[f"requested_{axis}_acc"] - rows[f"applied_{axis}_acc"]) for axis in AXIS_NAMES
    )
    return phi > EFFORT_TOLERANCE_RAD_S2, theta > EFFORT_TOLERANCE_RAD_S2


def _either(neither: str, what: str, phi: Mask, theta: Mask) -> Names:
    """The state of a lane that shows whether something is true of an axis or of both."""
    one = np.where(phi, f"phi {what}", np.where(theta, f"theta {what}", neither))
    return np.asarray(np.where(phi & theta, f"both {what}", one))


def lane_columns(states: Sequence[str]) -> rr.ComponentColumnList:
    """States as columns for the viewer."""
    return rr.StateChange.columns(state=list(states))
