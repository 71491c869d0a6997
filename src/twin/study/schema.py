"""What a study file may say, checked."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from scipy import stats

from controllers.arrays import Array
from twin.data_file import DataError, read_toml
from twin.errors import ScenarioError, nearest
from twin.run.metrics import Metrics
from twin.shipped import chosen, folder

STRICT = ConfigDict(extra="forbid", strict=False, frozen=True, allow_inf_nan=False)
Method = Literal["grid", "oat", "lhs", "montecarlo", "morris", "sobol"]
METRICS = tuple(
    name
    for name in Metrics.__dataclass_fields__
    if name not in {"outcome", "outcome_time", "reason"}
)


class Parameter(BaseModel):
    """What a parameter may be: a distribution by quantiles, or a list of values.

    Exactly one of ``uniform`` (low, high), ``loguniform`` (low, high), ``normal`` (mean, standard
    deviation, low, high: cut there), ``values``. With ``relative`` the value is a factor on what
    the scenario or variant says.
    """

    model_config = STRICT

    uniform: tuple[float, float] | None = None
    loguniform: tuple[float, float] | None = None
    normal: tuple[float, float, float, float] | None = None
    values: tuple[float | str, ...] | None = None
    unit: str = ""
    relative: bool = False

    @model_validator(mode="after")
    def _one(self) -> Parameter:
        given = [self.uniform, self.loguniform, self.normal, self.values]
        if sum(item is not None for item in given) != 1:
            raise ValueError("give exactly one of uniform, loguniform, normal, values")
        if self.values is not None:
            if not self.values:
                raise ValueError("values: must not be empty")
            texts = [isinstance(value, str) for value in self.values]
            if any(texts) and not all(texts):
                raise ValueError("values: must be all numbers or all texts")
            if self.relative and any(texts):
                raise ValueError("values: must be numbers if they are relative")
            return self
        low, high = self.ends
        if not low < high:
            raise ValueError(f"empty range: {low:g} is not below {high:g}")
        if self.loguniform is not None and low <= 0:
            raise ValueError("loguniform: must begin above 0")
        if self.normal is not None and self.normal[1] <= 0:
            raise ValueError("normal: the standard deviation must be above 0")
        return self

    @property
    def ends(self) -> tuple[float, float]:
        """Lowest and highest value of a distribution."""
        if self.normal is not None:
            return self.normal[2], self.normal[3]
        ends = self.uniform or self.loguniform
        assert ends is not None
        return ends

    def at(self, quantiles: Array) -> NDArray[Any]:
        """The values at quantiles between 0 and 1: numbers, or objects if they are texts."""
        if self.values is not None:
            count = len(self.values)
            return column([self.values[min(int(q * count), count - 1)] for q in quantiles])
        low, high = self.ends
        if self.normal is not None:
            mean, deviation = self.normal[:2]
            cut = stats.truncnorm((low - mean) / deviation, (high - mean) / deviation)
            return np.asarray(mean + deviation * cut.ppf(quantiles))
        if self.loguniform is not None:
            # numpy's power differs in its last bit from one processor to another
            return column([low * (high / low) ** q for q in quantiles.tolist()])
        return low + (high - low) * quantiles

    def steps(self, count: int) -> tuple[float | str, ...]:
        """Its values, or so many quantiles of its distribution from end to end."""
        return self.values or tuple(self.at(np.linspace(0, 1, count)).tolist())


def column(values: Sequence[float | str | None]) -> NDArray[Any]:
    """An array of numbers, or of objects if there is anything else among them."""
    numbers = all(isinstance(value, float) for value in values)
    return np.array(values, float if numbers else object)


class Variant(BaseModel):
    """One of several things to compare on equal terms: a name and what it changes."""

    model_config = STRICT

    name: str
    set: tuple[str, ...] = ()


class Study(BaseModel):
    """A study.

    Attributes:
        title: What it is about.
        scenario: Name or file of the scenario.
        set: Overrides ``key=value`` of all runs.
        method: How points are chosen.
        samples: ``lhs``, ``montecarlo``: runs; ``sobol``, ``morris``: base samples or
            trajectories; ``grid``, ``oat``: steps of a distribution.
        seeds: Runs a point that differ in their noise, the same for every variant.
        metrics: Indicators of a run that are judged, the first above all.
        parameters: Dotted scenario key to what it may be; ``key.0`` is the first number of a list.
        variants: What is compared; one unnamed if empty.
    """

    model_config = STRICT

    title: str
    scenario: str
    set: tuple[str, ...] = ()
    method: Method
    samples: Annotated[int, Field(ge=2, le=1_000_000)] = 16
    seeds: Annotated[int, Field(ge=1, le=10_000)] = 1
    metrics: tuple[str, ...] = ("tracking_error_percent",)
    parameters: dict[str, Parameter]
    variants: tuple[Variant, ...] = ()

    @model_validator(mode="after")
    def _sensible(self) -> Study:
        unknown = [name for name in self.metrics if name not in METRICS]
        if unknown:
            raise ValueError(f"metrics: no '{unknown[0]}'{nearest(unknown[0], METRICS)}")
        if not self.metrics:
            raise ValueError("metrics: name at least one")
        if not self.parameters:
            raise ValueError("parameters: name at least one")
        names = [variant.name for variant in self.variants]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise ValueError(f"variants: two of them are called '{twice}'")
        if self.method == "sobol" and self.samples.bit_count() > 1:
            power = 1 << self.samples.bit_length()
            raise ValueError(
                f"samples: sobol needs a power of 2, such as {power // 2} or {power}, "
                f"got {self.samples}"
            )
        if self.method in {"sobol", "morris"}:
            for key, parameter in self.parameters.items():
                if parameter.values is not None:
                    raise ValueError(f"parameters.{key}: {self.method} needs a distribution")
        return self

    @property
    def compared(self) -> tuple[Variant, ...]:
        """The variants, or one that changes nothing."""
        return self.variants or (Variant(name=self.scenario),)


def shipped() -> dict[str, Path]:
    """The shipped studies by name."""
    return {path.stem: path for path in sorted((folder() / "studies").glob("*.toml"))}


def read(name: str, **given: Any) -> Study:
    """The study of a shipped name or a TOML file.

    Args:
        name: Its name or file.
        given: Keys in place of the study's own; None for those that are not.

    Raises:
        ScenarioError: If it does not exist, or anything in it is unknown or out of range.
    """
    path = chosen("study", name, shipped())
    try:
        tables = read_toml(path)
        tables |= {key: value for key, value in given.items() if value is not None}
        return Study.model_validate(tables)
    except DataError as error:
        raise ScenarioError(f"{path.name}: {error}") from error
    except ValidationError as error:
        raise ScenarioError(f"{path.name}: {_one_line(error)}") from None


def _one_line(error: ValidationError) -> str:
    # an unknown key explains a missing one beside it, so it comes first
    first = min(error.errors(), key=lambda item: item["type"] != "extra_forbidden")
    place = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        inner: dict[str, type[BaseModel]] = {"parameters": Parameter, "variants": Variant}
        model = inner.get(str(first["loc"][0]), Study) if len(first["loc"]) > 1 else Study
        return f"{place}: unknown key{nearest(str(first['loc'][-1]), model.model_fields)}"
    if first["type"] == "missing":
        return f"{place}: missing; it has no default"
    text = first["msg"].removeprefix("Value error, ").replace("Input should", "must")
    return f"{place}: {text}" if place else text
