"""A fit from end to end: search, leaving each group out, spread, verdicts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from controllers.arrays import Array
from twin.fit.misfit import Cell, cells, computed, residuals
from twin.fit.runs import Runs, Sample
from twin.fit.schema import FitTable
from twin.fit.search import Descent, best_of, descend, design
from twin.fit.uncertainty import Estimate, correlation, estimates, jacobian

ALL = ""
"""The group that is left out of a fit to all cells."""


@dataclass(frozen=True, kw_only=True)
class FitResult:
    """What a fit found.

    Attributes:
        table: What was asked.
        cells: The measured numbers.
        best: The parameters fitted to all of them.
        folds: Group to the parameters fitted without it; empty if none was left out.
        computed: What the best parameters give for the cells, shape (cells,).
        held_out: What those fitted without a cell's group give for it, shape (cells,); nan
            without folds.
        estimates: Every parameter with its spread and verdict.
        correlation: Of the parameters, shape (parameters, parameters).
        searches: Of every search chi-squared and parameters at its end, by the group that was left
            out; of all cells under ``ALL``.
        runs: How many runs it took.
    """

    table: FitTable
    cells: tuple[Cell, ...]
    best: Sample
    folds: dict[str, Sample]
    computed: Array
    held_out: Array
    estimates: list[Estimate]
    correlation: Array
    searches: list[dict[str, tuple[float, Sample]]]
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
            "parameters": [each.as_dict() for each in self.estimates],
            "correlation": self.correlation.tolist(),
            "searches": [
                {
                    "chi2": search[ALL][0],
                    "parameters": named(search[ALL][1]),
                    "without": {
                        group: {"chi2": chi2, "parameters": named(sample)}
                        for group, (chi2, sample) in search.items()
                        if group != ALL
                    },
                }
                for search in self.searches
            ],
            "without": {group: named(sample) for group, sample in self.folds.items()},
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
    kept = {ALL: numbers}
    for group in table.groups if leave_out and len(table.groups) > 1 else ():
        own = tuple(cell for cell in numbers if cell.group != group)
        if len(own) >= len(table.parameters):
            kept[group] = own
    drawn = [design(table, seed) for seed in range(1, table.restarts + 1)]
    runs.indicators((x, i) for some in drawn for x in some for i in range(len(table.experiments)))
    advance(0.4)
    searches = [
        {group: Descent(table, own, best_of(some, own, runs)) for group, own in kept.items()}
        for some in drawn
    ]
    descend(
        [one for search in searches for one in search.values()],
        runs,
        lambda share: advance(0.4 + 0.55 * share),
    )
    left = {
        group: min((search[group] for search in searches), key=lambda one: one.chi2).best
        for group in kept
    }
    best = left.pop(ALL)
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
        searches=[
            {group: (one.chi2, one.best) for group, one in search.items()} for search in searches
        ],
        runs=runs.finished,
    )
