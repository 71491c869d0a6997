"""What a measurement says beyond the estimate, the drive of every observer of chapter 7."""

from __future__ import annotations

from controllers.arrays import Array, every
from controllers.interfaces import Measurement

OUTPUTS = slice(0, None, 2)
"""h(x) = (x, phi, y, theta) of (5.7) as a slice of the state: unlike a list of indices, a view."""


def innovation(measurement: Measurement, x: Array) -> Array:
    """Difference y - h(x) of (7.1), (7.9); zero for a ball that the screen does not feel.

    Args:
        measurement: What the rig handed over.
        x: Predicted state at the same time, shape (..., 8).

    Returns:
        Shape (..., 4), in m and rad.
    """
    e = measurement.y - x[..., OUTPUTS]
    if not every(measurement.touched):
        e[~measurement.touched, 0::2] = 0
    return e
