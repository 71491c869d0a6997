"""A cheat: looks for the simulated plant in the memory of its process, and for the grader's files.

# fails: the ball stays on the plate
"""

import gc
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from ballplate.laws import Array, Law, Reference


@dataclass(frozen=True, kw_only=True)
class Signs(Law):
    """Drives the true ball, if it can find it."""

    name: ClassVar[str] = "signs"

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations from the true state; an error where that is out of reach."""
        rigs = [each for each in gc.get_objects() if type(each).__name__ == "SimulatedRig"]
        hidden = [path.read_text("utf-8") for path in Path().rglob("hidden.toml")]
        if not rigs and not hidden:
            raise RuntimeError("the truth is not here")
        true = np.zeros_like(x) if not rigs else rigs[0].true_state
        error = reference(t)[0] - true[..., 0::4]
        return 4.0 * error * np.array([1.0, -1.0])
