"""What fresh rigs say: how often a controller loses one, and how large its error is."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import stats

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


def certified(tune: Tune, found: Indicators) -> dict[str, Any]:
    """What the runs on fresh rigs certify, as ``--json`` says it.

    Rigs and how many of them did not finish every task, the rate of failure that this excludes, the
    mean cost of the worst share of them, None if one failed. Of each task: how many finished it,
    quantiles of its indicator over those, the median root mean square effort in rad/s^2, and the
    indicator rig by rig, None where it was not finished. At last why runs did not finish.

    Args:
        tune: With the tasks.
        found: What they gave.
    """
    rigs, lost = len(found.values), found.lost
    costs = rig_costs(found.values, np.array([task.scale for task in tune.tasks]))
    tasks = {}
    for task, values, effort in zip(tune.tasks, found.values.T, found.effort.T, strict=True):
        good = values[np.isfinite(values)]
        middle, most, largest = np.quantile(good, QUANTILES).tolist() if len(good) else (None,) * 3
        tasks[task.name] = {
            "finished": len(good),
            "median": middle,
            "quantile_90": most,
            "largest": largest,
            "effort": float(np.nanmedian(effort)) if len(good) else None,
            "values": [None if np.isnan(value) else value for value in values.tolist()],
        }
    return {
        "rigs": rigs,
        "failures": lost,
        "failure_rate_below": upper_bound(lost, rigs),
        "confidence": CONFIDENCE,
        "cost": None if lost else tail_mean(costs, tune.tail),
        "tasks": tasks,
        "reasons": found.reasons,
    }
