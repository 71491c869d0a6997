"""A fit from end to end: search by CMA-ES, leaving each group out, spread, verdicts, its page.

Many searches go side by side, generation by generation, so that their runs share batches and the
same run is never made twice. A search knows the cells it was given and nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from cmaes import CMA

from controllers.analysis import number
from controllers.arrays import Array
from twin import page
from twin.fit.runs import (
    Cell,
    FitTable,
    Indicators,
    Runs,
    Sample,
    cells,
    computed,
    residuals,
    rounded,
    shares,
)
from twin.page import Block, Table, Verdict, digits
from twin.writing import write_json

SIGMA = 0.25
"""Standard deviation of the first generation, as a share of the ranges."""
NEAR_SIGMA, NEAR_GENERATIONS = 0.12, 4
"""The same of a search that begins near a sample, and its generations at most."""
CLOSE = 0.3
"""Spread of chi-squared within a generation at which a search is at its end."""
FIRST = 0.08
"""Step of the first samples of a descent, as a share of the ranges."""
LENGTHS = (0.5, 1.0)
"""Shares of the way to the linear model's minimum that it tries."""
ROUNDS = 10
"""Most times it goes on."""
LITTLE = 0.02
"""Fall of chi-squared in a round at which it is at its end."""

Asking = Generator[list[Sample], list[Array], None]
"""A way to search: gives the samples it wants next, is sent the residuals of each."""


class Search:
    """A search under way.

    Args:
        numbers: The cells whose misfit is made small.
        asking: How it looks for that.

    Attributes:
        cells: The cells.
        asked: The samples it wants next; none when it has ended.
        first: Those it wanted first, before any cell was looked at.
        best: The best sample so far.
        chi2: Its sum of squared residuals.
    """

    def __init__(self, numbers: Sequence[Cell], asking: Asking) -> None:
        self.cells = tuple(numbers)
        self._asking = asking
        self.first = self.asked = next(asking)
        self.best: Sample = ()
        self.chi2 = np.inf

    @property
    def wanted(self) -> list[tuple[Sample, int]]:
        """The runs it needs next."""
        places = dict.fromkeys(cell.experiment for cell in self.cells)
        return [(sample, place) for sample in self.asked for place in places]

    def tell(self, found: Indicators) -> None:
        """Take in what the runs gave that it wanted."""
        told = [residuals(self.cells, computed(self.cells, x, found)) for x in self.asked]
        for sample, r in zip(self.asked, told, strict=True):
            if float(r @ r) < self.chi2:
                self.chi2, self.best = float(r @ r), sample
        try:
            self.asked = self._asking.send(told)
        except StopIteration:
            self.asked = []


def wide(table: FitTable, seed: int, near: Sample | None = None) -> Asking:
    """A global search by CMA-ES.

    Args:
        table: The parameters.
        seed: Of its random numbers.
        near: Sample about which it begins; the whole ranges without one.
    """
    rounds = table.generations if near is None else min(table.generations, NEAR_GENERATIONS)
    size = len(table.parameters)
    # the library needs two dimensions; a second one to a single parameter changes nothing
    space = max(2, size)
    mean = np.full(space, 0.5)
    if near is not None:
        mean[:size] = shares(near, table)
    cma = CMA(
        mean=mean,
        sigma=SIGMA if near is None else NEAR_SIGMA,
        bounds=np.array([[0.0, 1.0]] * space),
        seed=seed,
        population_size=table.population or None,
    )
    for _ in range(rounds):
        points = [cma.ask() for _ in range(cma.population_size)]
        told = yield [rounded(point[:size], table) for point in points]
        chi2 = [float(r @ r) for r in told]
        cma.tell(list(zip(points, chi2, strict=True)))
        if max(chi2) - min(chi2) < CLOSE:
            return


def descent(table: FitTable, start: Sample) -> Asking:
    """Least squares from a start, by steps on the linear model of its own samples.

    Args:
        table: The parameters.
        start: Where to begin.
    """
    at = shares(start, table)
    inwards = np.where(at + FIRST <= 1, FIRST, -FIRST)
    steps = [np.zeros(len(at)), *np.diag(inwards)]
    seen: dict[Sample, Array] = {}
    best, chi2 = start, np.inf
    for _ in range(ROUNDS):
        before, asked = chi2, [rounded(at + step, table) for step in steps]
        told = yield asked
        seen |= zip(asked, told, strict=True)
        for sample, r in zip(asked, told, strict=True):
            if float(r @ r) < chi2:
                chi2, best = float(r @ r), sample
        if before - chi2 < LITTLE:
            return
        at = shares(best, table)
        steps = [length * _to_minimum(table, seen, at) for length in LENGTHS]


def _to_minimum(table: FitTable, seen: Mapping[Sample, Array], best: Array) -> Array:
    """From the best shares to the minimum of the linear model of all residuals seen."""
    at = np.array([shares(sample, table) for sample in seen]) - best
    r = np.array(list(seen.values()))
    model = np.linalg.lstsq(np.column_stack((np.ones(len(at)), at)), r, rcond=None)[0]
    step = np.linalg.lstsq(model[1:].T, -model[0], rcond=None)[0]
    return np.asarray(np.clip(step, -0.3, 0.3))


def searched(
    searches: Sequence[Search],
    runs: Runs,
    rounds: int,
    advance: Callable[[float], None] = lambda _: None,
) -> None:
    """Carry all searches to their ends.

    Args:
        searches: Side by side.
        runs: What carries out their runs.
        rounds: About how often they ask.
        advance: Called with the share done, 0 to 1.

    Raises:
        TwinError: If a run cannot be carried out.
    """
    turn = 0
    while left := [search for search in searches if search.asked]:
        found = runs.indicators(each for search in left for each in search.wanted)
        for search in left:
            search.tell(found)
        turn += 1
        advance(min(turn / rounds, 1.0))


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
    return {x: residuals(numbers, computed(numbers, x, found)) for x in samples}


def jacobian(table: FitTable, numbers: tuple[Cell, ...], best: Sample, runs: Runs) -> Array:
    """Derivatives of the residuals by shares of the ranges, shape (cells, parameters)."""
    at = shares(best, table)
    steps = STEP * np.eye(len(at))
    pairs = [(rounded(at - step, table), rounded(at + step, table)) for step in steps]
    found = misfits(numbers, [sample for pair in pairs for sample in pair], runs)
    columns = [
        (found[high] - found[low]) / (shares(high, table)[k] - shares(low, table)[k])
        for k, (low, high) in enumerate(pairs)
    ]
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
        rivals = [names[j] for j in range(len(names)) if j != k and abs(related[k, j]) > CORRELATED]
        if ends[1, k] - ends[0, k] < WIDE and (J[:, k] ** 2).sum() > 1:
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
    numbers = cells(table)
    whole = [Search(numbers, wide(table, seed)) for seed in range(1, table.restarts + 1)]
    searched(whole, runs, table.generations, lambda share: advance(0.5 * share))
    ahead = min(whole, key=lambda search: search.chi2)
    near = {
        group: Search(own, wide(table, 1, _start(own, whole, runs)))
        for group in (table.groups if leave_out and len(table.groups) > 1 else ())
        if len(own := [c for c in numbers if c.group != group]) >= len(table.parameters)
    }
    some = [*near.values()]
    searched(some, runs, NEAR_GENERATIONS, lambda share: advance(0.5 + 0.3 * share))
    refined = Search(numbers, descent(table, ahead.best))
    folds = {g: Search(each.cells, descent(table, each.best)) for g, each in near.items()}
    some = [refined, *folds.values()]
    searched(some, runs, ROUNDS, lambda share: advance(0.8 + 0.15 * share))
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
    drawn = [sample for search in whole for sample in search.first]
    found = misfits(tuple(own), drawn, runs)
    return min(drawn, key=lambda sample: float((found[sample] ** 2).sum()))


HEADS = (
    "parameter",
    "value",
    "95 %, bootstrap over groups",
    "range without one group",
    "unit",
    "verdict",
)
CELLS = ("experiment", "indicator", "unit", "measured", "computed", "held out", "residual")


def sentences(found: FitResult) -> list[str]:
    """What a fit says, in words."""
    table = found.table
    lines = [
        f"{len(found.cells)} measured numbers of {len(table.experiments)} experiments, "
        f"{len(table.parameters)} parameters: chi-squared {found.chi2:.1f}."
    ]
    lines += [
        f"{each.name}: {each.value:.4g} {each.unit}".rstrip()
        + f" ({each.low:.4g} to {each.high:.4g}), {each.verdict}."
        for each in found.estimates
    ]
    ends = [chi2 for chi2, _ in found.ends]
    if len(ends) > 1:
        lines.append(
            f"{len(ends)} searches with different random numbers ended at chi-squared "
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
    names = list(found.table.parameters)
    related = [
        (name, *(f"{value:+.2f}" for value in line))
        for name, line in zip(names, found.correlation.tolist(), strict=True)
    ]
    good = any(each.verdict == "seen" for each in found.estimates)
    note = (
        "As data: fit.json beside this page. A residual is computed less measured in standard "
        "uncertainties; of an indicator that a run does not have it is 10. Held out: fitted "
        "without the group that a number belongs to."
    )
    blocks: list[Block] = [
        Verdict(sentences(found), good),
        Table("Parameters", HEADS, [row(each) for each in found.estimates], words=(0, 4, 5)),
        Table("Correlation", ("", *names), related),
        Table("Every measured number", CELLS, cells, words=(0, 1, 2), note=note),
    ]
    page.write(folder / "report.html", found.table.title, blocks)
    write_json(folder / "fit.json", numbers)
