"""Several cases as the rigs of one batch: each group of rigs has its own law and reference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from controllers.interfaces import Law, Reference

Array = NDArray[np.floating]


@dataclass(frozen=True)
class Paths(Reference):
    """M references side by side: the value at t has the shape (5, *shape(t), M, 2)."""

    members: tuple[Reference, ...]

    def __call__(self, t: float | Array) -> Array:
        """Positions and four derivatives of every member."""
        return np.stack([member(t) for member in self.members], axis=-2)


@dataclass(frozen=True)
class _Now(Reference):
    """What a reference is at the present instant, for a law that asks for no other."""

    value: Array

    def __call__(self, t: float | Array) -> Array:
        """The value."""
        return self.value


class Fleet(Law):
    """Laws side by side as one, each for a group of neighbouring rigs.

    Args:
        laws: The laws.
        each: Rigs a group.
    """

    groups: list[tuple[slice, Law]]

    def __init__(self, laws: Sequence[Law], each: int = 1) -> None:
        groups = [slice(each * i, each * (i + 1)) for i in range(len(laws))]
        object.__setattr__(self, "groups", list(zip(groups, laws, strict=True)))
        object.__setattr__(self, "memory", max(law.memory for law in laws))
        object.__setattr__(self, "model", laws[0].model)

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations in rad/s^2, shape (N, 2); the reference must be ``Paths``."""
        r = reference(t)
        u = np.empty((len(x), 2))
        for index, (own, law) in enumerate(self.groups):
            u[own] = law.control(t, x[own], _Now(r[:, index]), q[own, : law.memory])
        return u

    def memory_rate(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Time derivative of the memory, shape (N, memory); 0 where a law has less of it."""
        slope = np.zeros_like(q)
        if not self.memory:
            return slope
        r = reference(t)
        for index, (own, law) in enumerate(self.groups):
            if law.memory:
                path, mine = _Now(r[:, index]), q[own, : law.memory]
                slope[own, : law.memory] = law.memory_rate(t, x[own], path, mine)
        return slope
