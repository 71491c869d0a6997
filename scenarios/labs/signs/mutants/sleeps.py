"""A mistake: it waits in every period, as for a device that answers slowly.

# fails: the ball stays on the plate
"""

import time
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ballplate.laws import Array, Law, Reference


@dataclass(frozen=True, kw_only=True)
class Signs(Law):
    """Sleeps a second a period."""

    name: ClassVar[str] = "signs"

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Nothing, late."""
        time.sleep(1.0)
        return np.zeros((*x.shape[:-1], 2))
