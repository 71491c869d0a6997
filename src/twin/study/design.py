"""The points of a study: values of its parameters, by SALib's designs or on a grid."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from SALib.sample import latin, morris, sobol

from controllers.arrays import Array
from twin.study.family import Point, column
from twin.study.schema import Study

LEVELS = 4
"""Levels of Morris's trajectories."""
SEED = 1
"""Of the designs: the same study has the same points."""


def problem(study: Study) -> dict[str, Any]:
    """The study for SALib: its designs work on quantiles."""
    names = list(study.parameters)
    return {"num_vars": len(names), "names": names, "bounds": [[0.0, 1.0]] * len(names)}


def quantiles(study: Study) -> Array:
    """The design in quantiles, shape (points, parameters); of the methods that have one."""
    about, count = problem(study), study.samples
    found: Array
    if study.method == "sobol":
        found = sobol.sample(about, count, calc_second_order=False, seed=SEED)
    elif study.method == "morris":
        found = morris.sample(about, count, num_levels=LEVELS, seed=SEED)
    elif study.method == "lhs":
        found = latin.sample(about, count, seed=SEED)
    else:
        found = np.random.default_rng(SEED).uniform(size=(count, about["num_vars"]))
    return np.asarray(found)


class Design(Sequence[Point]):
    """The points of a study, kept by columns.

    Args:
        columns: Values by key, shape (points,) each; None where a point leaves a key as it is.
    """

    def __init__(self, columns: Mapping[str, NDArray[Any]]) -> None:
        self.columns = dict(columns)

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def __getitem__(self, index: Any) -> Any:
        """One point; of a list of places or a slice, a design of those."""
        if isinstance(index, int):
            values = ((key, each.item(index)) for key, each in self.columns.items())
            return {key: value for key, value in values if value is not None}
        return Design({key: each[index] for key, each in self.columns.items()})


def points(study: Study) -> Design:
    """The points of a study, in the order its analysis needs."""
    about = study.parameters
    if study.method == "grid":
        steps = [about[key].steps(study.samples) for key in about]
        values = zip(*itertools.product(*steps), strict=True)
        return Design({key: column(each) for key, each in zip(about, values, strict=True)})
    if study.method == "oat":
        each = [(key, value) for key in about for value in about[key].steps(study.samples)]
        return Design(
            {key: column([value if name == key else None for name, value in each]) for key in about}
        )
    rows = quantiles(study)
    return Design({key: about[key].at(rows[:, k]) for k, key in enumerate(about)})
