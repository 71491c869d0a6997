"""The points of a study: values of its parameters, by SALib's designs or on a grid."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray
from SALib.sample import latin, morris, sobol

from twin.study.schema import Study

Array = NDArray[np.floating]
Point = dict[str, float | str]

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


def points(study: Study) -> list[Point]:
    """The points of a study, in the order its analysis needs."""
    keys = list(study.parameters)
    if study.method == "grid":
        steps = [study.parameters[key].steps(study.samples) for key in keys]
        return [dict(zip(keys, values, strict=True)) for values in itertools.product(*steps)]
    if study.method == "oat":
        return [
            {key: value} for key in keys for value in study.parameters[key].steps(study.samples)
        ]
    return [
        {key: study.parameters[key].at(float(q)) for key, q in zip(keys, row, strict=True)}
        for row in quantiles(study)
    ]
