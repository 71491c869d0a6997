"""The search for parameters: CMA-ES by the library cmaes; least squares from a start.

Many searches go side by side, generation by generation, so that their runs share batches and the
same run is never made twice. A search knows the cells it was given and nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from cmaes import CMA

from controllers.arrays import Array
from twin.fit.misfit import Cell, computed, residuals
from twin.fit.runs import Runs, Sample, rounded, shares
from twin.fit.schema import FitTable

SIGMA = 0.25
"""Standard deviation of the first generation, as a share of the ranges."""
NEAR_SIGMA, NEAR_GENERATIONS = 0.12, 4
"""The same of a search that begins near a sample, and its generations at most."""
CLOSE = 0.3
"""Spread of chi-squared within a generation at which a search is at its end."""


class Search:
    """A global search by CMA-ES.

    Args:
        table: The parameters.
        numbers: The cells whose misfit is made small.
        seed: Of its random numbers.
        name: What it is for.
        near: Sample about which it begins; the whole ranges without one.

    Attributes:
        name: What it is for.
        best: The best sample so far.
        chi2: Its sum of squared residuals.
        rounds: Most times it is asked.
        first: Its first generation, which was drawn before any cell was looked at.
        over: Whether it has ended.
    """

    def __init__(
        self,
        table: FitTable,
        numbers: Sequence[Cell],
        seed: int,
        name: str = "",
        near: Sample | None = None,
    ) -> None:
        self.name = name
        self.cells = tuple(numbers)
        self.best: Sample = near or ()
        self.chi2 = np.inf
        whole = table.generations
        self.rounds = whole if near is None else min(whole, NEAR_GENERATIONS)
        self.first: list[Sample] = []
        self.over = False
        self._table = table
        self._size = len(table.parameters)
        # the library needs two dimensions; a second one to a single parameter changes nothing
        space = max(2, self._size)
        mean = np.full(space, 0.5)
        if near is not None:
            mean[: self._size] = shares(near, table)
        self._cma = CMA(
            mean=mean,
            sigma=SIGMA if near is None else NEAR_SIGMA,
            bounds=np.array([[0.0, 1.0]] * space),
            seed=seed,
            population_size=table.population or None,
        )
        self._asked: list[tuple[Array, Sample]] = []
        self._generation = 0

    @property
    def experiments(self) -> tuple[int, ...]:
        """The experiments it needs, by their places in the table."""
        return tuple(dict.fromkeys(cell.experiment for cell in self.cells))

    def ask(self) -> list[Sample]:
        """The samples of the next generation."""
        points = [self._cma.ask() for _ in range(self._cma.population_size)]
        self._asked = [(p, rounded(p[: self._size], self._table)) for p in points]
        found = [sample for _, sample in self._asked]
        self.first = self.first or found
        return found

    def tell(self, values: Sequence[Array]) -> None:
        """Take in the computed values of its cells for the samples it asked for."""
        chi2 = []
        for (_, sample), value in zip(self._asked, values, strict=True):
            r = residuals(self.cells, value)
            chi2.append(float(r @ r))
            if chi2[-1] < self.chi2:
                self.chi2, self.best = chi2[-1], sample
        self._cma.tell([(p, c) for (p, _), c in zip(self._asked, chi2, strict=True)])
        self._generation += 1
        self.over = self._generation >= self.rounds or max(chi2) - min(chi2) < CLOSE


class Descent:
    """Least squares from a start, by steps on the linear model of its own samples.

    Args:
        table: The parameters.
        numbers: The cells whose misfit is made small.
        start: Where to begin.
        name: What it is for.

    Attributes:
        name: What it is for.
        best: The best sample so far.
        chi2: Its sum of squared residuals.
        over: Whether it has ended.
    """

    FIRST = 0.08
    """Step of the first samples, as a share of the ranges."""
    LENGTHS = (0.5, 1.0)
    """Shares of the way to the model's minimum that are tried."""
    rounds = 10
    """Most times it is asked."""
    LITTLE = 0.02
    """Fall of chi-squared in a round at which it is at its end."""

    def __init__(
        self,
        table: FitTable,
        numbers: Sequence[Cell],
        start: Sample,
        name: str = "",
    ) -> None:
        self.name = name
        self.cells = tuple(numbers)
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
        if not self._round:
            inwards = np.where(at + self.FIRST <= 1, self.FIRST, -self.FIRST)
            steps = [np.zeros(len(at)), *np.diag(inwards)]
        else:
            steps = [length * self._to_minimum(at) for length in self.LENGTHS]
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
        self.over = self._round >= self.rounds or before - self.chi2 < self.LITTLE

    def _to_minimum(self, best: Array) -> Array:
        at = np.array([shares(sample, self._table) for sample in self._seen]) - best
        r = np.array(list(self._seen.values()))
        model = np.linalg.lstsq(np.column_stack((np.ones(len(at)), at)), r, rcond=None)[0]
        step = np.linalg.lstsq(model[1:].T, -model[0], rcond=None)[0]
        return np.asarray(np.clip(step, -0.3, 0.3))


def searched(
    searches: Sequence[Search | Descent],
    runs: Runs,
    advance: Callable[[float], None] = lambda _: None,
) -> None:
    """Carry all searches to their ends.

    Args:
        searches: Side by side.
        runs: What carries out their runs.
        advance: Called with the share done, 0 to 1.

    Raises:
        TwinError: If a run cannot be carried out.
    """
    turn, rounds = 0, max(each.rounds for each in searches)
    while left := [search for search in searches if not search.over]:
        asked = [(search, search.ask()) for search in left]
        wanted = [(x, i) for search, samples in asked for x in samples for i in search.experiments]
        found = runs.indicators(wanted)
        for search, samples in asked:
            search.tell([computed(search.cells, sample, found) for sample in samples])
        turn += 1
        advance(min(turn / rounds, 1.0))
