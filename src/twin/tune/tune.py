"""A tune from end to end: search, verdict on the mechanism, certificate on fresh rigs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from twin.tune.candidate import Candidate, Score, score
from twin.tune.certificate import certified
from twin.tune.schema import Tune
from twin.tune.search import best_of, searched
from twin.tune.sensitivity import Neighbour, importance, neighbours
from twin.tune.trials import Trials


@dataclass(frozen=True, kw_only=True)
class TuneResult:
    """What a tune found.

    Attributes:
        tune: What was asked.
        candidates: All that were tried; the first is where the tuning began.
        finalists: The best of them, and what each is worth where the verdict is given.
        chosen: The best of these.
        neighbours: The chosen one with one field changed, each.
        before: What fresh rigs certify of the beginning, as ``certified`` tells it.
        after: The same of the chosen one.
        runs: How many runs were asked for.
    """

    tune: Tune
    candidates: list[Candidate]
    finalists: list[tuple[Candidate, Score]]
    chosen: Candidate
    neighbours: list[Neighbour]
    before: dict[str, Any]
    after: dict[str, Any]
    runs: int

    @property
    def verdict(self) -> Score:
        """What the chosen one is worth where the verdict is given."""
        return next(found for each, found in self.finalists if each is self.chosen)

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
            "importance": importance(self.neighbours),
            "neighbours": [each._asdict() for each in self.neighbours],
            "before": self.before,
            "after": self.after,
            "candidates": [each.as_dict() for each in self.candidates],
        }


def tuned(
    trials: Trials,
    advance: Callable[[float], None] = lambda _: None,
    *,
    sensitivity: bool = True,
) -> TuneResult:
    """Carry a tune out.

    The certificate's rigs are drawn when all is decided.

    Args:
        trials: What carries out its runs.
        advance: Called with the share done, 0 to 1.
        sensitivity: Whether the neighbours of the chosen one are run, too.

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
        neighbours=neighbours(trials, chosen) if sensitivity else [],
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
