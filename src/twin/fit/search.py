"""The search for parameters: least squares from the best of a design drawn before any data.

Every fit, of all cells or without some, begins at that sample of the same design which is best by
its own cells, so that nothing that is left out has a say. Many go side by side: their runs share
batches, and the same run is never made twice.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import ceil, log2

import numpy as np
from scipy.stats import qmc

from controllers.arrays import Array
from twin.fit.misfit import Cell, computed, residuals
from twin.fit.runs import Runs, Sample, rounded, shares
from twin.fit.schema import FitTable


def design(table: FitTable, seed: int) -> list[Sample]:
    """A scrambled Sobol' design over the whole ranges, of ``table.draws`` samples and some more.

    Its size is a power of two, for which it fills the ranges evenly.
    """
    drawn = qmc.Sobol(len(table.parameters), rng=seed).random_base2(ceil(log2(table.draws)))
    return [rounded(share, table) for share in drawn]


def best_of(samples: Sequence[Sample], numbers: tuple[Cell, ...], runs: Runs) -> Sample:
    """That of some samples which is best by some cells."""
    places = dict.fromkeys(cell.experiment for cell in numbers)
    found = runs.indicators((sample, place) for sample in samples for place in places)

    def misfit(sample: Sample) -> float:
        return float((residuals(numbers, computed(numbers, sample, found)) ** 2).sum())

    return min(samples, key=misfit)


class Descent:
    """Least squares from a start, by steps on the linear model of its own samples.

    The model is fitted to all samples so far and two lengths of a step are tried at once:
    indicators with limit cycles are rough on a small scale, and few large batches are faster than
    many small ones.

    Args:
        table: The parameters.
        numbers: The cells whose misfit is made small.
        start: Where to begin.

    Attributes:
        best: The best sample so far.
        chi2: Its sum of squared residuals.
        over: Whether it has ended.
    """

    FIRST = 0.08
    """Step of the first samples, as a share of the ranges."""
    LENGTHS = (0.5, 1.0)
    """Shares of the way to the model's minimum that are tried."""
    ROUNDS = 10
    """Most times it is asked."""
    LITTLE = 0.02
    """Fall of chi-squared in a round at which it is at its end."""

    def __init__(self, table: FitTable, numbers: tuple[Cell, ...], start: Sample) -> None:
        self.cells = numbers
        self.best, self.chi2 = start, np.inf
        self.over = False
        self._table = table
        self._seen: dict[Sample, Array] = {}
        self._asked: list[Sample] = []
        self._round = 0

    @property
    def experiments(self) -> tuple[int, ...]:
        """The experiments it needs, by their places in the table."""
        return tuple(dict.fromkeys(cell.experiment for cell in self.cells))

    def ask(self) -> list[Sample]:
        """The samples it wants next."""
        at = shares(self.best, self._table)
        if self._round:
            steps = [length * self._to_minimum(at) for length in self.LENGTHS]
        else:
            inwards = np.where(at + self.FIRST <= 1, self.FIRST, -self.FIRST)
            steps = [np.zeros(len(at)), *np.diag(inwards)]
        self._asked = [rounded(at + step, self._table) for step in steps]
        return self._asked

    def tell(self, values: Sequence[Array]) -> None:
        """Take in the computed values of its cells for the samples it asked for."""
        before = self.chi2
        for sample, value in zip(self._asked, values, strict=True):
            r = residuals(self.cells, value)
            self._seen[sample] = r
            if float(r @ r) < self.chi2:
                self.chi2, self.best = float(r @ r), sample
        self._round += 1
        self.over = self._round >= self.ROUNDS or before - self.chi2 < self.LITTLE

    def _to_minimum(self, best: Array) -> Array:
        at = np.array([shares(sample, self._table) for sample in self._seen]) - best
        r = np.array(list(self._seen.values()))
        model = np.linalg.lstsq(np.column_stack((np.ones(len(at)), at)), r, rcond=None)[0]
        step = np.linalg.lstsq(model[1:].T, -model[0], rcond=None)[0]
        return np.asarray(np.clip(step, -0.3, 0.3))


def descend(
    searches: Sequence[Descent], runs: Runs, advance: Callable[[float], None] = lambda _: None
) -> None:
    """Carry all searches to their ends.

    Args:
        searches: Side by side.
        runs: What carries out their runs.
        advance: Called with the share done, 0 to 1.

    Raises:
        TwinError: If a run cannot be carried out.
    """
    turn = 0
    while left := [search for search in searches if not search.over]:
        asked = [(search, search.ask()) for search in left]
        wanted = [(x, i) for search, samples in asked for x in samples for i in search.experiments]
        found = runs.indicators(wanted)
        for search, samples in asked:
            search.tell([computed(search.cells, sample, found) for sample in samples])
        turn += 1
        advance(turn / Descent.ROUNDS)
