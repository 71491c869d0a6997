"""Statistics of the mechanism from few of its runs and many of the exact equations.

The exact equations are a control variate (Lavenberg, Welch 1981; with few dear and many cheap runs
Peherstorfer, Willcox, Gunzburger 2016). With means over n points on both plants and over N further
points on the exact equations alone,

    mean(mechanism) + c (mean(exact, N) - mean(exact, n)),    c = slope / (1 + n / N),

has the mean of the mechanism for every c: what the exact equations get wrong costs width, and is no
error. Other statistics are means of what each point adds to them.

An array of points comes with the number of the independent unit of each: of points that were drawn
one by one the point, of a Sobol study its design.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from controllers.arrays import Array

Numbers = NDArray[np.integer]
CONFIDENCE_LEVEL = 0.95


class Estimate(NamedTuple):
    """A number with its 95 % interval."""

    value: float
    low: float
    high: float

    @property
    def width(self) -> float:
        """Width of the interval."""
        return self.high - self.low


class Points(NamedTuple):
    """What points add to a statistic.

    Attributes:
        values: Its mean is the statistic, shape (K,).
        units: Number of the independent unit of each, shape (K,).
    """

    values: Array
    units: Numbers

    def mean(self, fitted: int = 0) -> tuple[float, float, int]:
        """Mean, its variance, and degrees of freedom.

        Args:
            fitted: Numbers that were fitted to the points, where each is a unit of its own.
        """
        mean = float(self.values.mean())
        total = np.bincount(self.units, self.values - mean)
        total = total[np.bincount(self.units) > 0]
        count = len(total)
        freedom = count - 1 - (fitted if count == len(self.values) else 0)
        if freedom < 1:
            return mean, math.nan, 0
        spread = float((total**2).sum()) / len(self.values) ** 2
        return mean, count * spread / freedom, freedom


def estimate_mean(points: Points) -> Estimate:
    """The mean of points, with Student's t over their units."""
    return _interval(*points.mean())


def combine(own: Points, paired: Array, wide: Points) -> Estimate:
    """The mean of the mechanism from both plants.

    Args:
        own: Points on the mechanism.
        paired: The same points on the exact equations.
        wide: Further, independent points on the exact equations.
    """
    slope = _slope(paired, own.values) / (1 + len(paired) / len(wide.values))
    rest, variance, freedom = Points(own.values - slope * paired, own.units).mean(fitted=1)
    mean, wide_variance, wide_freedom = wide.mean()
    wide_variance *= slope**2
    both = variance + wide_variance
    if both > 0:  # Welch and Satterthwaite
        parts = variance**2 / max(freedom, 1) + wide_variance**2 / max(wide_freedom, 1)
        return _interval(rest + slope * mean, both, both**2 / parts)
    return _interval(rest + slope * mean, both, freedom)


def _slope(x: Array, y: Array) -> float:
    along = x - x.mean()
    square = float((along**2).sum())
    return float((along * y).sum()) / square if square > 0 else 0.0


def _interval(value: float, variance: float, freedom: float) -> Estimate:
    if not freedom or math.isnan(variance):
        return Estimate(value, -math.inf, math.inf)
    half = float(stats.t.ppf(0.5 + CONFIDENCE_LEVEL / 2, freedom)) * math.sqrt(variance)
    return Estimate(value, value - half, value + half)


def correlation(own: Array, paired: Array) -> float:
    """Pearson's correlation; NaN where one does not vary."""
    if len(own) < 3 or np.ptp(own) == 0 or np.ptp(paired) == 0:
        return math.nan
    return float(np.corrcoef(own, paired)[0, 1])


def estimate_quantile(
    share: float, own: Points, paired: Array | None = None, wide: Points | None = None
) -> Estimate:
    """A quantile of the mechanism: where its distribution, of one plant or both, reaches a share.

    Its interval ends where the distribution reaches the share less and plus the half-width of the
    interval that the distribution has there (Woodruff 1952). An end that no point reaches is
    infinite.

    Args:
        share: Between 0 and 1.
        own: Points on the mechanism.
        paired: The same points on the exact equations; None for an estimate without these.
        wide: Further points on the exact equations.
    """
    ordered = np.sort(own.values)
    at = 0.0 if wide is None else float(np.quantile(wide.values, share))

    def below(place: int) -> Estimate:
        under = Points((own.values <= ordered[place]).astype(float), own.units)
        if paired is None or wide is None:
            return estimate_mean(under)
        known = Points((wide.values <= at).astype(float), wide.units)
        return combine(under, (paired <= at).astype(float), known)

    def first(reached: float) -> int:
        return bisect_left(
            range(len(ordered)), True, key=lambda place: below(place).value >= reached
        )

    middle = min(first(share), len(ordered) - 1)
    half = below(middle).width / 2
    low, high = first(share - half), first(share + half)
    return Estimate(
        float(ordered[middle]),
        float(ordered[low]) if half > 0 and low > 0 else -math.inf,
        float(ordered[high]) if half > 0 and high < len(ordered) else math.inf,
    )


def index_parts(blocks: Array) -> Array:
    """What each block of a Sobol study adds to the total index of each parameter, shape (B, d).

    Their mean is the index; they are its linearisation about the means of numerator and variance
    (the delta method).

    Args:
        blocks: Values at A, at A with one coordinate of B after the other, and at B, shape
            (B, d + 2).
    """
    at_a, mixed, at_b = blocks[:, :1], blocks[:, 1:-1], blocks[:, -1:]
    ends = np.concatenate((at_a, at_b), axis=1)
    variances = ((ends - ends.mean()) ** 2).mean(axis=1, keepdims=True)
    totals = (at_a - mixed) ** 2 / 2
    whole = variances.mean()
    value = totals.mean(axis=0) / whole
    return np.asarray(value + (totals - value * variances) / whole)
