"""The search: candidates proposed by Optuna, evaluated on more and more rigs.

Round by round a tree-structured Parzen estimator proposes candidates from the results of all
earlier ones, constraints included (https://optuna.org). Those with a nominal loop that keeps its
margins run on the first few rigs; of all that ever reached a rung the best go on to the next one,
with more rigs, as in asynchronous successive halving (Li et al. 2020). All meet the same rigs and
the same noise. The search has no state of its own: with the finished runs at hand it is made again,
step by step.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy

from controllers.arrays import Array
from twin.base.parts import extra
from twin.study.schema import Parameter, Point
from twin.tune.trials import Indicators, NominalLoop, Trials, Tune


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
    return (indicators / scales).mean(axis=1)


def violation(constraints: dict[str, float]) -> float:
    """How far the constraints are from being kept, together; 0 if all are."""
    return math.fsum(max(value, 0.0) for value in constraints.values())


@dataclass(frozen=True, kw_only=True)
class Score:
    """Score of a candidate on some rigs.

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
        """Rank of a score: first its violations, then its cost."""
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

    A loop that cannot be linearised has none.

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
    """Score of a candidate, from its runs.

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


MAX_PROPOSALS = 10
"""Most candidates proposed for each that is run: others have a nominal loop without margin."""
VALUE_DIGITS = 5
"""Digits of the values that are tried, so that the printed values are those that were run."""


def library() -> Any:
    """Optuna, quiet.

    Raises:
        TwinError: If the extra is not installed.
    """
    with extra("tune", "tune"):
        import optuna  # noqa: PLC0415
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna


def search_all(trials: Trials, advance: Callable[[int], None] = lambda _: None) -> list[Candidate]:
    """Every candidate of a search, in its order; the first is where it begins.

    Args:
        trials: Carries them out.
        advance: Called with the number of candidates tried so far.

    Raises:
        TwinError: If the extra is not installed, or a run cannot be carried out.
    """
    optuna = library()
    tune, space = trials.tune, _space(trials.tune.fields)
    sampler = optuna.samplers.TPESampler(
        seed=tune.seed, n_startup_trials=max(10, 2 * len(space)), multivariate=True
    )
    study = optuna.create_study(sampler=sampler)
    study.enqueue_trial(dict(trials.start))
    found: list[Candidate] = []
    ran, proposals = 0, MAX_PROPOSALS * tune.candidates
    while ran < tune.candidates and len(found) < proposals:
        asked: list[tuple[Any, Candidate]] = []
        size = min(tune.round, tune.candidates - ran)
        most = min(MAX_PROPOSALS * size, proposals - len(found))
        while size and len(asked) < most:
            new = _propose(study, trials, space, len(found), min(size, most - len(asked)))
            for trial, candidate in new:
                if not candidate.worth_running(tune):
                    _tell(study, trial, candidate, tune)  # so that the next ones know
            asked += new
            found += [candidate for _, candidate in new]
            size -= sum(candidate.worth_running(tune) for _, candidate in new)
        some = [(trial, each) for trial, each in asked if each.worth_running(tune)]
        _climb(trials, found, [candidate for _, candidate in some])
        for trial, candidate in some:
            _tell(study, trial, candidate, tune)
        ran += len(some)
        advance(ran)
    return found


def _propose(
    study: Any, trials: Trials, space: dict[str, Any], begin: int, count: int
) -> list[tuple[Any, Candidate]]:
    """New candidates that the sampler proposes, with their nominal loops."""
    asked = [study.ask(space) for _ in range(count)]
    points = [round_point(trial.params, trials.tune.fields) for trial in asked]
    if begin == 0:
        points[0] = trials.start
    loops = trials.loops(points)
    return [
        (trial, Candidate(number=begin + place, fields=point, loop=loop))
        for place, (trial, point, loop) in enumerate(zip(asked, points, loops, strict=True))
    ]


def _climb(trials: Trials, everyone: Sequence[Candidate], some: Sequence[Candidate]) -> None:
    """Judge new candidates rung by rung, as far as each gets."""
    tune = trials.tune
    left = list(some)
    for rung, rigs in enumerate(tune.rigs):
        if not left:
            return
        gave = trials.indicators([(c.fields, rigs) for c in left], tune.draw, tune.search)
        for candidate, indicators in zip(left, gave, strict=True):
            candidate.scores.append(score(tune, candidate.loop, indicators))
        reached = sorted(c.scores[rung].rank for c in everyone if len(c.scores) > rung)
        edge = reached[math.ceil(len(reached) / tune.eta) - 1]
        good = [c for c in left if c.scores[rung].rank <= edge]
        ahead = sorted(good, key=lambda c: c.scores[rung].rank)[: math.ceil(len(left) / tune.eta)]
        # the first candidate runs on all rigs: the result is compared with it
        left = [c for c in left if c.number == 0 or c in ahead]


def _tell(study: Any, trial: Any, candidate: Candidate, tune: Tune) -> None:
    """Tell the sampler what a candidate gave."""
    last: Score | None = candidate.last
    constraints = last.constraints if last else loop_constraints(tune, candidate.loop)
    if last is None or last.cost is None:  # what a candidate that was not run keeps is not known
        constraints = {"lost": 1.0, **constraints}
    for name, value in constraints.items():
        trial.set_constraint(name, value)
    for each in candidate.scores:
        if each.cost is not None:
            trial.report(each.cost, each.rigs)
    if last is not None and last.cost is not None and last.rigs == tune.rigs[-1]:
        study.tell(trial, last.cost)
    else:
        study.tell(trial, state=library().trial.TrialState.PRUNED)


def best_of(candidates: Sequence[Candidate], count: int) -> list[Candidate]:
    """The best candidates among those on the most rigs that any reached, best first."""
    ran = [(each, each.last) for each in candidates if each.last is not None]
    most = max((last.rigs for _, last in ran), default=0)
    whole = [(last.rank, each.number, each) for each, last in ran if last.rigs == most]
    return [each for *_, each in sorted(whole, key=lambda item: item[:2])[:count]]


def _space(fields: Mapping[str, Parameter]) -> dict[str, Any]:
    """The ranges of the fields as Optuna has them."""
    kinds = library().distributions
    found: dict[str, Any] = {}
    for key, about in fields.items():
        if about.values is not None:
            found[key] = kinds.CategoricalDistribution(about.values)
        elif about.integers is not None:
            found[key] = kinds.IntDistribution(*about.integers)
        else:
            found[key] = kinds.FloatDistribution(*about.ends, log=about.loguniform is not None)
    return found


def round_point(values: Mapping[str, Any], fields: Mapping[str, Parameter]) -> Point:
    """Values of fields in the digits in which they are run, within their ranges."""
    found: Point = {}
    for key, about in fields.items():
        value = values[key]
        if about.continuous:
            low, high = about.ends
            value = min(max(float(f"{value:.{VALUE_DIGITS}g}"), low), high)
        found[key] = value
    return found


BOUND_CONFIDENCE = 0.95
PRINTED_QUANTILES = (0.5, 0.9, 1.0)
SEARCH_SHARE = 0.7
"""Share of a tune that its search takes, about."""


def upper_bound(failures: int, rigs: int, confidence: float = BOUND_CONFIDENCE) -> float:
    """The failure rate that so few failures exclude with a confidence, one-sided, exact.

    Clopper and Pearson 1934: the p at which at most so many failures of so many rigs have the
    probability 1 - confidence.

    Args:
        failures: How many rigs failed.
        rigs: Of how many that were drawn independently.
        confidence: Between 0 and 1.
    """
    less = scipy.stats.binomtest(failures, rigs, alternative="less")
    return float(less.proportion_ci(confidence, method="exact").high)


def certify(tune: Tune, found: Indicators) -> dict[str, Any]:
    """The certificate from the runs on fresh rigs, as in ``--json``.

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
        middle, most, largest = (
            np.quantile(good, PRINTED_QUANTILES).tolist() if len(good) else (None,) * 3
        )
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
        "confidence": BOUND_CONFIDENCE,
        "cost": None if lost else tail_mean(costs, tune.tail),
        "tasks": tasks,
        "reasons": found.reasons,
    }


@dataclass(frozen=True, kw_only=True)
class TuneResult:
    """Result of a tune.

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
        """Score of a finalist on the rigs of the verdict."""
        return next(found for each, found in self.finalists if each is candidate)

    @property
    def verdict(self) -> Score:
        """Score of the chosen candidate on these rigs."""
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


def carry_out_tune(
    trials: Trials,
    advance: Callable[[float], None] = lambda _: None,
) -> TuneResult:
    """Carry a tune out.

    The certificate's rigs are drawn when all is decided.

    Args:
        trials: What carries out its runs.
        advance: Called with the share done, 0 to 1.

    Raises:
        TwinError: If the extra is not installed, or a run cannot be carried out.
    """
    tune = trials.tune
    candidates = search_all(trials, lambda done: advance(SEARCH_SHARE * done / tune.candidates))
    best = best_of(candidates, tune.finalists)
    some = best if candidates[0] in best else [*best, candidates[0]]
    gave = trials.indicators(
        [(each.fields, tune.rigs[-1]) for each in some], tune.draw, tune.verdict
    )
    finalists = [
        (each, score(tune, each.loop, found)) for each, found in zip(some, gave, strict=True)
    ]
    advance((1 + SEARCH_SHARE) / 2)
    chosen = min(finalists, key=lambda item: item[1].rank)[0]
    compared = [candidates[0].fields, chosen.fields]
    before, after = (
        certify(tune, found)
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
