"""Some rigs of a plant as a plant, for those that begin while the others go on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array, Mask, Number, put
from twin.sim.plant.interface import Plant


class SomeRigs:
    """Some rigs of a plant, that may be looked at and put somewhere; time passes for all alike.

    Args:
        plant: All of them.
        which: Numbers of those, shape (k,).
    """

    def __init__(self, plant: Plant, which: NDArray[np.integer]) -> None:
        self._plant, self._which = plant, which
        self.rigs, self.step, self.ratio = len(which), plant.step, plant.ratio
        self.channels = plant.channels

    def start(self, ball: Array, spin: Number = 0.0) -> None:
        """Put these rigs to the start with their balls at (x, x', y, y'), shape (k, 4)."""
        self._plant.begin(self._which, ball, spin)

    def begin(self, rigs: NDArray[np.integer], ball: Array, spin: Number = 0.0) -> None:
        """Put some of these to the start."""
        self._plant.begin(self._which[rigs], ball, spin)

    def place(self, ball: Array) -> None:
        """Put these balls at (x, x', y, y') on plates that stay as they are, shape (k, 4)."""
        self._plant.place(put(self._plant.state[:, (0, 1, 4, 5)], self._which, ball))

    def advance(self, motor_rate: Array, steps: int) -> None:
        """Not possible of some rigs alone.

        Raises:
            TypeError: Always.
        """
        raise TypeError("the rigs of a plant are advanced together")

    @property
    def state(self) -> Array:
        """Their true states, shape (k, 8)."""
        found: Array = self._plant.state[self._which]
        return found

    @property
    def motor(self) -> Array:
        """Their motor shaft angles in rad, shape (k, 2)."""
        found: Array = self._plant.motor[self._which]
        return found

    @property
    def on_plate(self) -> Mask:
        """Whether their balls are on the screen, shape (k,)."""
        found: Mask = self._plant.on_plate[self._which]
        return found

    @property
    def diverged(self) -> Mask:
        """Whether their numbers have run away, shape (k,)."""
        found: Mask = self._plant.diverged[self._which]
        return found

    def telemetry(self) -> Array:
        """Their further true quantities, shape (k, channels)."""
        found: Array = self._plant.telemetry()[self._which]
        return found
