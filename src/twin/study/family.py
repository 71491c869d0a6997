"""A family of rigs: what is not known of a rig, as distributions, and rigs drawn from it."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from pydantic import BaseModel, model_validator

from twin.shipped import chosen, shipped_in
from twin.study.distribution import Parameter
from twin.validation import LENIENT, read_model

Point = dict[str, float | str]
"""Dotted scenario key to value; ``key.0`` is the first number of a list."""


class Family(BaseModel):
    """A family of rigs.

    Attributes:
        title: What it is about.
        parameters: Dotted scenario key to what it may be, each drawn by itself.
    """

    model_config = LENIENT

    title: str
    parameters: dict[str, Parameter]

    @model_validator(mode="after")
    def _sensible(self) -> Family:
        if not self.parameters:
            raise ValueError("parameters: name at least one")
        return self


class FamilyRig(NamedTuple):
    """One rig of a family.

    Attributes:
        point: What it is.
        seed: Of its noise.
    """

    point: Point
    seed: int


def drawn(family: Family, draw: int, count: int) -> list[FamilyRig]:
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


def shipped() -> dict[str, Path]:
    """The shipped families by name."""
    return shipped_in("families")


def read(name: str) -> Family:
    """The family of a shipped name or a TOML file.

    Raises:
        ScenarioError: If it does not exist, or anything in it is unknown or out of range.
    """
    return read_model(Family, chosen("family", name, shipped()))
