"""A linear model from one control tick to the next."""

from __future__ import annotations

import numpy as np
import scipy

from controllers.arrays import Array


def sample(A: Array, B: Array, T: float) -> tuple[Array, Array]:
    """Exact step x[k+1] = Ad x[k] + Bd u[k] of x' = A x + B u with u held over a period.

    Args:
        A: State matrix, shape (n, n).
        B: Input matrix, shape (n, m).
        T: Period in s.

    Returns:
        Ad, shape (n, n), and Bd, shape (n, m).
    """
    n, m = B.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = A, B
    step = scipy.linalg.expm(block * T)
    return step[:n, :n], step[:n, n:]
