"""What fresh rigs say: how often a controller loses one, and how large its error is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from controllers.arrays import Array
from twin.tune.cost import rig_costs, tail_mean
from twin.tune.schema import Tune
from twin.tune.trials import Indicators

CONFIDENCE = 0.95
QUANTILES = (0.5, 0.9, 1.0)


def upper_bound(failures: int, rigs: int, confidence: float = CONFIDENCE) -> float:
    """The failure rate that so few failures exclude with a confidence, one-sided, exact.

    Clopper and Pearson 1934: the p at which at most so many failures of so many rigs have the
    probability 1 - confidence.

    Args:
        failures: How many rigs failed.
        rigs: Of how many that were drawn independently.
        confidence: Between 0 and 1.
    """
    less = stats.binomtest(failures, rigs, alternative="less")
    return float(less.proportion_ci(confidence, method="exact").high)


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """One controller on fresh rigs.

    Attributes:
        rigs: How many.
        failures: Rigs that did not finish every task.
        bound: Upper bound of the rate of failure.
        quantiles: Of each task's indicator over the rigs that finished it: the median, 90 % and
            the largest; None if none did.
        effort: The same of the root mean square effort in rad/s^2.
        finished: Rigs that finished each task.
        cost: Mean cost of the worst share of the rigs; None if one failed.
        values: Each task's indicator, rig by rig; None where it was not finished.
        reasons: Why runs did not finish.
    """

    rigs: int
    failures: int
    bound: float
    quantiles: dict[str, tuple[float, ...] | None]
    effort: dict[str, tuple[float, ...] | None]
    finished: dict[str, int]
    cost: float | None
    values: dict[str, list[float | None]]
    reasons: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``."""
        return {
            "rigs": self.rigs,
            "failures": self.failures,
            "failure_rate_below": self.bound,
            "confidence": CONFIDENCE,
            "cost": self.cost,
            "tasks": {
                name: {
                    "finished": self.finished[name],
                    "median": None if found is None else found[0],
                    "quantile_90": None if found is None else found[1],
                    "largest": None if found is None else found[2],
                    "values": self.values[name],
                }
                for name, found in self.quantiles.items()
            },
            "reasons": self.reasons,
        }


def certified(tune: Tune, found: Indicators) -> Certificate:
    """What the runs on fresh rigs certify.

    Args:
        tune: With the tasks.
        found: What they gave.
    """
    rigs, lost = len(found.values), found.lost
    names = [task.name for task in tune.tasks]
    scales = np.array([task.scale for task in tune.tasks])

    def quantiles(table: Array) -> dict[str, Any]:
        columns = [column[np.isfinite(column)] for column in table.T]
        return {
            name: tuple(np.quantile(some, QUANTILES).tolist()) if len(some) else None
            for name, some in zip(names, columns, strict=True)
        }

    return Certificate(
        rigs=rigs,
        failures=lost,
        bound=upper_bound(lost, rigs),
        quantiles=quantiles(found.values),
        effort=quantiles(found.effort),
        finished=dict(zip(names, np.isfinite(found.values).sum(axis=0).tolist(), strict=True)),
        cost=None if lost else tail_mean(rig_costs(found.values, scales), tune.tail),
        values={
            name: [None if np.isnan(value) else value for value in column]
            for name, column in zip(names, found.values.T.tolist(), strict=True)
        },
        reasons=found.reasons,
    )
