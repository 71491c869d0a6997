"""Which record some files speak of."""

from __future__ import annotations

from zlib import crc32

import numpy as np

from controllers.arrays import Array


def fingerprint(x: Array, y: Array) -> int:
    """Tells one record from another, by the measured ball, shape (K,) each."""
    return crc32(np.ascontiguousarray(np.stack((x, y)), dtype=float).tobytes())
