"""Snapshots: the state of simulated rigs and their controller, saved and restored to the bit.

What has a state is found by going through attributes: arrays, numbers, texts and random streams.
What cannot change is left out: frozen dataclasses, functions, models; changes while running follow
from the time. A restored rig must have been assembled from the same scenario, which says again what
cannot change.
"""

from __future__ import annotations

import io
import json
import sys
import zipfile
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from controllers.controller import Controller
from controllers.interfaces import Measurement
from twin.errors import RecordError, TwinError
from twin.hal.rig import Entry, Rig
from twin.hal.supervisor import RIG_CONDITIONS, Note
from twin.run.assemble import RigChanges
from twin.run.record import read_beside
from twin.sim.rig import SimulatedRig

FOREIGN = {"mujoco", "numpy", "pydantic", "scipy"} | set(sys.stdlib_module_names)
"""Packages whose objects are constant wherever they stand, but for arrays and random streams."""
Node = Any
"""Data, an array, or a dictionary with one key that says what its content is: ``tuple``, ``list``
and ``dict`` of nodes, or what is put into its state where it stands: ``object`` (class and
attributes), ``inner`` (objects in a tuple, list or dictionary), ``own`` (class and what it says
itself) and ``rng``."""
LEFT_OUT: Node = {"left out": None}


class SnapshotError(TwinError, ValueError):
    """A snapshot cannot be taken or restored."""


def saved(thing: Any, seen: set[int]) -> Node:  # noqa: PLR0911  one line a kind
    """The node of a value; ``LEFT_OUT`` of one that cannot change or has been saved already."""
    if isinstance(thing, np.ndarray):
        return LEFT_OUT if thing.dtype.hasobject else thing.copy(order="K")
    if isinstance(thing, np.generic):
        return thing.item()
    if thing is None or type(thing) in {bool, int, float, str}:
        return thing
    if isinstance(thing, np.random.Generator):
        return {"rng": thing.bit_generator.state}
    if isinstance(thing, tuple | list | deque):
        each = {index: saved(one, seen) for index, one in enumerate(thing)}
        return _several("tuple" if isinstance(thing, tuple) else "list", each)
    if isinstance(thing, dict):
        return _several("dict", {key: saved(each, seen) for key, each in thing.items()})
    if _constant(thing) or id(thing) in seen:
        return LEFT_OUT
    seen.add(id(thing))
    if hasattr(thing, "saved_state"):  # it says itself what its state is
        return {"own": [type(thing).__name__, saved(thing.saved_state(), seen)]}
    nodes = {name: saved(value, seen) for name, value in vars(thing).items()}
    kept = [
        (name, node)
        for name, node in nodes.items()
        if node is not LEFT_OUT and not (isinstance(thing, Rig) and name == "changes")
    ]
    return {"object": [type(thing).__name__, kept]}


def _constant(thing: Any) -> bool:
    """Whether a thing that is no data never changes."""
    parameters = getattr(thing, "__dataclass_params__", None)
    frozen = parameters is not None and parameters.frozen
    foreign = type(thing).__module__.partition(".")[0] in FOREIGN
    closed = not hasattr(thing, "__dict__")  # of a compiled library
    return bool(frozen or foreign or closed or isinstance(thing, BaseModel | RigChanges | Enum))


def _several(kind: str, nodes: Mapping[Any, Node]) -> Node:
    """A tuple, list or dictionary: whole if it is all data, else the objects in it."""
    if all(node is not LEFT_OUT and not _inside(node) for node in nodes.values()):
        return {kind: list(nodes.items()) if kind == "dict" else list(nodes.values())}
    inner = [(key, node) for key, node in nodes.items() if _inside(node)]
    return {"inner": inner} if inner else LEFT_OUT


def _inside(node: Node) -> bool:
    """Whether a node is of something that is put into its state where it stands."""
    return isinstance(node, dict) and next(iter(node)) in {"object", "inner", "own", "rng"}


def restore(thing: Any, node: Node) -> None:
    """Put a thing into its state where it stands.

    Raises:
        SnapshotError: If it is another thing.
    """
    ((kind, content),) = node.items()
    if kind in {"object", "own"}:
        name, content = content
        if name != type(thing).__name__:
            own = type(thing).__name__
            raise SnapshotError(f"the snapshot has {name} where this rig has {own}")
    try:
        if kind == "rng":
            thing.bit_generator.state = content
        elif kind == "own":
            thing.restore_state(value_of(content))
        for name, child in content if kind in {"object", "inner"} else ():
            if _inside(child):
                restore(getattr(thing, name) if kind == "object" else thing[name], child)
            else:
                setattr(thing, name, _like(getattr(thing, name, None), value_of(child)))
    except (AttributeError, LookupError, TypeError, ValueError) as error:
        raise SnapshotError(f"the snapshot is not of such a rig: {error}") from error


def value_of(node: Node) -> Any:
    """The value of a node that is data."""
    if isinstance(node, np.ndarray):
        return node.copy(order="K")
    if not isinstance(node, dict):
        return node
    ((kind, content),) = node.items()
    if kind == "dict":
        return {key: value_of(each) for key, each in content}
    values = [value_of(each) for each in content]
    return tuple(values) if kind == "tuple" else values


def _like(present: Any, value: Any) -> Any:
    """A saved value as the one in its place is.

    A tuple has its names, a queue its length; an array that is the same is left, as products of
    matrices round differently where they lie differently in memory.
    """
    if isinstance(value, np.ndarray) and isinstance(present, np.ndarray):
        same = value.dtype == present.dtype and np.array_equal(value, present, equal_nan=True)
        return present if same else value
    if isinstance(present, deque):
        return deque(map(_like, present, value), present.maxlen)
    if isinstance(value, tuple) and isinstance(present, tuple) and len(present) == len(value):
        each = [_like(*pair) for pair in zip(present, value, strict=True)]
        return type(present)._make(each) if hasattr(present, "_make") else tuple(each)
    return value


CONDITIONS = {condition.name: condition for condition in RIG_CONDITIONS}

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
        if isinstance(rig.changes, RigChanges):
            rig.changes.catch_up(self.time - self.period)
        restore(rig, self.rig["state"])
        rig.journal[:] = [
            Entry(time, Note(number, CONDITIONS[name], text))
            for time, number, name, text in self.rig["journal"]
        ]
        if controller is not None:
            restore(controller, self.controller)
        return self.measured

    @property
    def measured(self) -> Measurement:
        """The measurement that begins the period."""
        return Measurement(*value_of(self.measurement))


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
