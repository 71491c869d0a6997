"""An observer with a constant gain on the linear model (5.35), discrete in its current form."""

from __future__ import annotations

from dataclasses import dataclass, field

from controllers.arrays import Array
from controllers.interfaces import Measurement, Observer
from controllers.observers.innovation import innovation


@dataclass(kw_only=True)
class LinearObserver(Observer):
    """xhat[k] = xbar[k] + L (y[k] - C xbar[k]),  xbar[k+1] = A xhat[k] + B u[k].

    The estimate at a tick has that tick's measurement in it. A subclass designs A, B and L in its
    ``__post_init__``.
    """

    A: Array = field(init=False, repr=False)
    """State matrix of a step, shape (8, 8)."""
    B: Array = field(init=False, repr=False)
    """Input matrix of a step, shape (8, 2)."""
    L: Array = field(init=False, repr=False)
    """Gain of the current form, shape (8, 4)."""

    def correct(self, measurement: Measurement) -> Array:
        """Take in a measurement; without a touch only the plate angles correct."""
        self.x = self.x + innovation(measurement, self.x).dot(self.L.T)
        return self.x

    def predict(self, u: Array) -> None:
        """Carry the estimate one period ahead."""
        self.x = self.x.dot(self.A.T) + u.dot(self.B.T)
