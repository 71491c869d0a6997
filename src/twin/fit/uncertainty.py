"""What a fit is worth: spread, correlations, and a verdict for each parameter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from controllers.arrays import Array
from twin.fit.misfit import Cell, computed, residuals
from twin.fit.runs import Runs, Sample, rounded, shares
from twin.fit.schema import FitTable

STEP = 0.03
"""Half of the difference that derivatives are taken over, as a share of the ranges."""
DRAWS = 2000
"""Of the bootstrap."""
WIDE = 0.5
"""Share of its range from which on the interval of a parameter says that it is not seen."""
CORRELATED = 0.9
"""Correlation from which on two parameters are confounded."""
FEW = 5
"""Groups from which on the spread is that between them; with fewer it is that of the uncertainties
that the table states."""
FAINT = 1e-9
"""Curvature of chi-squared, relative to the largest, below which a direction is taken as flat."""


@dataclass(frozen=True, kw_only=True)
class Estimate:
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

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``."""
        return asdict(self)


def jacobian(table: FitTable, numbers: tuple[Cell, ...], best: Sample, runs: Runs) -> Array:
    """Derivatives of the residuals by shares of the ranges, shape (cells, parameters)."""
    at = shares(best, table)
    pairs = []
    for k in range(len(at)):
        step = np.zeros(len(at))
        step[k] = STEP
        pairs.append((rounded(at - step, table), rounded(at + step, table)))
    experiments = tuple(dict.fromkeys(cell.experiment for cell in numbers))
    found = runs.indicators((x, i) for pair in pairs for x in pair for i in experiments)
    columns = []
    for k, (low, high) in enumerate(pairs):
        difference = residuals(numbers, computed(numbers, high, found)) - residuals(
            numbers, computed(numbers, low, found)
        )
        columns.append(difference / (shares(high, table)[k] - shares(low, table)[k]))
    return np.stack(columns, axis=1)


def correlation(J: Array) -> Array:  # noqa: N803
    """Correlation of the parameters by the linear model, shape (parameters, parameters)."""
    covariance = np.linalg.pinv(J.T @ J, rcond=FAINT, hermitian=True)
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
    if len(names) < FEW:
        covariance = np.linalg.inv(J.T @ J + FAINT * np.trace(J.T @ J) * np.eye(J.shape[1]))
        middle = np.zeros(J.shape[1])
        return np.asarray(np.random.default_rng(0).multivariate_normal(middle, covariance, DRAWS))
    member = np.array([[group == name for group in groups] for name in names], float)
    curvature = np.einsum("gc,ci,cj->gij", member, J, J)
    slope = np.einsum("gc,ci,c->gi", member, J, r)
    drawn = np.random.default_rng(0).multinomial(len(names), [1 / len(names)] * len(names), DRAWS)
    # the slope of all is left out: the best is where the search ended, whatever the linear model
    slope = slope - slope.mean(axis=0)
    normal = np.einsum("bg,gij->bij", drawn, curvature)
    right = np.einsum("bg,gi->bi", drawn, slope)
    floor = FAINT * np.trace(curvature.sum(axis=0)) * np.eye(J.shape[1])
    return -np.asarray(np.linalg.solve(normal + floor, right[..., None])[..., 0])


def estimates(
    table: FitTable,
    best: Sample,
    J: Array,  # noqa: N803
    r: Array,
    groups: Sequence[str],
    folds: Sequence[Sample],
) -> list[Estimate]:
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
        rivals = [names[j] for j in range(len(names)) if j != k and abs(related[k, j]) > CORRELATED]
        if ends[1, k] - ends[0, k] < WIDE and (J[:, k] ** 2).sum() > 1:
            verdict = "seen"
        else:
            verdict = f"confounded with {', '.join(rivals)}" if rivals else "not seen"
        own = [fold[k] for fold in folds]
        found.append(
            Estimate(
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
