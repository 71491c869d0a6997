"""The two array types of the project: numbers, and yes or no."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
"""Numbers; the last axis is the vector, the leading axes are rigs."""
Mask = NDArray[np.bool_]
"""Yes or no, one per rig."""
