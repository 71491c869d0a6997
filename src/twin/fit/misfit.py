"""How far computed indicators are from measured ones, in units of their uncertainty."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from controllers.arrays import Array
from twin.fit.indicators import UNITS, factor
from twin.fit.runs import Sample, Wanted
from twin.fit.schema import FitTable

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


def computed(
    numbers: tuple[Cell, ...], sample: Sample, found: Mapping[Wanted, Mapping[str, float]]
) -> Array:
    """The computed values of cells for a sample, shape (cells,)."""
    return np.array([found[sample, cell.experiment][cell.indicator] for cell in numbers])


def residuals(numbers: tuple[Cell, ...], values: Array) -> Array:
    """Residuals of cells for computed values, both shape (cells,)."""
    return np.array([c.residual(v) for c, v in zip(numbers, values.tolist(), strict=True)])
