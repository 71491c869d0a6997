"""Scores of an entry of the public benchmark, relative to the reference law's errors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import scipy

from controllers.arrays import Array

EFFORT_METRIC = "u_rms"
"""The indicator of a run that is its effort, rad/s^2."""


@dataclass(frozen=True, kw_only=True)
class Scoring:
    """How the errors of an entry become scores.

    Attributes:
        trimmed_share: Share of the lowest and of the highest errors that the mean leaves out.
        worst_share: Share of the highest errors; their mean is the score ``worst``.
        interval_quantiles: Quantiles at the ends of an interval.
        bootstrap_draws: Samples of the bootstrap.
        stratum_key: The rigs with equal values of this key are resampled among themselves.
        platform_tolerance: Relative difference of an error that a different platform may make:
            friction magnifies last bits.
    """

    trimmed_share: float = 0.25
    worst_share: float = 0.1
    interval_quantiles: tuple[float, float] = (0.025, 0.975)
    bootstrap_draws: int = 2000
    stratum_key: str = "sensors.touch.frame_rate"
    platform_tolerance: float = 0.02

    @property
    def confidence(self) -> float:
        """Confidence of an interval."""
        low, high = self.interval_quantiles
        return high - low


SCORING = Scoring()


class BenchScore(NamedTuple):
    """The scores of an entry in a task; errors are relative to the reference law's.

    Attributes:
        task: Name of the task.
        error: Interquartile mean of the relative error over all rigs and noises.
        low: Lower end of its 95 % interval, by bootstrap over the rigs.
        high: Upper end.
        worst: Mean of the worst tenth.
        kept: Number of rigs on which no ball was lost.
        kept_low: Lower end of Wilson's 95 % interval of the share of such rigs.
        kept_high: Upper end.
        effort: Median of the RMS control effort, rad/s^2.
    """

    task: str
    error: float
    low: float
    high: float
    worst: float
    kept: int
    kept_low: float
    kept_high: float
    effort: float


def interquartile(errors: Array, scoring: Scoring = SCORING, axis: int | None = None) -> Any:
    """The mean without the lowest and the highest quarter."""
    return scipy.stats.trim_mean(errors, scoring.trimmed_share, axis=axis)


def interval(
    errors: Array, strata: Sequence[Any], scoring: Scoring = SCORING
) -> tuple[float, float]:
    """The 95 % interval of the interquartile mean: rigs resampled within their strata.

    Args:
        errors: Relative errors, shape (rigs, noises).
        strata: The stratum of each rig.
        scoring: Number of samples, and the confidence.
    """
    rng, rigs = np.random.default_rng(0), np.array([repr(each) for each in strata])
    places = [np.flatnonzero(rigs == each) for each in np.unique(rigs)]
    count = scoring.bootstrap_draws
    drawn = [each[rng.integers(len(each), size=(count, len(each)))] for each in places]
    means = interquartile(errors[np.hstack(drawn)].reshape(count, -1), scoring, axis=1)
    low, high = np.quantile(means, scoring.interval_quantiles)
    return float(low), float(high)


def compare_runs(
    rows: pd.DataFrame,
    expected: Array,
    metric: str,
    what: str,
    free: Array | float = 0.0,
    unit: str = "m",
    tolerance: float = SCORING.platform_tolerance,
) -> Iterator[str]:
    """Describe the runs with an error unlike the expected one, beyond platform differences.

    Args:
        rows: The runs.
        expected: The error of each, in the unit.
        metric: The column that has it.
        what: Name of the law for the message.
        free: Difference of an error that is allowed besides the tolerance, in the unit.
        unit: Unit of the column.
        tolerance: Relative difference that is allowed.
    """
    free = np.broadcast_to(free, len(rows))
    for row, wanted, by in zip(rows.itertuples(), np.asarray(expected, float), free, strict=True):
        value = getattr(row, metric)
        if not np.isclose(value, wanted, rtol=tolerance, atol=by, equal_nan=True):
            where = f"{what}: {row.task}, rig {row.rig}, noise {row.noise}"
            yield f"{where}: {value:.9g} {unit}, expected {wanted:.9g} {unit}"
