"""Snapshots: the state of simulated rigs and their controller, saved and restored to the bit.

What has a state is found by ``saved_state``. A restored rig must have been assembled from the same
scenario, which says again what cannot change.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from controllers.controller import Controller
from controllers.interfaces import Measurement
from twin.errors import RecordError
from twin.hal.rig import Entry, Rig
from twin.hal.supervisor import RIG_CONDITIONS, Note
from twin.run.changes import Changes
from twin.run.record_file import read_beside
from twin.run.saved_state import Node, SnapshotError, restore, saved, value_of
from twin.sim.rig import SimulatedRig

CONDITIONS = {condition.name: condition for condition in RIG_CONDITIONS}

EVERY = 5.0
"""Time in s from one snapshot that a run keeps to the next."""
MOST = 20
"""Snapshots that a run keeps at most, so that its record stays small."""
SNAPSHOTS = "ballplate_snapshots"
"""Metadata of a record that holds its snapshots."""


@dataclass(frozen=True)
class Snapshot:
    """Everything that goes on to matter, at the beginning of a control period.

    Attributes:
        time: Of the run, s.
        period: Control period in s.
        rig: State of the rigs, their journal included.
        controller: State of law, observer and reference.
        measurement: The one that begins the period.
    """

    time: float
    period: float
    rig: Node
    controller: Node
    measurement: Node

    @classmethod
    def take(cls, rig: Rig, controller: Controller, measurement: Measurement) -> Snapshot:
        """The state of rigs and their controller, a measurement having just been read.

        Raises:
            SnapshotError: If it is not a simulated rig.
        """
        if not isinstance(rig, SimulatedRig):
            raise SnapshotError("only the state of a simulated rig can be saved")
        seen: set[int] = set()
        journal = [[time, note.rig, note.condition.name, note.text] for time, note in rig.journal]
        return cls(
            measurement.time,
            rig.period,
            {"state": saved(rig, seen), "journal": journal},
            saved(controller, seen),
            saved(tuple(measurement), seen),
        )

    def restore(self, rig: Rig, controller: Controller | None = None) -> Measurement:
        """Put rigs, and their controller if it is the same, into this state.

        Args:
            rig: Assembled from the scenario of the snapshot, and switched on.
            controller: Made from that scenario, too.

        Returns:
            The measurement that begins the period.

        Raises:
            SnapshotError: If the rig is another.
        """
        if isinstance(rig.changes, Changes):
            rig.changes.catch_up(self.time - self.period)
        restore(rig, self.rig["state"])
        rig.journal[:] = [
            Entry(time, Note(number, CONDITIONS[name], text))
            for time, number, name, text in self.rig["journal"]
        ]
        if controller is not None:
            self.restore_controller(controller)
        return self.measured

    def restore_controller(self, controller: Controller) -> None:
        """Put a controller made from the scenario of the snapshot into its state.

        Raises:
            SnapshotError: If it is another.
        """
        restore(controller, self.controller)

    @property
    def measured(self) -> Measurement:
        """The measurement that begins the period."""
        return Measurement(*value_of(self.measurement))


class Keeper:
    """Keeps snapshots of a run now and then, for going on from there.

    Args:
        rig: Simulated rigs.
        controller: Theirs.
        duration: Of the run, s.
    """

    def __init__(self, rig: Rig, controller: Controller, duration: float) -> None:
        self.snapshots: list[Snapshot] = []
        self._rig, self._controller = rig, controller
        self._ticks = round(max(EVERY, duration / MOST) / rig.period)

    def __call__(self, tick: int, measurement: Measurement) -> None:
        """Keep one if it is time."""
        if tick and tick % self._ticks == 0:
            self.snapshots.append(Snapshot.take(self._rig, self._controller, measurement))


def snapshots_of(file: Path) -> list[Snapshot]:
    """The snapshots that a record keeps; none if it has none.

    Raises:
        RecordError: If they are damaged, or there is no record.
    """
    content = read_beside(file, SNAPSHOTS)
    return unpacked(content, str(file)) if content else []


def packed(snapshots: Sequence[Snapshot]) -> bytes:
    """Snapshots as bytes: data only, nothing that could be executed when it is read."""
    arrays: list[Any] = []

    def encoded(node: Node) -> Node:
        if isinstance(node, np.ndarray):
            arrays.append(node)
            return {"array": len(arrays) - 1}
        if isinstance(node, dict):
            return {key: encoded(each) for key, each in node.items()}
        return [encoded(each) for each in node] if isinstance(node, list | tuple) else node

    text = json.dumps([encoded(vars(each)) for each in snapshots])
    file = io.BytesIO()
    named = {f"a{number}": array for number, array in enumerate(arrays)}
    np.savez(file, text=np.array(text), **named)
    return file.getvalue()


def unpacked(content: bytes, source: str) -> list[Snapshot]:
    """The snapshots that ``packed`` made bytes of.

    Raises:
        RecordError: If the bytes are damaged.
    """

    def decoded(node: Node) -> Node:
        if isinstance(node, dict):
            if node.keys() == {"array"}:
                return file[f"a{node['array']}"]
            return {key: decoded(each) for key, each in node.items()}
        return [decoded(each) for each in node] if isinstance(node, list) else node

    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            return [Snapshot(**decoded(each)) for each in json.loads(file["text"].item())]
    except (OSError, ValueError, TypeError, LookupError, zipfile.BadZipFile) as error:
        raise RecordError(f"{source}: its snapshots are damaged") from error
