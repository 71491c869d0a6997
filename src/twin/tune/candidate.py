"""One candidate of a search: its fields, what it costs over its rigs, and what it must keep."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from controllers.arrays import Array
from twin.study.family import Point
from twin.tune.schema import Tune
from twin.tune.trials import Indicators, NominalLoop


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


@dataclass(frozen=True, kw_only=True)
class Score:
    """What a candidate is worth on some rigs.

    Attributes:
        rigs: How many.
        cost: Mean cost of the worst share of them; None if a rig was lost.
        effort: Largest root mean square effort of a run, rad/s^2; None if every run was lost.
        lost: Rigs lost.
        constraints: How far each constraint is from being kept, in its own scale; kept at 0 or
            less.
    """

    rigs: int
    cost: float | None
    effort: float | None
    lost: int
    constraints: dict[str, float]

    @property
    def kept(self) -> bool:
        """Whether it keeps every constraint."""
        return violation(self.constraints) == 0

    @property
    def rank(self) -> tuple[float, float]:
        """What orders scores: first what is violated, then the cost."""
        return violation(self.constraints), np.inf if self.cost is None else self.cost


@dataclass(kw_only=True)
class Candidate:
    """One candidate.

    Attributes:
        number: In the order of the search; 0 is where it begins.
        fields: Values by key.
        loop: Its nominal loop.
        scores: On more and more rigs; empty if it was not simulated.
    """

    number: int
    fields: Point
    loop: NominalLoop
    scores: list[Score] = field(default_factory=list)

    @property
    def last(self) -> Score | None:
        """On the most rigs."""
        return self.scores[-1] if self.scores else None

    def worth_running(self, tune: Tune) -> bool:
        """Whether its nominal loop keeps its margins; where the search begins always is."""
        if self.loop.refused:
            return False
        return self.number == 0 or violation(loop_constraints(tune, self.loop)) == 0

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``."""
        last, loop = self.last, self.loop
        return {
            "number": self.number,
            "fields": self.fields,
            "refused": loop.refused,
            "disk_margin": loop.disk,
            "delay_margin": loop.delay,
            "margins_with_observer": loop.observed,
            "rigs": 0 if last is None else last.rigs,
            "cost": None if last is None else last.cost,
            "effort": None if last is None else last.effort,
            "lost": None if last is None else last.lost,
            "kept": last is not None and last.kept,
        }


def loop_constraints(tune: Tune, loop: NominalLoop) -> dict[str, float]:
    """Constraints on the nominal loop, each as a share of its limit; kept at 0 or less.

    A loop that cannot be linearised has none: nothing can be said of it.

    Args:
        tune: With the limits.
        loop: The loop.
    """
    if loop.refused:
        return {"disk": 1.0, "delay": 1.0}
    limits = tune.limits
    found = {}
    if loop.disk is not None and limits.disk:
        found["disk"] = 1 - loop.disk / limits.disk
    if loop.delay is not None and limits.delay:
        found["delay"] = 1 - loop.delay / limits.delay
    return found


def score(tune: Tune, loop: NominalLoop, found: Indicators) -> Score:
    """What a candidate is worth, from its runs.

    Args:
        tune: With tasks and limits.
        loop: Its nominal loop.
        found: What its runs gave.
    """
    rigs = len(found.values)
    costs = rig_costs(found.values, np.array([task.scale for task in tune.tasks]))
    ran = found.effort[np.isfinite(found.effort)]
    effort = float(ran.max()) if len(ran) else None
    constraints = loop_constraints(tune, loop) | {
        "lost": found.lost / rigs,
        "effort": 0.0 if effort is None else effort / tune.limits.effort - 1,
    }
    cost = tail_mean(costs, tune.tail) if found.lost == 0 else None
    return Score(rigs=rigs, cost=cost, effort=effort, lost=found.lost, constraints=constraints)
