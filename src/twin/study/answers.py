"""Statistics of a study's rows: sensitivity indices, curves, spreads, and their intervals."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from SALib.analyze import morris, sobol
from scipy import stats

from controllers.arrays import Array
from twin.study.schema import Point, Study
from twin.study.work import LEVELS, SEED, Design, Work, problem, quantiles


@dataclass(frozen=True)
class SensitivityIndex:
    """How much one parameter matters.

    Attributes:
        key: The parameter.
        value: Total Sobol index, or Morris's mu* in units of the metric, or Spearman's rank
            correlation.
        half: Half-width of its 95 % interval; NaN if there is none. Bootstrap for Sobol and Morris.
        first: First-order Sobol index, or Morris's sigma; NaN for others.
        decided: Whether the interval excludes zero.
    """

    key: str
    value: float
    half: float
    first: float
    decided: bool


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
        curves: For one-at-a-time and grid studies.
        notes: What was left out, in words.
        values: The metric of each run, NaN for runs that failed, shape (K,).
    """

    variant: str
    whole: Spread
    indices: tuple[SensitivityIndex, ...] = ()
    curves: tuple[Curve, ...] = ()
    notes: tuple[str, ...] = ()
    values: Array = field(default_factory=lambda: np.zeros(0))


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
        if study.method in {"sobol", "morris", "lhs", "montecarlo"}:
            # a mean over the seeds of each point, NaN where a run failed
            mean = np.bincount(at, values) / np.bincount(at)
            indices = _indices(study, design, mean, notes)
        curves = _curves(study, design[at], values) if study.method in {"grid", "oat"} else ()
        whole = spread(values)
        found.append(Answer(variant.name, whole, indices, curves, tuple(notes), values))
    return found


def spread(values: Array) -> Spread:
    """Median and quantiles of finished runs, and the probability of failure.

    Args:
        values: A metric, NaN for runs that failed, shape (K,).
    """
    good = values[np.isfinite(values)]
    failed = len(values) - len(good)
    chance = stats.binomtest(failed, max(len(values), 1)).proportion_ci(method="wilson")
    middle, low, high = (
        np.quantile(good, (0.5, 0.05, 0.95)).tolist() if len(good) else (np.nan,) * 3
    )
    return Spread(middle, low, high, len(values), failed, (float(chance.low), float(chance.high)))


def _indices(
    study: Study, design: Design, mean: Array, notes: list[str]
) -> tuple[SensitivityIndex, ...]:
    keys = list(study.parameters)
    if study.method in {"lhs", "montecarlo"}:
        return _ranks(design, mean)
    block = len(keys) + (2 if study.method == "sobol" else 1)
    whole = np.asarray(np.isfinite(mean).reshape(-1, block).all(axis=1))
    if not whole.all():
        notes.append(
            f"{int((~whole).sum())} of {len(whole)} blocks left out, because a run in them failed"
        )
    if whole.sum() < 4:
        notes.append("too few whole blocks for indices")
        return ()
    kept = np.repeat(whole, block)
    if study.method == "morris":
        got = morris.analyze(
            problem(study), quantiles(study)[kept], mean[kept], num_levels=LEVELS, seed=SEED
        )
        triples = zip(got["mu_star"], got["mu_star_conf"], got["sigma"], strict=True)
    else:
        got = sobol.analyze(problem(study), mean[kept], calc_second_order=False, seed=SEED)
        triples = zip(got["ST"], got["ST_conf"], got["S1"], strict=True)
    return tuple(
        SensitivityIndex(key, float(value), float(half), float(first), bool(value - half > 0))
        for key, (value, half, first) in zip(keys, triples, strict=True)
    )


def _ranks(design: Design, mean: Array) -> tuple[SensitivityIndex, ...]:
    found = []
    good = np.isfinite(mean)
    for key, column in design.columns.items():
        numeric = all(type(value) in {float, int} for value in column.tolist())
        if good.sum() < 5 or not numeric:
            continue
        settings = column.astype(float)
        rank = float(stats.spearmanr(settings[good], mean[good]).statistic)
        # Fisher's transformation, with the variance of a rank correlation (Fieller et al. 1957)
        reach = np.arctanh(np.clip(rank, -0.9999, 0.9999))
        width = 1.96 * np.sqrt(1.06 / (good.sum() - 3))
        low, high = np.tanh((reach - width, reach + width))
        decided = bool(low * high > 0)
        half = float(high - low) / 2
        found.append(SensitivityIndex(key, rank, half, np.nan, decided))
    return tuple(found)


def _curves(study: Study, at: Design, values: Array) -> tuple[Curve, ...]:
    """Of a grid: over its first parameter, one curve per combination of the others."""
    keys = list(study.parameters)
    if study.method == "oat":
        return tuple(_curve(study, key, {}, at, values) for key in keys)
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
        line: Any = stats.linregress(np.array(steps, float)[known], np.array(means)[known])
        slope = float(line.slope)
    return Curve(key, where, tuple(steps), tuple(spreads), slope)
