"""The runs of a fit, each made once, and how far they are from what was measured."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from controllers.arrays import Array
from twin.errors import LawError
from twin.fit.schema import UNITS, Experiment, FitTable, factor
from twin.scenario import Scenario
from twin.study.experiments import Store, evaluate
from twin.study.work import Builder, ScenarioRuns

LOST = 10.0
"""Residual of an indicator that a run does not have, such as that of a lost ball."""
LEAST = 1e-9
"""Least value of which a logarithm is taken."""


class Cell(NamedTuple):
    """A measured number.

    Attributes:
        experiment: Which, by its place in the table.
        group: That it is left out with.
        label: Of the experiment.
        indicator: Its name.
        unit: Of the value.
        measured: The value.
        scale: Standard uncertainty, of the value or of its logarithm.
        logarithmic: Which of them.
    """

    experiment: int
    group: str
    label: str
    indicator: str
    unit: str
    measured: float
    scale: float
    logarithmic: bool

    def residual(self, computed: float) -> float:
        """How many standard uncertainties a computed value is too large."""
        if not math.isfinite(computed):
            return LOST
        if self.logarithmic:
            off = math.log(max(computed, LEAST) / self.measured)
        else:
            off = computed - self.measured
        return off / self.scale


def cells(table: FitTable) -> tuple[Cell, ...]:
    """Every measured number of a table, experiment by experiment."""
    found = []
    for place, experiment in enumerate(table.experiments):
        for name, about in experiment.measured.items():
            by = factor(name, about.unit)
            logarithmic = about.uncertainty is None
            found.append(
                Cell(
                    experiment=place,
                    group=experiment.own_group,
                    label=experiment.label,
                    indicator=name,
                    unit=UNITS[name],
                    measured=by * about.value,
                    scale=about.relative or by * (about.uncertainty or 1.0),
                    logarithmic=logarithmic,
                )
            )
    return tuple(found)


def computed(numbers: tuple[Cell, ...], sample: Sample, found: Indicators) -> Array:
    """The computed values of cells for a sample, shape (cells,)."""
    return np.array([found[sample, cell.experiment][cell.indicator] for cell in numbers])


def residuals(numbers: tuple[Cell, ...], values: Array) -> Array:
    """Residuals of cells for computed values, both shape (cells,)."""
    return np.array([c.residual(v) for c, v in zip(numbers, values.tolist(), strict=True)])


Sample = tuple[float, ...]
"""A value for each parameter, in the order of the table."""
Wanted = tuple[Sample, int]
"""A sample, and which experiment is to be run with it."""
Indicators = Mapping[Wanted, Mapping[str, float]]
"""What runs gave; nan where a run has no such indicator."""


class Runs:
    """Carries out experiments with given parameters; what a store holds is not run again.

    Args:
        table: The experiments.
        store: Where finished runs are kept.
        how: Who carries them out, and who is told of it, as for ``carry``.

    Raises:
        ScenarioError: If a scenario or key does not exist, or a value is out of range.
    """

    def __init__(self, table: FitTable, store: Store, **how: Any) -> None:
        self.table = table
        self._store, self._how = store, {"processes": 1, "whole": True} | how
        self._builder = cache(Builder)
        self._asked: set[Wanted] = set()
        middle = tuple((p.low + p.high) / 2 for p in table.parameters.values())
        for experiment in table.experiments:
            self.scenario(middle, experiment)

    @property
    def finished(self) -> int:
        """How many different runs have been asked for."""
        return len(self._asked)

    def scenario(self, sample: Sample, experiment: Experiment) -> Scenario:
        """An experiment with the parameters of a sample.

        Raises:
            ScenarioError: If a key does not exist, or a value is out of range.
        """
        point: dict[str, float | str] = {}
        factors: dict[str, float] = {}
        for value, parameter in zip(sample, self.table.parameters.values(), strict=True):
            if parameter.groups and experiment.own_group not in parameter.groups:
                continue
            key = parameter.key
            if not parameter.relative:
                point[key] = value
            elif key in point:
                point[key] = value * float(point[key])
            else:
                factors[key] = value * factors.get(key, 1.0)
        build = self._builder(experiment.scenario)
        fixed = (*self.table.set, *experiment.set)
        return build(fixed, {**point, **factors}, factors)

    def indicators(self, wanted: Iterable[Wanted]) -> Indicators:
        """The indicators of runs, as the rig's computer sees them; nan where a run has none.

        Raises:
            TwinError: If a process is killed, or a chunk of runs is lost too often.
            LawError: If none of an experiment can be run, as where its law raises an error.
        """
        asked, experiments = list(dict.fromkeys(wanted)), self.table.experiments
        self._asked.update(asked)
        batch = ScenarioRuns((self.scenario(x, experiments[i]) for x, i in asked), seen=True)
        places = [place for _, place in asked]
        gave = evaluate(batch, {"place": places}, self._store, **self._how)
        for place, own in gave.groupby("place"):
            if (own["outcome"] == "refused").all():
                raise LawError(f"{experiments[place].label}: {own['reason'].iloc[0]}")
        return {
            each: {name: row[name] for name in experiments[each[1]].measured}
            for each, row in zip(asked, gave.to_dict("records"), strict=True)
        }


def rounded(share: Array, table: FitTable) -> Sample:
    """The sample at shares between 0 and 1 of the parameters' ranges, shape (parameters,).

    Rounded to a ten-thousandth of the range: what is printed is what was run.
    """
    found = []
    for at, parameter in zip(np.clip(share, 0, 1), table.parameters.values(), strict=True):
        step = 10.0 ** (np.floor(np.log10(parameter.high - parameter.low)) - 4)
        value = parameter.low + float(at) * (parameter.high - parameter.low)
        found.append(
            float(f"{np.clip(round(value / step) * step, parameter.low, parameter.high):.12g}")
        )
    return tuple(found)


def shares(sample: Sample, table: FitTable) -> Array:
    """Where a sample lies in the ranges, each 0 to 1, shape (parameters,)."""
    ends = np.array([(p.low, p.high) for p in table.parameters.values()])
    found: Array = (np.array(sample) - ends[:, 0]) / (ends[:, 1] - ends[:, 0])
    return found
