"""Answers of a study: spreads, sensitivity indices and curves of its metrics, from its rows."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import scipy
from numpy.typing import NDArray

from controllers.arrays import Array, Mask
from twin.study.paired import student_half_width
from twin.study.schema import Point, Study
from twin.study.work import Design, Work, sobol_designs

NEGLIGIBLE_INDEX = 0.01
"""Index below which a parameter is called negligible."""


@dataclass(frozen=True)
class SensitivityIndex:
    """How much one parameter matters.

    Attributes:
        key: The parameter.
        value: Total Sobol index, or Spearman's rank correlation.
        half: Half-width of its 95 % interval; NaN if there is none. For Sobol indices Student's t
            over the estimates of independent designs.
        first: First-order Sobol index; NaN for others.
        decided: Whether the interval excludes zero.
    """

    key: str
    value: float
    half: float
    first: float
    decided: bool

    @property
    def negligible(self) -> bool:
        """Whether the whole interval is below ``NEGLIGIBLE``."""
        return abs(self.value) + self.half < NEGLIGIBLE_INDEX

    @property
    def matters(self) -> bool:
        """Whether it is known to differ from zero, and is not negligible."""
        return self.decided and abs(self.value) >= NEGLIGIBLE_INDEX


@dataclass(frozen=True)
class Spread:
    """Distribution of the metric of one variant at one point, or over all points.

    Attributes:
        median: Of the finished runs; NaN without any.
        low: Their 5 % quantile.
        high: Their 95 % quantile.
        runs: Number of runs.
        failed: Number of those that did not finish; they are left out of the quantiles.
        chance: 95 % interval of the probability of failure.
    """

    median: float
    low: float
    high: float
    runs: int
    failed: int
    chance: tuple[float, float]


@dataclass(frozen=True)
class Curve:
    """A metric over the values of one parameter.

    Attributes:
        key: The parameter.
        where: Values of the other parameters.
        values: Its values.
        spreads: The metric at each.
        slope: Change of the metric per unit of the parameter; None if it is not numeric.
    """

    key: str
    where: Point
    values: tuple[float | str, ...]
    spreads: tuple[Spread, ...]
    slope: float | None


@dataclass(frozen=True)
class Answer:
    """The results of one variant.

    Attributes:
        variant: Its name.
        whole: Distribution of the metric over all points.
        indices: One per parameter, for methods that have indices.
        curves: For grid studies.
        notes: What was left out, in words.
        values: The metric of each run, NaN for runs that failed, shape (K,).
        points: Number of the point of each run, shape (K,).
        inputs: Value of each parameter in each run, shape (K,), by key.
    """

    variant: str
    whole: Spread
    indices: tuple[SensitivityIndex, ...] = ()
    curves: tuple[Curve, ...] = ()
    notes: tuple[str, ...] = ()
    values: Array = field(default_factory=lambda: np.zeros(0))
    points: NDArray[np.integer] = field(default_factory=lambda: np.zeros(0, int))
    inputs: Mapping[str, NDArray[Any]] = field(default_factory=dict)


def answers(work: Work, rows: pa.Table) -> list[Answer]:
    """One answer per variant, for the study's first metric.

    Args:
        work: The runs.
        rows: One row per run: outcome and metrics.
    """
    study, design = work.study, work.design
    # NaN for runs that did not finish
    good = np.array(pc.equal(rows["outcome"], "finished"), bool)
    every = np.where(good, np.array(rows[study.metrics[0]], float), np.nan)
    found = []
    for variant in study.compared:
        places = [place for place, task in enumerate(work.tasks) if task.variant == variant.name]
        at, values = np.array([work.tasks[place].point for place in places]), every[places]
        notes: list[str] = []
        indices: tuple[SensitivityIndex, ...] = ()
        if study.method != "grid":
            # a mean over the seeds of each point, NaN where a run failed
            mean = np.bincount(at, values) / np.bincount(at)
            indices = _indices(study, design, mean, notes)
        curves = _curves(study, design[at], values) if study.method == "grid" else ()
        failing = np.bincount(at, ~np.isfinite(values)) / np.bincount(at)
        if study.method == "sobol":  # the other rows of a block share its two points
            failing = failing.reshape(-1, len(study.parameters) + 2)[:, [0, -1]].ravel()
        whole = spread(values, failing)
        more = {"values": values, "points": at, "inputs": design[at].columns}
        found.append(Answer(variant.name, whole, indices, curves, tuple(notes), **more))
    return found


def spread(values: Array, failing: Array | None = None) -> Spread:
    """Median and quantiles of finished runs, and the probability of failure.

    Args:
        values: A metric, NaN for runs that failed, shape (K,).
        failing: Share of failed runs at each independently drawn point, shape (P,); None if every
            run is a point of its own.
    """
    finished = np.isfinite(values)
    good = values[finished]
    middle, low, high = (
        np.quantile(good, (0.5, 0.05, 0.95)).tolist() if len(good) else (np.nan,) * 3
    )
    chance = wilson(~finished if failing is None else failing)
    return Spread(middle, low, high, len(values), len(values) - len(good), chance)


def wilson(failing: Array | Mask) -> tuple[float, float]:
    """Wilson's 95 % interval of a probability from independent draws.

    Args:
        failing: Of each draw whether it failed, or the share of its runs that did, shape (P,).
    """
    count = max(len(failing), 1)
    share, z = failing.sum() / count, scipy.stats.norm.ppf(0.975)
    middle = (share + z**2 / (2 * count)) / (1 + z**2 / count)
    reach = z * np.sqrt(share * (1 - share) / count + (z / (2 * count)) ** 2) / (1 + z**2 / count)
    return max(0.0, float(middle - reach)), min(1.0, float(middle + reach))


def _indices(
    study: Study, design: Design, mean: Array, notes: list[str]
) -> tuple[SensitivityIndex, ...]:
    keys = list(study.parameters)
    if study.method in {"lhs", "montecarlo"}:
        return _ranks(design, mean)
    block = len(keys) + 2
    blocks = mean.reshape(sobol_designs(study), -1, block)
    whole = np.asarray(np.isfinite(blocks).all(axis=-1))
    if not whole.all():
        notes.append(
            f"{int((~whole).sum())} of {whole.size} blocks left out, because a run in them failed"
        )
    used = [each[kept] for each, kept in zip(blocks, whole, strict=True) if kept.sum() >= 2]
    if len(used) < 2:
        notes.append("too few whole blocks for indices")
        return ()
    if not all(np.ptp(each[:, [0, -1]]) > 0 for each in used):
        notes.append("no indices, because the runs of a design do not differ")
        return ()
    first, total, halves = sobol_indices(used)
    return tuple(
        SensitivityIndex(key, float(value), float(half), float(one), bool(value - half > 0))
        for key, value, half, one in zip(keys, total, halves, first, strict=True)
    )


def sobol_indices(designs: Sequence[Array]) -> tuple[Array, Array, Array]:
    """First-order and total Sobol indices, and half-widths of the total ones, shape (d,) each.

    Saltelli et al. (2010), Table 2, (b) about the mean and (f). Numerators and variances are means
    over the designs, as the mean of their quotients would be too large; the interval is Student's t
    over what each design leaves of the quotient (the delta method).

    Args:
        designs: Of each its values: of each base sample at A, at A with one coordinate of B after
            the other, and at B, shape (n, d + 2).
    """
    parts = []
    for values in designs:
        at_a, mixed, at_b = values[:, :1], values[:, 1:-1], values[:, -1:]
        ends = np.concatenate((at_a, at_b))
        first = ((at_b - ends.mean()) * (mixed - at_a)).mean(axis=0)
        parts.append((first, ((at_a - mixed) ** 2).mean(axis=0) / 2, ends.var(keepdims=True)[0]))
    first, total, variance = (np.array(each) for each in zip(*parts, strict=True))
    whole = variance.mean()
    value = total.mean(axis=0) / whole
    return first.mean(axis=0) / whole, value, student_half_width((total - value * variance) / whole)


def _ranks(design: Design, mean: Array) -> tuple[SensitivityIndex, ...]:
    found = []
    good = np.isfinite(mean)
    for key, column in design.columns.items():
        numeric = all(type(value) in {float, int} for value in column.tolist())
        if good.sum() < 5 or not numeric:
            continue
        settings = column.astype(float)
        rank = float(scipy.stats.spearmanr(settings[good], mean[good]).statistic)
        # Fisher's transformation, with the variance of a rank correlation (Fieller et al. 1957)
        reach = np.arctanh(np.clip(rank, -0.9999, 0.9999))
        width = 1.96 * np.sqrt(1.06 / (good.sum() - 3))
        low, high = np.tanh((reach - width, reach + width)).tolist()
        found.append(SensitivityIndex(key, rank, (high - low) / 2, np.nan, low * high > 0))
    return tuple(found)


def _curves(study: Study, at: Design, values: Array) -> tuple[Curve, ...]:
    """Over the first parameter, one curve per combination of the others."""
    keys = list(study.parameters)
    others = [
        [(key, value) for value in study.parameters[key].steps(study.samples)] for key in keys[1:]
    ]
    return tuple(
        _curve(study, keys[0], dict(chosen), at, values) for chosen in itertools.product(*others)
    )


def _curve(study: Study, key: str, where: Point, at: Design, values: Array) -> Curve:
    steps = study.parameters[key].steps(study.samples)
    spreads, means = [], []
    for value in steps:
        point = {key: value, **where}
        there = np.logical_and.reduce([at.columns[name] == each for name, each in point.items()])
        spreads.append(spread(values[there]))
        good = values[there][np.isfinite(values[there])]
        means.append(good.mean() if len(good) else np.nan)
    known = np.isfinite(means)
    slope = None
    if all(isinstance(value, int | float) for value in steps) and known.sum() >= 3:
        line: Any = scipy.stats.linregress(np.array(steps, float)[known], np.array(means)[known])
        slope = float(line.slope)
    return Curve(key, where, tuple(steps), tuple(spreads), slope)
