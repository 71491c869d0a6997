"""A fit from end to end: search, leaving each group out, spread, verdicts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from controllers.arrays import Array
from twin.fit.misfit import Cell, cells, computed, residuals
from twin.fit.runs import Runs, Sample
from twin.fit.schema import FitTable
from twin.fit.search import Descent, Search, searched
from twin.fit.uncertainty import Estimate, correlation, estimates, jacobian


@dataclass(frozen=True, kw_only=True)
class FitResult:
    """What a fit found.

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
    estimates: list[Estimate]
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
        names = list(self.table.parameters)
        return {
            "title": self.table.title,
            "chi2": self.chi2,
            "measurements": len(self.cells),
            "runs": self.runs,
            "parameters": [each.as_dict() for each in self.estimates],
            "correlation": self.correlation.tolist(),
            "searches": [
                {"chi2": chi2, "parameters": dict(zip(names, sample, strict=True))}
                for chi2, sample in self.ends
            ],
            "without": {
                group: dict(zip(names, sample, strict=True)) for group, sample in self.folds.items()
            },
            "chi2_without": self.chi2_without,
            "cells": [
                {
                    "experiment": cell.label,
                    "group": cell.group,
                    "indicator": cell.indicator,
                    "unit": cell.unit,
                    "measured": cell.measured,
                    "computed": _number(value),
                    "held_out": _number(held),
                    "residual": cell.residual(value),
                }
                for cell, value, held in zip(
                    self.cells, self.computed.tolist(), self.held_out.tolist(), strict=True
                )
            ],
        }


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None


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
    numbers = cells(table)
    whole = [Search(table, numbers, seed, f"all {seed}") for seed in range(1, table.restarts + 1)]
    searched(whole, runs, lambda share: advance(0.5 * share))
    ahead = min(whole, key=lambda search: search.chi2)
    near = {
        group: Search(table, own, 1, f"without {group}", _start(own, whole, runs))
        for group in (table.groups if leave_out and len(table.groups) > 1 else ())
        if len(own := [c for c in numbers if c.group != group]) >= len(table.parameters)
    }
    if near:
        searched([*near.values()], runs, lambda share: advance(0.5 + 0.3 * share))
    refined = Descent(table, numbers, ahead.best, "all")
    folds = {
        group: Descent(table, search.cells, search.best, search.name)
        for group, search in near.items()
    }
    searched([refined, *folds.values()], runs, lambda share: advance(0.8 + 0.15 * share))
    best = refined.best if refined.chi2 <= ahead.chi2 else ahead.best
    left = {group: search.best for group, search in folds.items()}
    found = runs.indicators(
        (sample, cell.experiment)
        for cell in numbers
        for sample in (best, left.get(cell.group))
        if sample is not None
    )
    values = computed(numbers, best, found)
    held_out = np.array(
        [
            found[left[c.group], c.experiment][c.indicator] if c.group in left else np.nan
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
        chi2_without={group: search.chi2 for group, search in folds.items()},
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
        ends=[(search.chi2, search.best) for search in whole],
        runs=runs.finished,
    )


def _start(own: Sequence[Cell], whole: Sequence[Search], runs: Runs) -> Sample:
    """Where the fit to some cells begins: the best, by these, of what was drawn before any data.

    So nothing that is left out has a say.
    """
    numbers = tuple(own)
    drawn = [sample for search in whole for sample in search.first]
    places = dict.fromkeys(cell.experiment for cell in numbers)
    found = runs.indicators((sample, place) for sample in drawn for place in places)

    def misfit(sample: Sample) -> float:
        return float((residuals(numbers, computed(numbers, sample, found)) ** 2).sum())

    return min(drawn, key=misfit)
