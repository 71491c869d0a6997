"""Luenberger observer (7.1) on the linear model, designed by pole placement (7.4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from controllers.arrays import Array
from controllers.observers.innovation import OUTPUTS
from controllers.observers.linear import LinearObserver
from controllers.observers.placement import place_poles
from controllers.observers.sampling import sample
from controllers.poles import Pole, listed, stable_poles


@dataclass(kw_only=True)
class Luenberger(LinearObserver):
    """Linear observer with the error dynamics of given poles.

    With A, B the exact step of (5.35) over a period, the error obeys A (I - L C) and a linear
    plant is followed without bias. The two subsystems (x, phi) and (y, theta) are designed apart,
    each with eigenvalues exp(p T) for its continuous poles p. With two measurements each, poles do
    not fix L (nor do they fix the thesis's); the free part goes where Matlab's place, too, puts
    it: eigenvectors as orthogonal as possible, by the deterministic search of Yang and Tits.

    Raises:
        ValueError: If the poles are not four or eight, not stable, not in conjugate pairs, or if
            more than two of a subsystem coincide.
    """

    name: ClassVar[str] = "luenberger"

    poles: tuple[Pole, ...] = (-8, -10, -14, -16)
    """Poles of the error in 1/s: four for each subsystem alike, or eight, for (x, phi) and then
    for (y, theta). By default (8.1)."""

    def __post_init__(self) -> None:
        """Design the gain."""
        super().__post_init__()
        A, B, _ = self.model.linear()
        self.A, self.B = sample(A, B, self.period)
        self.L = np.zeros((8, 4))
        for axis, mine in enumerate(axis_poles(self.poles)):
            states, outputs = slice(4 * axis, 4 * axis + 4), slice(2 * axis, 2 * axis + 2)
            self.L[states, outputs] = current_gain(self.A[states, states], mine, self.period)


def axis_poles(poles: Sequence[Pole]) -> tuple[tuple[Pole, ...], tuple[Pole, ...]]:
    """Four poles for x and four for y of four for both or of eight, once checked."""
    if len(poles) not in (4, 8):
        raise ValueError(f"poles must be 4 or 8 numbers, got {len(poles)}")
    return stable_poles(poles[:4], 4), stable_poles(poles[-4:], 4)


def current_gain(A: Array, poles: Sequence[Pole], T: float) -> Array:
    """Gain L that gives A (I - L C) the eigenvalues exp(p T), C picking every other state.

    Args:
        A: State matrix of a step of one subsystem, shape (4, 4).
        poles: Continuous poles p in 1/s, shape (4,).
        T: Period in s.

    Returns:
        Shape (4, 2).

    Raises:
        ValueError: If more than two poles coincide.
    """
    if max(map(poles.count, poles)) > 2:
        raise ValueError(f"poles may coincide in pairs, no more, got {listed(poles)}")
    C = np.eye(4)[OUTPUTS]
    return np.linalg.solve(A, place_poles(A.T, C.T, np.exp(np.array(poles) * T)).T)
