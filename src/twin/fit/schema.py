"""What a table to be fitted may say, its indicators and their units, checked."""

from __future__ import annotations

from math import degrees
from typing import Annotated

from pydantic import Field, model_validator

from twin.errors import nearest
from twin.run.indicators import UNITS as ALL_UNITS
from twin.shipped import chosen, shipped_in
from twin.validation import Checked, check_named_once, read_model

OF_THE_RUN = {"outcome_time", "judged_from", "real_time_factor"}
"""Indicators that say how a run went, not what the ball did."""
UNITS = {name: unit for name, unit in ALL_UNITS.items() if name not in OF_THE_RUN}
"""The indicators of a run that can be measured, and the unit of each."""
FACTORS = {
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "s": {"s": 1.0, "ms": 1e-3},
    "%": {"%": 1.0, "1": 100.0},
    "deg": {"deg": 1.0, "rad": degrees(1.0)},
    "rad/s^2": {"rad/s^2": 1.0, "deg/s^2": 1 / degrees(1.0)},
}
"""Of each unit what it may also be written in, and by what that is multiplied."""


def factor(name: str, unit: str | None) -> float:
    """What a number in a unit is multiplied by to be in the indicator's own.

    Args:
        name: Of the indicator.
        unit: As written; None for the indicator's own.

    Raises:
        ValueError: If there is no such indicator, or it cannot have this unit.
    """
    if name not in UNITS:
        raise ValueError(f"no indicator '{name}'{nearest(name, UNITS)}")
    known = FACTORS[UNITS[name]]
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
        relative: Whether the value is a factor on what the experiment, or a parameter named before
            this one, says of the key.
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

    One with ``relative`` is judged by the logarithm of the ratio; ``note`` is for the reader.
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
        """What to call it."""
        return self.name or self.scenario

    @property
    def own_group(self) -> str:
        """The group it is left out with: its own if it names none."""
        return self.group or self.label


class FitTable(Checked):
    """Experiments with their indicators, and the parameters that are to explain them.

    Attributes:
        title: What it is about.
        set: Overrides ``key=value`` of all experiments.
        parameters: By name; those that are ``relative`` after what they are relative to.
        experiments: At least one.
        population: Samples of a generation; 0 for what the method recommends.
        generations: Most of a search.
        restarts: Searches of all experiments that begin with different random numbers.
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
                f"experiments: {count} measured indicators cannot tell "
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
