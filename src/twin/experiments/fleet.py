"""Laws of any kind, and observers with and without a predictor, as the rigs of one batch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from controllers.interfaces import Law, Measurement, Reference
from controllers.smith import BALL, Smith
from controllers.stack import Controller

Array = NDArray[np.floating]


@dataclass(frozen=True)
class _Now(Reference):
    """What a reference is at the present instant."""

    value: Array

    def __call__(self, t: float | Array) -> Array:
        """The value."""
        return self.value


class Mixed(Law):
    """M laws side by side, each for a group of neighbouring rigs; short memories are padded.

    Args:
        laws: The laws.
        each: Rigs a group.
    """

    def __init__(self, laws: Sequence[Law], each: int) -> None:
        groups = [slice(each * i, each * (i + 1)) for i in range(len(laws))]
        object.__setattr__(self, "groups", list(zip(groups, laws, strict=True)))
        object.__setattr__(self, "memory", max(law.memory for law in laws))
        object.__setattr__(self, "model", laws[0].model)

    groups: list[tuple[slice, Law]]

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations in rad/s^2, shape (N, 2); the reference must be ``Paths``."""
        r = reference(t)
        u = np.empty((len(x), 2))
        for i, (own, law) in enumerate(self.groups):
            u[own] = law.control(t, x[own], _Now(r[:, i]), q[own, : law.memory])
        return u

    def memory_rate(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Time derivative of the memory, shape (N, memory)."""
        r = reference(t)
        slope = np.zeros_like(q)
        for i, (own, law) in enumerate(self.groups):
            if law.memory:
                mine = law.memory_rate(t, x[own], _Now(r[:, i]), q[own, : law.memory])
                slope[own, : law.memory] = mine
        return slope


@dataclass(kw_only=True)
class SomePredicted(Smith):
    """A Smith predictor for some rigs; the others' observer takes the ball as it is measured."""

    predicted: NDArray[np.bool_]
    """Which rigs have the predictor, shape (N,)."""

    def _look_back(self) -> Array:
        """Estimated ball a dead time ago; where nothing is predicted, that of now."""
        past: Array = np.where(self.predicted[:, None], super()._look_back(), self.x[..., BALL])
        return past

    def _look_back_each(self, periods: Array) -> Array:
        past: Array = np.where(
            self.predicted[:, None], super()._look_back_each(periods), self.x[..., BALL]
        )
        return past


class Watched(Controller):
    """A controller that leaves the estimate its command follows from in ``estimate``."""

    def command(self, measurement: Measurement) -> Array:
        """Wished plate rates in rad/s, shape (N, 2)."""
        wished = super().command(measurement)
        self.estimate = self.observer.x
        return wished
