"""Several cases as the rigs of one batch: each group of rigs has its own law and reference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from controllers.arrays import Array
from controllers.interfaces import Law, Reference


@dataclass(frozen=True)
class Paths(Reference):
    """M references side by side: the value at t has the shape (5, *shape(t), M * each, 2)."""

    members: tuple[Reference, ...]
    each: int = 1
    """Neighbouring rigs that follow the same reference."""

    def __call__(self, t: float | Array) -> Array:
        """Positions and four derivatives of every rig's reference."""
        return np.stack([member(t) for member in self.members], axis=-2).repeat(self.each, axis=-2)


@dataclass(frozen=True)
class Now(Reference):
    """What a reference is at the present instant, for a law that asks for no other."""

    value: Array

    def __call__(self, t: float | Array) -> Array:
        """The value."""
        return self.value


class Fleet(Law):
    """Laws side by side as one, each for a group of neighbouring rigs.

    Neighbours that share one law object are calculated together.

    Args:
        laws: The laws.
        each: Rigs a law.
    """

    groups: list[tuple[slice, Law]]

    def __init__(self, laws: Sequence[Law], each: int = 1) -> None:
        groups, begin = [], 0
        for _, same in groupby(laws, key=id):
            shared = list(same)
            groups.append((slice(begin, begin + each * len(shared)), shared[0]))
            begin += each * len(shared)
        object.__setattr__(self, "groups", groups)
        object.__setattr__(self, "memory", max(law.memory for law in laws))
        object.__setattr__(self, "model", laws[0].model)

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations in rad/s^2, shape (N, 2); the reference must be ``Paths``."""
        r = reference(t)
        u = np.empty((len(x), 2))
        for own, law in self.groups:
            u[own] = law.control(t, x[own], Now(r[:, own]), q[own, : law.memory])
        return u

    def memory_rate(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Time derivative of the memory, shape (N, memory); 0 where a law has less of it."""
        slope = np.zeros_like(q)
        if not self.memory:
            return slope
        r = reference(t)
        for own, law in self.groups:
            if law.memory:
                mine = q[own, : law.memory]
                slope[own, : law.memory] = law.memory_rate(t, x[own], Now(r[:, own]), mine)
        return slope
