"""Form of a table to be fitted, checked; its runs, each made once, and their misfit."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from functools import cache
from math import degrees
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from controllers.arrays import Array
from twin.base.errors import LawError, nearest, plural
from twin.base.shipped import chosen, shipped_in
from twin.base.validation import Checked, check_named_once, read_model
from twin.run.indicators import INDICATOR_UNITS as ALL_UNITS
from twin.run.indicators import MOTION_INDICATORS, nearest_indicator
from twin.run.units import UNIT_SCALES
from twin.scenario import Scenario
from twin.study.experiments import Store, evaluate
from twin.study.work import Builder, ScenarioRuns

MEASURED_UNITS = {name: unit for name, unit in ALL_UNITS.items() if name in MOTION_INDICATORS}
"""The indicators of a run that can be measured, and the unit of each."""
UNIT_FACTORS = UNIT_SCALES | {"%": {"%": 1.0, "1": 100.0}, "deg": {"deg": 1.0, "rad": degrees(1.0)}}
"""The other units in which each unit may be written, and their factors."""


def factor(name: str, unit: str | None) -> float:
    """What a number in a unit is multiplied by to be in the indicator's own.

    Args:
        name: Of the indicator.
        unit: As written; None for the indicator's own.

    Raises:
        ValueError: If there is no such indicator, or it cannot have this unit.
    """
    if name not in MEASURED_UNITS:
        raise ValueError(f"no indicator '{name}'{nearest_indicator(name, MEASURED_UNITS)}")
    known = UNIT_FACTORS[MEASURED_UNITS[name]]
    if unit is None:
        return 1.0
    if unit not in known:
        raise ValueError(f"{name}: cannot be in {unit}; allowed: {', '.join(known)}")
    return known[unit]


class FittedParameter(Checked):
    """A number to be found.

    Attributes:
        key: Dotted scenario key; ``key.0`` is the first number of a list.
        low: Least value.
        high: Largest.
        relative: Whether the value is a factor on the key's value in the experiment, or in a
            parameter named before this one.
        groups: Experiments that it concerns, by their groups; all if empty.
        unit: For the reader.
    """

    key: str
    low: float
    high: float
    relative: bool = False
    groups: tuple[str, ...] = ()
    unit: str = ""

    @model_validator(mode="after")
    def _range(self) -> FittedParameter:
        if not self.low < self.high:
            raise ValueError(f"empty range: {self.low:g} is not below {self.high:g}")
        return self


class Measured(Checked):
    """A measured indicator and its standard uncertainty, absolute or as a share of the value.

    With ``relative`` its residual is the logarithm of the ratio; ``note`` is for the reader.
    """

    value: float
    uncertainty: Annotated[float, Field(gt=0)] | None = None
    relative: Annotated[float, Field(gt=0, le=10)] | None = None
    unit: str | None = None
    note: str = ""

    @model_validator(mode="after")
    def _one(self) -> Measured:
        if (self.uncertainty is None) == (self.relative is None):
            raise ValueError("give exactly one of uncertainty, relative")
        if self.relative is not None and self.value <= 0:
            raise ValueError(f"value: must be above 0 with relative, got {self.value:g}")
        return self


class Experiment(Checked):
    """A scenario that was carried out, and what was measured."""

    scenario: str
    name: str = ""
    group: str = ""
    set: tuple[str, ...] = ()
    measured: Annotated[dict[str, Measured], Field(min_length=1)]

    @model_validator(mode="after")
    def _units(self) -> Experiment:
        for name, each in self.measured.items():
            factor(name, each.unit)
        return self

    @property
    def label(self) -> str:
        """Label in tables and messages."""
        return self.name or self.scenario

    @property
    def own_group(self) -> str:
        """The group it is left out with: its own if it names none."""
        return self.group or self.label


class FitTable(Checked):
    """Experiments with their indicators, and the parameters that are to explain them.

    Attributes:
        title: Subject, in a line.
        set: Overrides ``key=value`` of all experiments.
        parameters: By name; those that are ``relative`` after what they are relative to.
        experiments: At least one.
        population: Samples drawn for a search; 0 for eight a parameter.
        generations: Most steps of a search.
        restarts: Searches of all experiments, each from a different one of the best samples.
    """

    title: str
    set: tuple[str, ...] = ()
    parameters: Annotated[dict[str, FittedParameter], Field(min_length=1)]
    experiments: tuple[Experiment, ...]
    population: Annotated[int, Field(ge=0, le=1000)] = 0
    generations: Annotated[int, Field(ge=1, le=1000)] = 12
    restarts: Annotated[int, Field(ge=1, le=20)] = 2

    @model_validator(mode="after")
    def _sensible(self) -> FitTable:
        count = sum(len(each.measured) for each in self.experiments)
        if count < len(self.parameters):
            raise ValueError(
                f"experiments: {plural(count, 'measured indicator')} cannot determine "
                f"{len(self.parameters)} parameters; give at least as many"
            )
        labels = [each.label for each in self.experiments]
        check_named_once("experiments", labels, "; give each a name")
        for name, parameter in self.parameters.items():
            for group in parameter.groups:
                if group not in self.groups:
                    raise ValueError(
                        f"parameters.{name}.groups: no '{group}'{nearest(group, self.groups)}"
                    )
        return self

    @property
    def groups(self) -> tuple[str, ...]:
        """The groups of experiments, in their order; each is left out once."""
        return tuple(dict.fromkeys(each.own_group for each in self.experiments))


def read(name: str) -> FitTable:
    """The table of a shipped name or a TOML file.

    Raises:
        ScenarioError: If it does not exist, or anything in it is unknown or out of range.
    """
    return read_model(FitTable, chosen("table", name, shipped_in("fits")))


LOST_RESIDUAL = 10.0
"""Residual of an indicator that a run does not have, for example after a lost ball."""
MIN_LOG_ARGUMENT = 1e-9
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
            return LOST_RESIDUAL
        if self.logarithmic:
            off = math.log(max(computed, MIN_LOG_ARGUMENT) / self.measured)
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
                    unit=MEASURED_UNITS[name],
                    measured=by * about.value,
                    scale=about.relative or by * (about.uncertainty or 1.0),
                    logarithmic=logarithmic,
                )
            )
    return tuple(found)


def compute_cells(numbers: tuple[Cell, ...], sample: Sample, found: Indicators) -> Array:
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
"""Indicators of runs; nan where a run has no such indicator."""


class Runs:
    """Carries out experiments with given parameters; what a store holds is not run again.

    Args:
        table: The experiments.
        store: Where finished runs are kept.
        how: Further arguments of ``carry``.

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


def round_sample(share: Array, table: FitTable) -> Sample:
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
    return (np.array(sample) - ends[:, 0]) / (ends[:, 1] - ends[:, 0])
