"""Differences between variants that met the same points with the same noise."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from controllers.arrays import Array
from twin.study.schema import Method

Numbers = NDArray[np.integer]


@dataclass(frozen=True)
class PairedDifference:
    """How a metric differs between two variants, run by run.

    Attributes:
        first: Name of a variant.
        second: Name of the other.
        mean: Mean of first minus second over the runs that both finished; NaN without any.
        half: Half-width of its 95 % interval; NaN where the design gives none.
        better: Runs in which the first has the smaller metric, or alone finished.
        worse: Runs in which the second has.
        both_failed: Runs that neither finished.
    """

    first: str
    second: str
    mean: float
    half: float
    better: int
    worse: int
    both_failed: int


def student_half_width(estimates: Array) -> Array:
    """Half-width of the 95 % interval of a mean of independent estimates, shape (...).

    Args:
        estimates: Shape (R, ...), R at least 2.
    """
    count = len(estimates)
    factor = scipy.stats.t.ppf(0.975, count - 1) / np.sqrt(count)
    return np.asarray(factor * estimates.std(axis=0, ddof=1))


def paired_differences(
    values: Sequence[tuple[str, Array]], point_of_run: Numbers, method: Method, per_block: int
) -> Iterator[PairedDifference]:
    """The difference of every pair of variants, in their order.

    The interval is Student's t over what is independent: points that were drawn one by one
    (``montecarlo``, and ``lhs``, for which it is wide), the two points drawn in each block of a
    ``sobol`` design, or the noises of a ``grid``, which has chosen points.

    Args:
        values: Name of a variant and its metric, NaN for a failed run, shape (K,), the runs of all
            variants in the same order.
        point_of_run: Number of the point of each run, shape (K,), from 0 on.
        method: How the points were chosen.
        per_block: Points of a block of a ``sobol`` design.
    """
    for (first, one), (second, other) in itertools.combinations(values, 2):
        finished = np.isfinite(one), np.isfinite(other)
        both = finished[0] & finished[1]
        difference = np.where(both, one - other, np.nan)
        better = both & (one < other) | finished[0] & ~finished[1]
        worse = both & (one > other) | finished[1] & ~finished[0]
        independent = _independent(difference, point_of_run, method, per_block)
        yield PairedDifference(
            first,
            second,
            float(difference[both].mean()) if both.any() else math.nan,
            float(student_half_width(independent)) if len(independent) > 1 else math.nan,
            int(better.sum()),
            int(worse.sum()),
            int((~finished[0] & ~finished[1]).sum()),
        )


def _independent(difference: Array, point: Numbers, method: Method, per_block: int) -> Array:
    """Means of a difference that are independent of each other, shape (M,); NaN is left out."""
    if method == "grid":
        noises = len(difference) // (int(point.max()) + 1)
        by_noise = difference.reshape(-1, noises)
        return np.asarray([each.mean() for each in by_noise.T if np.isfinite(each).all()])
    kept = np.isfinite(difference)
    if method == "sobol":
        place = point % per_block
        kept &= (place == 0) | (place == per_block - 1)
    count = np.bincount(point[kept])
    total = np.bincount(point[kept], difference[kept])
    return np.asarray(total[count > 0] / count[count > 0])
