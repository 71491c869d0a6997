"""A tune from end to end: search, verdict on the mechanism, certificate on fresh rigs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from twin.tune.search import (
    Candidate,
    Score,
    best_of,
    rig_costs,
    score,
    searched,
    tail_mean,
)
from twin.tune.trials import Indicators, Trials, Tune

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


@dataclass(frozen=True, kw_only=True)
class TuneResult:
    """What a tune found.

    Attributes:
        tune: What was asked.
        candidates: All that were tried; the first is where the tuning began.
        finalists: The best of them, and what each is worth where the verdict is given.
        chosen: The best of these.
        before: What fresh rigs certify of the beginning, as ``certified`` tells it.
        after: The same of the chosen one.
        runs: How many runs were asked for.
    """

    tune: Tune
    candidates: list[Candidate]
    finalists: list[tuple[Candidate, Score]]
    chosen: Candidate
    before: dict[str, Any]
    after: dict[str, Any]
    runs: int

    def worth(self, candidate: Candidate) -> Score:
        """What a finalist is worth where the verdict is given."""
        return next(found for each, found in self.finalists if each is candidate)

    @property
    def verdict(self) -> Score:
        """What the chosen one is worth there."""
        return self.worth(self.chosen)

    @property
    def good(self) -> bool:
        """Whether the chosen one keeps every constraint and lost no fresh rig."""
        return self.verdict.kept and not self.after["failures"]

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``."""
        return {
            "title": self.tune.title,
            "family": self.tune.family,
            "tail": self.tune.tail,
            "search_draw": self.tune.draw,
            "search_rigs": self.tune.rigs[-1],
            "certificate_draw": self.tune.certificate_draw,
            "runs": self.runs,
            "kept": self.verdict.kept,
            "chosen": self.chosen.as_dict(),
            "verdict_cost": self.verdict.cost,
            "before": self.before,
            "after": self.after,
            "candidates": [each.as_dict() for each in self.candidates],
        }


def tuned(
    trials: Trials,
    advance: Callable[[float], None] = lambda _: None,
) -> TuneResult:
    """Carry a tune out.

    The certificate's rigs are drawn when all is decided.

    Args:
        trials: What carries out its runs.
        advance: Called with the share done, 0 to 1.

    Raises:
        ScenarioError: If the extra is not installed.
        TwinError: If a run cannot be carried out.
    """
    tune = trials.tune
    shares = planned_runs(tune)
    whole = sum(shares)
    candidates = searched(trials, lambda done: advance(shares[0] / whole * done / tune.candidates))
    best = best_of(candidates, tune.finalists)
    some = best if candidates[0] in best else [*best, candidates[0]]
    gave = trials.indicators(
        [(each.fields, tune.rigs[-1]) for each in some], tune.draw, tune.verdict
    )
    finalists = [
        (each, score(tune, each.loop, found)) for each, found in zip(some, gave, strict=True)
    ]
    advance((shares[0] + shares[1]) / whole)
    chosen = min(finalists, key=lambda item: item[1].rank)[0]
    compared = [candidates[0].fields, chosen.fields]
    before, after = (
        certified(tune, found)
        for found in trials.indicators(
            [(fields, tune.certificate) for fields in compared],
            tune.certificate_draw,
            tune.verdict,
        )
    )
    advance(1.0)
    return TuneResult(
        tune=tune,
        candidates=candidates,
        finalists=finalists,
        chosen=chosen,
        before=before,
        after=after,
        runs=trials.finished,
    )


def planned_runs(tune: Tune) -> tuple[int, int, int]:
    """About how many runs search, verdict and certificate take: the most that are likely."""
    tasks, left, runs, before = len(tune.tasks), float(tune.candidates), 0.0, 0
    for rigs in tune.rigs:
        # what was run on fewer rigs is not run again
        runs += left * (rigs - before) * tasks
        left, before = left / tune.eta, rigs
    return (
        round(runs),
        (tune.finalists + 1) * tune.rigs[-1] * tasks,
        2 * tune.certificate * tasks,
    )
