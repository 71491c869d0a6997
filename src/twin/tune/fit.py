"""A fit from end to end: least squares, leaving each group out, spread, verdicts, its page.

Least squares (SciPy's) begin at the best of samples that are drawn before any number
is looked at. A fit knows the cells it was given and nothing else.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from controllers.analysis import number
from controllers.arrays import Array, Mask
from twin.base import page
from twin.base.errors import plural
from twin.base.page import Block, Table, Verdict, digits
from twin.base.writing import write_json
from twin.tune.cells import (
    Cell,
    FitTable,
    Runs,
    Sample,
    cells,
    compute_cells,
    residuals,
    round_sample,
    shares,
)

SAMPLES_PER_PARAMETER = 8
"""Samples drawn for each parameter and search where the table does not say how many."""
DERIVATIVE_STEP = 0.03
"""Half of the difference that derivatives are taken over, as a share of the ranges."""
SEARCH_STEP = 0.08
"""The same on the way: smaller ones end in the ripple that friction and play make."""
SEARCH_TOLERANCE = 1e-3
"""Fall of chi-squared in a step, or its length, as shares, at which a search is at its end."""


def search_from(
    table: FitTable, numbers: tuple[Cell, ...], start: Sample, runs: Runs
) -> tuple[float, Sample]:
    """Least squares from a start: the least sum of squared residuals of cells, and where it is.

    Raises:
        TwinError: If a run cannot be carried out.
    """

    def off(at: Array) -> Array:
        sample = round_sample(at, table)
        return misfits(numbers, [sample], runs)[sample]

    def slopes(at: Array) -> Array:
        return jacobian(table, numbers, round_sample(at, table), runs, SEARCH_STEP)

    found = scipy.optimize.least_squares(
        off,
        shares(start, table),
        slopes,
        bounds=(0, 1),
        method="dogbox",
        ftol=SEARCH_TOLERANCE,
        xtol=SEARCH_TOLERANCE,
        max_nfev=table.generations,
    )
    return 2 * float(found.cost), round_sample(found.x, table)


BOOTSTRAP_DRAWS = 2000
"""Samples of the bootstrap."""
UNSEEN_INTERVAL_SHARE = 0.5
"""Share of its range above which the interval of a parameter means that it is not seen."""
CONFOUNDED_CORRELATION = 0.9
"""Correlation above which two parameters are confounded."""
MIN_GROUPS = 5
"""Number of groups needed to take the spread between them; with fewer, the spread follows from the
uncertainties in the table."""
FLAT_CURVATURE = 1e-9
"""Curvature of chi-squared, relative to the largest, below which a direction is taken as flat."""


@dataclass(frozen=True, kw_only=True)
class ParameterEstimate:
    """A parameter as found.

    Attributes:
        name: Its name in the table.
        value: The best.
        low: Lower end of the 95 % interval of the bootstrap over groups.
        high: Upper end.
        fold_low: Least value of the fits that left a group out; None without them.
        fold_high: Largest.
        verdict: ``seen``; or ``confounded with`` others, or ``not seen`` at all.
        unit: Of all values.
    """

    name: str
    value: float
    low: float
    high: float
    fold_low: float | None
    fold_high: float | None
    verdict: str
    unit: str


def misfits(
    numbers: tuple[Cell, ...], samples: Sequence[Sample], runs: Runs
) -> dict[Sample, Array]:
    """Residuals of cells, shape (cells,), for each of some samples."""
    places = dict.fromkeys(cell.experiment for cell in numbers)
    found = runs.indicators((sample, place) for sample in samples for place in places)
    return {x: residuals(numbers, compute_cells(numbers, x, found)) for x in samples}


def jacobian(
    table: FitTable,
    numbers: tuple[Cell, ...],
    best: Sample,
    runs: Runs,
    step: float = DERIVATIVE_STEP,
) -> Array:
    """Derivatives of the residuals by shares of the ranges, shape (cells, parameters)."""
    at = shares(best, table)
    steps = step * np.eye(len(at))
    pairs = [(round_sample(at - step, table), round_sample(at + step, table)) for step in steps]
    found = misfits(numbers, [sample for pair in pairs for sample in pair], runs)
    columns = [
        (found[high] - found[low]) / (shares(high, table)[k] - shares(low, table)[k])
        for k, (low, high) in enumerate(pairs)
    ]
    return np.stack(columns, axis=1)


def correlation(J: Array) -> Array:  # noqa: N803
    """Correlation of the parameters by the linear model, shape (parameters, parameters)."""
    covariance = np.linalg.pinv(J.T @ J, rcond=FLAT_CURVATURE, hermitian=True)
    deviation = np.sqrt(np.diag(covariance))
    scale = np.where(deviation > 0, deviation, 1.0)
    return np.asarray(covariance / np.outer(scale, scale))


def bootstrap(J: Array, r: Array, groups: Sequence[str]) -> Array:  # noqa: N803
    """How far the best shares move when groups are drawn anew, shape (draws, parameters).

    Groups, not single cells, as the cells of a group share what is wrong with the model. The
    residuals are taken as linear in the parameters. With fewer than ``FEW`` groups the shares are
    drawn as if every residual were what the table states as its uncertainty.
    """
    names = list(dict.fromkeys(groups))
    if len(names) < MIN_GROUPS:
        covariance = np.linalg.inv(
            J.T @ J + FLAT_CURVATURE * np.trace(J.T @ J) * np.eye(J.shape[1])
        )
        middle = np.zeros(J.shape[1])
        return np.asarray(
            np.random.default_rng(0).multivariate_normal(middle, covariance, BOOTSTRAP_DRAWS)
        )
    member = np.array([[group == name for group in groups] for name in names], float)
    curvature = np.einsum("gc,ci,cj->gij", member, J, J)
    slope = np.einsum("gc,ci,c->gi", member, J, r)
    drawn = np.random.default_rng(0).multinomial(
        len(names), [1 / len(names)] * len(names), BOOTSTRAP_DRAWS
    )
    # the slope of all is left out: the best is where the search ended, whatever the linear model
    slope = slope - slope.mean(axis=0)
    normal = np.einsum("bg,gij->bij", drawn, curvature)
    right = np.einsum("bg,gi->bi", drawn, slope)
    floor = FLAT_CURVATURE * np.trace(curvature.sum(axis=0)) * np.eye(J.shape[1])
    return -np.asarray(np.linalg.solve(normal + floor, right[..., None])[..., 0])


def estimates(
    table: FitTable,
    best: Sample,
    J: Array,  # noqa: N803
    r: Array,
    groups: Sequence[str],
    folds: Sequence[Sample],
) -> list[ParameterEstimate]:
    """Every parameter with its spread and verdict, in the order of the table.

    Args:
        table: The parameters.
        best: Their best values.
        J: Derivatives of the residuals by shares of the ranges, shape (cells, parameters).
        r: Residuals, shape (cells,).
        groups: The group of each cell.
        folds: Best values without a group each.
    """
    at, related = shares(best, table), correlation(J)
    ends = np.percentile(np.clip(at + bootstrap(J, r, groups), 0, 1), (2.5, 97.5), axis=0)
    names = list(table.parameters)
    found = []
    for k, (name, about) in enumerate(table.parameters.items()):
        low, high = (about.low + end[k] * (about.high - about.low) for end in ends)
        rivals = [
            names[j]
            for j in range(len(names))
            if j != k and abs(related[k, j]) > CONFOUNDED_CORRELATION
        ]
        if ends[1, k] - ends[0, k] < UNSEEN_INTERVAL_SHARE and (J[:, k] ** 2).sum() > 1:
            verdict = "seen"
        else:
            verdict = f"confounded with {', '.join(rivals)}" if rivals else "not seen"
        own = [fold[k] for fold in folds]
        found.append(
            ParameterEstimate(
                name=name,
                value=best[k],
                low=float(low),
                high=float(high),
                fold_low=min(own, default=None),
                fold_high=max(own, default=None),
                verdict=verdict,
                unit=about.unit,
            )
        )
    return found


@dataclass(frozen=True, kw_only=True)
class FitResult:
    """Result of a fit.

    Attributes:
        table: What was asked.
        cells: The measured numbers.
        best: The parameters fitted to all of them.
        folds: Group to the parameters fitted without it; empty if none was left out.
        chi2_without: Group to the sum of squared residuals of all other cells with these.
        computed: What the best parameters give for the cells, shape (cells,).
        held_out: What those fitted without a cell's group give for it, shape (cells,); nan
            without folds.
        estimates: Every parameter with its spread and verdict.
        correlation: Of the parameters, shape (parameters, parameters).
        ends: Chi-squared and parameters at the end of every search of all groups.
        runs: How many runs it took.
    """

    table: FitTable
    cells: tuple[Cell, ...]
    best: Sample
    folds: dict[str, Sample]
    chi2_without: dict[str, float]
    computed: Array
    held_out: Array
    estimates: list[ParameterEstimate]
    correlation: Array
    ends: list[tuple[float, Sample]]
    runs: int

    @property
    def chi2(self) -> float:
        """Sum of squared residuals of all cells."""
        r = residuals(self.cells, self.computed)
        return float(r @ r)

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``."""

        def named(sample: Sample) -> dict[str, float]:
            return dict(zip(self.table.parameters, sample, strict=True))

        return {
            "title": self.table.title,
            "chi2": self.chi2,
            "measurements": len(self.cells),
            "runs": self.runs,
            "parameters": [asdict(each) for each in self.estimates],
            "correlation": self.correlation.tolist(),
            "searches": [{"chi2": chi2, "parameters": named(sample)} for chi2, sample in self.ends],
            "without": {group: named(sample) for group, sample in self.folds.items()},
            "chi2_without": self.chi2_without,
            "cells": [
                {
                    "experiment": cell.label,
                    "group": cell.group,
                    "indicator": cell.indicator,
                    "unit": cell.unit,
                    "measured": cell.measured,
                    "computed": number(value),
                    "held_out": number(held),
                    "residual": cell.residual(value),
                }
                for cell, value, held in zip(
                    self.cells, self.computed.tolist(), self.held_out.tolist(), strict=True
                )
            ],
        }


def fit(
    table: FitTable,
    runs: Runs,
    *,
    leave_out: bool = True,
    advance: Callable[[float], None] = lambda _: None,
) -> FitResult:
    """Fit a table's parameters to it.

    Args:
        table: Experiments and parameters.
        runs: What carries out its runs.
        leave_out: Whether to fit also without each group of experiments.
        advance: Called with the share done, 0 to 1.

    Raises:
        TwinError: If a run cannot be carried out.
    """
    numbers, size = cells(table), len(table.parameters)
    count = (table.population or SAMPLES_PER_PARAMETER * size) * table.restarts
    drawn = [
        round_sample(each, table)
        for each in scipy.stats.qmc.LatinHypercube(size, rng=1).random(count)
    ]
    found = misfits(numbers, drawn, runs)
    groups = np.array([cell.group for cell in numbers])
    folds: dict[str, Mask] = {}
    if leave_out and len(table.groups) > 1:
        folds = {
            group: groups != group for group in table.groups if (groups != group).sum() >= size
        }
    steps = table.restarts + len(folds)

    def ahead(kept: Mask, place: int = 0) -> Sample:
        # the best by these cells of what was drawn before any data: others have no say
        return sorted(drawn, key=lambda x: float((found[x][kept] ** 2).sum()))[place]

    whole = []
    for place in range(table.restarts):
        advance((1 + place) / (2 + steps))
        start = ahead(np.ones(len(numbers), bool), place)
        whole.append(search_from(table, numbers, start, runs))
    _, best = min(whole)
    left, chi2_without = dict[str, Sample](), dict[str, float]()
    for group, kept in folds.items():
        advance((1 + len(whole) + len(left)) / (2 + steps))
        own = tuple(itertools.compress(numbers, kept))
        chi2_without[group], left[group] = search_from(table, own, ahead(kept), runs)
    gave = runs.indicators(
        (sample, cell.experiment)
        for cell in numbers
        for sample in (best, left.get(cell.group))
        if sample is not None
    )
    values = compute_cells(numbers, best, gave)
    held_out = np.array(
        [
            gave[left[c.group], c.experiment][c.indicator] if c.group in left else np.nan
            for c in numbers
        ]
    )
    derivatives = jacobian(table, numbers, best, runs)
    advance(1.0)
    return FitResult(
        table=table,
        cells=numbers,
        best=best,
        folds=left,
        chi2_without=chi2_without,
        computed=values,
        held_out=held_out,
        estimates=estimates(
            table,
            best,
            derivatives,
            residuals(numbers, values),
            [cell.group for cell in numbers],
            list(left.values()),
        ),
        correlation=correlation(derivatives),
        ends=whole,
        runs=runs.finished,
    )


PARAMETER_HEADINGS = ("parameter", "value", "95 %", "without one group", "unit", "verdict")
CELL_HEADINGS = ("experiment", "indicator", "unit", "measured", "computed", "held out", "residual")


def sentences(found: FitResult) -> list[str]:
    """The result of a fit, in sentences."""
    table = found.table
    lines = [
        f"{plural(len(found.cells), 'measured number')} of "
        f"{plural(len(table.experiments), 'experiment')}, "
        f"{plural(len(table.parameters), 'parameter')}: chi-squared {found.chi2:.1f}."
    ]
    ends = [chi2 for chi2, _ in found.ends]
    if len(ends) > 1:
        lines.append(
            f"{len(ends)} searches from different beginnings ended at chi-squared "
            f"{', '.join(f'{chi2:.1f}' for chi2 in ends)}."
        )
    return lines


def row(each: ParameterEstimate) -> tuple[str, ...]:
    """A parameter as a row of the table: value, interval, range of the folds, verdict."""
    folds = "-" if each.fold_low is None else f"{digits(each.fold_low)} to {digits(each.fold_high)}"
    interval = f"{digits(each.low)} to {digits(each.high)}"
    return each.name, digits(each.value), interval, folds, each.unit, each.verdict


def write(found: FitResult, folder: Path) -> None:
    """Write report.html and fit.json.

    Raises:
        RecordError: If a file cannot be written.
    """
    numbers = found.as_dict()
    values = ("experiment", "indicator", "unit", "measured", "computed", "held_out")
    cells = [
        (*(digits(cell[key]) for key in values), f"{cell['residual']:+.2f}")
        for cell in numbers["cells"]
    ]
    good = any(each.verdict == "seen" for each in found.estimates)
    note = (
        "As data, with the correlations of parameters: fit.json in this folder. A residual is "
        "computed less measured in standard uncertainties; of an indicator that a run does not "
        "have it is 10. Held out: fitted without the group that a number belongs to."
    )
    blocks: list[Block] = [
        Verdict(sentences(found), good),
        Table(
            "Parameters",
            PARAMETER_HEADINGS,
            [row(each) for each in found.estimates],
            words=(0, 4, 5),
        ),
        Table("Every measured number", CELL_HEADINGS, cells, words=(0, 1, 2), note=note),
    ]
    page.write(folder / "report.html", found.table.title, blocks)
    write_json(folder / "fit.json", numbers)
