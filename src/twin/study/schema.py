"""What a study file may say, checked."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from twin.errors import nearest
from twin.run.files import METRICS
from twin.shipped import chosen, shipped_in
from twin.study.family import Parameter
from twin.study.family import read as read_family
from twin.validation import Checked, check_named_once, read_model

Method = Literal["grid", "oat", "lhs", "montecarlo", "morris", "sobol"]


class Variant(Checked):
    """One of several things to compare on equal terms: a name and what it changes."""

    name: str
    set: tuple[str, ...] = ()


class Study(Checked):
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
        family: Name or file of a family of rigs whose parameters are the study's, too.
        parameters: Dotted scenario key to what it may be; ``key.0`` is the first number of a list.
        variants: What is compared; one unnamed if empty.
    """

    title: str
    scenario: str
    set: tuple[str, ...] = ()
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
        unknown = [name for name in self.metrics if name not in METRICS]
        if unknown:
            raise ValueError(f"metrics: no '{unknown[0]}'{nearest(unknown[0], METRICS)}")
        check_named_once("variants", [variant.name for variant in self.variants])
        if self.method == "sobol" and self.samples.bit_count() > 1:
            power = 1 << self.samples.bit_length()
            raise ValueError(
                f"samples: sobol needs a power of 2, such as {power // 2} or {power}, "
                f"got {self.samples}"
            )
        if self.method in {"sobol", "morris"}:
            for key, parameter in self.parameters.items():
                if not parameter.continuous:
                    raise ValueError(f"parameters.{key}: {self.method} needs a distribution")
        return self

    @property
    def compared(self) -> tuple[Variant, ...]:
        """The variants, or one that changes nothing."""
        return self.variants or (Variant(name=self.scenario),)


def read(name: str, **given: Any) -> Study:
    """The study of a shipped name or a TOML file.

    Args:
        name: Its name or file.
        given: Keys in place of the study's own; None for those that are not.

    Raises:
        ScenarioError: If it does not exist, or anything in it is unknown or out of range.
    """
    return read_model(Study, chosen("study", name, shipped_in("studies")), **given)
