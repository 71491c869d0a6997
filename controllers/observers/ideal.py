"""The state itself, from a simulated rig with ideal sensors: for laws without an observer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from controllers.arrays import Array
from controllers.interfaces import Measurement, Observer

RATES = slice(3, None, 4)
"""The plate rates phi', theta' in the state (5.5)."""


@dataclass(kw_only=True)
class Ideal(Observer):
    """Hands on the true state, but takes the plate rates from the input.

    The plate rates phi' and theta' are the integral of the applied input: the rate commanded, not
    the rate made. Feeding back the true one would close a loop through the resonance of plate and
    spring and can make it unstable; on the exact model the two are the same.
    """

    name: ClassVar[str] = "ideal"

    def correct(self, measurement: Measurement) -> Array:
        """The true state with commanded plate rates, shape (..., 8).

        Raises:
            ValueError: If the rig does not hand over its state.
        """
        if measurement.state is None:
            raise ValueError("observer 'ideal' needs a simulated rig with ideal sensors")
        x = np.array(measurement.state, dtype=float)
        x[..., RATES] = self.x[..., RATES]
        self.x = x
        return x

    def predict(self, u: Array) -> None:
        """Integrate the plate rates one period under the applied input u, shape (..., 2)."""
        x = self.x.copy()
        x[..., RATES] += self.period * u
        self.x = x
