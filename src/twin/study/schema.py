"""Form of the files of a study and of a family of rigs, checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray
from pydantic import Field, model_validator

from controllers.arrays import Array
from twin.base.errors import ScenarioError
from twin.base.shipped import chosen, shipped_in
from twin.base.validation import Checked, check_model, check_named_once, read_model
from twin.run.indicators import MOTION_INDICATORS, nearest_indicator


class Parameter(Checked):
    """Values of a parameter: a distribution by quantiles, or a list of values.

    Exactly one of ``uniform`` (low, high), ``loguniform`` (low, high), ``normal`` (mean, standard
    deviation, low, high: cut there), ``integers`` (first, last), ``values``. With ``relative`` the
    value is a factor on the value of the scenario or variant.
    """

    uniform: tuple[float, float] | None = None
    loguniform: tuple[float, float] | None = None
    normal: tuple[float, float, float, float] | None = None
    integers: tuple[int, int] | None = None
    values: tuple[float | str, ...] | None = None
    unit: str = ""
    relative: bool = False

    @model_validator(mode="after")
    def _one(self) -> Parameter:
        given = [self.uniform, self.loguniform, self.normal, self.integers, self.values]
        if sum(item is not None for item in given) != 1:
            raise ValueError("give exactly one of uniform, loguniform, normal, integers, values")
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
        ends = self.uniform or self.loguniform or self.integers
        assert ends is not None
        return ends

    @property
    def continuous(self) -> bool:
        """Whether it is a distribution over an interval."""
        return self.values is None and self.integers is None

    def at(self, quantiles: Array) -> NDArray[Any]:
        """The values at quantiles between 0 and 1: numbers, or objects if they are no floats."""
        if self.values is not None:
            count = len(self.values)
            return column([self.values[min(int(q * count), count - 1)] for q in quantiles])
        if self.integers is not None:
            first, last = self.integers
            return column(
                [first + min(int(q * (last - first + 1)), last - first) for q in quantiles]
            )
        low, high = self.ends
        if self.normal is not None:
            mean, deviation = self.normal[:2]
            cut = scipy.stats.truncnorm((low - mean) / deviation, (high - mean) / deviation)
            return np.asarray(mean + deviation * cut.ppf(quantiles))
        if self.loguniform is not None:
            # numpy's power differs in its last bit between processors
            return column([low * (high / low) ** q for q in quantiles.tolist()])
        return low + (high - low) * quantiles

    def steps(self, count: int) -> tuple[float | str, ...]:
        """Its values, or so many quantiles of its distribution from end to end, each once."""
        return self.values or tuple(dict.fromkeys(self.at(np.linspace(0, 1, count)).tolist()))


def column(values: Sequence[float | str]) -> NDArray[Any]:
    """An array of numbers, or of objects if there is anything else among them."""
    numbers = all(isinstance(value, float) for value in values)
    return np.array(values, float if numbers else object)


Point = dict[str, float | str]
"""Dotted scenario key to value; ``key.0`` is the first number of a list."""


def place_of(key: str) -> tuple[str, int | None]:
    """The scenario key that a point's key is, or has a number of, and which; None for all of it."""
    path, _, tail = key.rpartition(".")
    return (path, int(tail)) if path and tail.isdecimal() else (key, None)


class Family(Checked):
    """A family of rigs.

    Attributes:
        title: Subject, in a line.
        parameters: Dotted scenario key to its distribution, each drawn by itself.
    """

    title: str
    parameters: Annotated[dict[str, Parameter], Field(min_length=1)]


class FamilyRig(NamedTuple):
    """One rig of a family.

    Attributes:
        point: Its values by dotted key.
        seed: Seed of its noise.
    """

    point: Point
    seed: int


def draw_rigs(family: Family, draw: int, count: int) -> list[FamilyRig]:
    """The first rigs of a draw; independent of each other, and of how many are asked for.

    Args:
        family: What they are drawn from.
        draw: Number of the draw; no two draws have a rig in common.
        count: How many.
    """
    roots = (np.random.SeedSequence(draw, spawn_key=(index,)) for index in range(count))
    streams = [np.random.default_rng(root) for root in roots]
    quantiles = np.array([stream.random(len(family.parameters)) for stream in streams])
    columns = {
        key: parameter.at(quantiles[:, place])
        for place, (key, parameter) in enumerate(family.parameters.items())
    }
    return [
        FamilyRig(
            {key: values.item(index) for key, values in columns.items()},
            int(stream.integers(2**31)),
        )
        for index, stream in enumerate(streams)
    ]


def read_family(name: str | Mapping[str, Any]) -> Family:
    """The family of a shipped name, a TOML file, or tables as such a file has them.

    Raises:
        ScenarioError: If it does not exist, or anything in it is unknown or out of range.
    """
    if isinstance(name, Mapping):
        return check_model(Family, name, "family")
    return read_model(Family, chosen("family", name, shipped_in("families")))


Method = Literal["grid", "lhs", "montecarlo", "sobol"]
Engine = Literal["python", "c"]


class Variant(Checked):
    """One of several variants to compare on equal terms: a name and its changes.

    Attributes:
        name: Its name.
        scenario: Name or file of a scenario in place of the study's.
        set: Overrides ``key=value``, over those of the study.
    """

    name: str
    scenario: str = ""
    set: tuple[str, ...] = ()


class Study(Checked):
    """A study.

    Attributes:
        title: Subject, in a line.
        scenario: Name or file of the scenario.
        set: Overrides ``key=value`` of all runs.
        method: How points are chosen.
        samples: ``lhs``, ``montecarlo``: runs; ``sobol``: base samples; ``grid``: steps of a
            distribution.
        seeds: Runs a point that differ in their noise, the same for every variant.
        metrics: Indicators that are compared, the most important first.
        family: Name or file of a family of rigs; the study has its parameters, too.
        parameters: Dotted scenario key to its distribution; ``key.0`` is the first number of a
            list.
        variants: The compared variants; one unnamed if empty.
        engine: What carries out the runs: ``python``, many rigs in a batch; or ``c``, each rig with
            its controller in a compiled loop, for the exact equations alone.
    """

    title: str
    scenario: str
    set: tuple[str, ...] = ()
    engine: Engine = "python"
    method: Method
    samples: Annotated[int, Field(ge=2, le=1_000_000)] = 16
    seeds: Annotated[int, Field(ge=1, le=10_000)] = 1
    metrics: Annotated[tuple[str, ...], Field(min_length=1)] = ("tracking_error_percent",)
    family: str = ""
    parameters: dict[str, Parameter] = Field({}, min_length=1, validate_default=True)
    variants: tuple[Variant, ...] = ()

    @model_validator(mode="before")
    @classmethod
    def _with_family(cls, tables: Any) -> Any:
        """Put in the parameters of the family; the study's own replace them."""
        name = tables.get("family") if isinstance(tables, dict) else None
        own = tables.get("parameters", {}) if isinstance(tables, dict) else None
        if not isinstance(name, str) or not name or not isinstance(own, dict):
            return tables
        return {**tables, "parameters": read_family(name).parameters | own}

    @model_validator(mode="after")
    def _sensible(self) -> Study:
        unknown = [name for name in self.metrics if name not in MOTION_INDICATORS]
        if unknown:
            raise ValueError(f"metrics: no '{unknown[0]}'{nearest_indicator(unknown[0])}")
        check_named_once("variants", [variant.name for variant in self.variants])
        if self.method == "sobol" and self.samples.bit_count() > 1:
            power = 1 << self.samples.bit_length()
            raise ValueError(
                f"samples: sobol needs a power of 2, such as {power // 2} or {power}, "
                f"got {self.samples}"
            )
        for key, parameter in self.parameters.items():
            if self.method == "sobol" and not parameter.continuous:
                raise ValueError(f"parameters.{key}: sobol needs a distribution")
        return self

    @property
    def compared(self) -> tuple[Variant, ...]:
        """The variants, or one that changes nothing."""
        return self.variants or (Variant(name=self.scenario),)


def read(name: str | Mapping[str, Any], **given: Any) -> Study:
    """The study of a shipped name, a TOML file, or tables as such a file has them.

    Args:
        name: Its name, file or tables.
        given: Keys in place of the study's own; None for those that are not.

    Raises:
        ScenarioError: If it does not exist, anything in it is unknown or out of range, or it has no
            use for a key that is given.
    """
    if isinstance(name, Mapping):
        found, source = check_model(Study, name, "study", **given), "study"
    else:
        path = chosen("study", name, shipped_in("studies"))
        found, source = read_model(Study, path, **given), path.name
    stepped = any(each.continuous for each in found.parameters.values())
    if given.get("samples") and found.method == "grid" and not stepped:
        raise ScenarioError(
            f"{source}: samples: has no effect on a grid of values, which runs all of them; "
            "leave it out, or set seeds"
        )
    return found
