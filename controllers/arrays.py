"""The two array types of the project: numbers, and yes or no."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
"""Numbers; the last axis is the vector, the leading axes are rigs."""
Mask = NDArray[np.bool_]
"""Yes or no, one per rig."""
Number = float | Array
"""A number for all rigs, or one per rig, shape (N,)."""


def column(value: Number) -> Number:
    """A number as it is, one per rig as a column, shape (N, 1), beside arrays (N, axes)."""
    return value[:, None] if isinstance(value, np.ndarray) and value.ndim else value
