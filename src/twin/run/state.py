"""Snapshots: the state of simulated rigs and their controller, saved and restored to the bit.

The state is collected from attributes: arrays, numbers, texts and random streams. Constant objects
are left out: frozen dataclasses, functions, models; changes of the plant while running follow from
the time. A rig is restored only if it was assembled from the same scenario, which determines the
constant objects.
"""

from __future__ import annotations

import sys
from collections import deque
from copy import deepcopy
from dataclasses import dataclass
from enum import Enum
from typing import Any, NamedTuple

import numpy as np
from pydantic import BaseModel

from controllers.controller import Controller
from controllers.interfaces import Measurement
from twin.base.errors import TwinError
from twin.hal.rig import Entry, Rig
from twin.run.rig_changes import RigChanges
from twin.sim.rig import SimulatedRig

CONSTANT_PACKAGES = {"mujoco", "numpy", "pydantic", "scipy"} | set(sys.stdlib_module_names)
"""Packages with constant objects, except for arrays and random streams."""


RIG_SETTINGS = ("changes", "levelling_s")
"""Attributes of a rig that are set from outside and are no part of its state."""


class InPlace(NamedTuple):
    """The state of an object that is restored in place.

    Attributes:
        kind: ``object`` (class and attributes), ``inner`` (objects in a tuple, list or dictionary),
            ``own`` (class and its own ``saved_state``) or ``rng``.
        content: The state, in the form of the kind.
    """

    kind: str
    content: Any


Node = Any
"""A copy of data, or an `InPlace`."""
CONSTANT_NODE: Node = object()
"""The node of an object that cannot change, or was saved before."""


class SnapshotError(TwinError, ValueError):
    """A snapshot cannot be taken or restored."""


def save_node(thing: Any, seen: set[int]) -> Node:  # noqa: PLR0911  one line a kind
    """The node of a value; ``CONSTANT_NODE`` if it cannot change or was saved before."""
    if isinstance(thing, np.ndarray):
        return CONSTANT_NODE if thing.dtype.hasobject else thing.copy(order="K")
    if isinstance(thing, np.generic):
        return thing.item()
    if thing is None or type(thing) in {bool, int, float, str}:
        return thing
    if isinstance(thing, np.random.Generator):
        return InPlace("rng", thing.bit_generator.state)
    if isinstance(thing, tuple | list | deque):
        each = {index: save_node(one, seen) for index, one in enumerate(thing)}
        several = _combine(each)
        if several is not each:
            return several
        return tuple(each.values()) if isinstance(thing, tuple) else list(each.values())
    if isinstance(thing, dict):
        return _combine({key: save_node(each, seen) for key, each in thing.items()})
    if _is_constant(thing) or id(thing) in seen:
        return CONSTANT_NODE
    seen.add(id(thing))
    if hasattr(thing, "saved_state"):  # it defines its own state
        return InPlace("own", (type(thing).__name__, save_node(thing.saved_state(), seen)))
    nodes = {name: save_node(value, seen) for name, value in vars(thing).items()}
    kept = [
        (name, node)
        for name, node in nodes.items()
        if node is not CONSTANT_NODE and not (isinstance(thing, Rig) and name in RIG_SETTINGS)
    ]
    return InPlace("object", (type(thing).__name__, kept))


def _is_constant(thing: Any) -> bool:
    """Whether an object that is no data never changes."""
    parameters = getattr(thing, "__dataclass_params__", None)
    frozen = parameters is not None and parameters.frozen
    foreign = type(thing).__module__.partition(".")[0] in CONSTANT_PACKAGES
    closed = not hasattr(thing, "__dict__")  # of a compiled library
    return bool(frozen or foreign or closed or isinstance(thing, BaseModel | RigChanges | Enum))


def _combine(nodes: dict[Any, Node]) -> Node:
    """The node of a tuple, list or dictionary: all nodes if they are data, else the objects."""
    if not any(node is CONSTANT_NODE or isinstance(node, InPlace) for node in nodes.values()):
        return nodes
    inner = [(key, node) for key, node in nodes.items() if isinstance(node, InPlace)]
    return InPlace("inner", inner) if inner else CONSTANT_NODE


def restore(thing: Any, node: InPlace) -> None:
    """Restore the state of an object in place.

    Raises:
        SnapshotError: If the state is of a different object.
    """
    kind, content = node
    if kind in {"object", "own"}:
        name, content = content
        if name != type(thing).__name__:
            own = type(thing).__name__
            raise SnapshotError(
                f"the snapshot belongs to another kind of rig: it has {name}, this rig has {own}"
            )
    try:
        if kind == "rng":
            thing.bit_generator.state = content
        elif kind == "own":
            thing.restore_state(deepcopy(content))
        elif kind in {"object", "inner"}:
            for name, child in content:
                if isinstance(child, InPlace):
                    restore(getattr(thing, name) if kind == "object" else thing[name], child)
                else:
                    setattr(thing, name, _like(getattr(thing, name, None), deepcopy(child)))
    except SnapshotError:  # of something within
        raise
    except (AttributeError, LookupError, TypeError, ValueError) as error:
        raise SnapshotError(f"the snapshot belongs to another kind of rig: {error}") from error


def _like(present: Any, value: Any) -> Any:
    """A saved value in the form of the present one.

    A tuple gets its names, a queue its length; an equal array is kept, as products of matrices
    round differently for a different layout in memory.
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


@dataclass(frozen=True)
class Snapshot:
    """The whole state of a run at the beginning of a control period.

    Attributes:
        time: Time of the run, s.
        period: Control period in s.
        rig: State of the rigs.
        journal: Journal of the rigs.
        controller: State of law, observer and reference.
        measurement: The measurement that begins the period.
    """

    time: float
    period: float
    rig: Node
    journal: tuple[Entry, ...]
    controller: Node
    measurement: Node

    @classmethod
    def take(cls, rig: Rig, controller: Controller, measurement: Measurement) -> Snapshot:
        """The state of rigs and their controller, just after a measurement.

        Raises:
            SnapshotError: If it is not a simulated rig.
        """
        if not isinstance(rig, SimulatedRig):
            raise SnapshotError("only the state of a simulated rig can be saved")
        seen: set[int] = set()
        return cls(
            measurement.time,
            rig.period,
            save_node(rig, seen),
            tuple(rig.journal),
            save_node(controller, seen),
            save_node(tuple(measurement), seen),
        )

    def restore(self, rig: Rig, controller: Controller | None = None) -> Measurement:
        """Restore the state of rigs, and of their controller if it is the same.

        Args:
            rig: Rigs assembled from the scenario of the snapshot, switched on.
            controller: Their controller, made from that scenario.

        Returns:
            The measurement that begins the period.

        Raises:
            SnapshotError: If the rig is a different one.
        """
        if isinstance(rig.changes, RigChanges):
            rig.changes.catch_up(self.time - self.period)
        restore(rig, self.rig)
        rig.journal[:] = self.journal
        if controller is not None:
            restore(controller, self.controller)
        return self.measured

    @property
    def measured(self) -> Measurement:
        """The measurement that begins the period."""
        return Measurement(*deepcopy(self.measurement))
