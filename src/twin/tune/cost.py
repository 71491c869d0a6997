"""What a candidate costs over its rigs, and what it must keep."""

from __future__ import annotations

import math

import numpy as np

from controllers.arrays import Array


def tail_mean(costs: Array, tail: float) -> float:
    """Mean of the worst share of costs: CVaR at 1 - tail, of the empirical distribution.

    The cost at the edge of the share counts with the part of it that lies within, as in the
    definition of Rockafellar and Uryasev for distributions with steps.

    Args:
        costs: One per rig, shape (rigs,).
        tail: The share, above 0, up to 1.
    """
    worst = np.sort(costs)[::-1]
    weights = np.clip(tail * len(worst) - np.arange(len(worst)), 0.0, 1.0)
    return float(worst @ weights / weights.sum())


def rig_costs(indicators: Array, scales: Array) -> Array:
    """Cost of each rig: the mean of indicator / scale over the tasks, shape (rigs,).

    Args:
        indicators: Shape (rigs, tasks); NaN where a run did not finish.
        scales: Of the tasks, shape (tasks,).
    """
    found: Array = (indicators / scales).mean(axis=1)
    return found


def violation(constraints: dict[str, float]) -> float:
    """How far the constraints are from being kept, together; 0 if all are."""
    return math.fsum(max(value, 0.0) for value in constraints.values())
