"""The search: candidates proposed by Optuna, judged on more and more rigs.

Round by round a tree-structured Parzen estimator proposes candidates from what all before them
gave, constraints among it (https://optuna.org). Those whose nominal loop keeps its margins run on
the first few rigs; of all that ever reached a rung the best go on to the next one, with more rigs,
as in asynchronous successive halving (Li et al. 2020). All meet the same rigs and the same noise.
The search has no state of its own: with the finished runs at hand it is made again, step by step.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from twin.errors import ScenarioError
from twin.study.family import Parameter, Point
from twin.tune.candidate import Candidate, Score, loop_constraints, score
from twin.tune.schema import Tune
from twin.tune.trials import Trials

PROPOSALS = 10
"""Most candidates proposed for each that is run: others have a nominal loop without margin."""
DIGITS = 5
"""Of the values that are tried: what is printed is what was run."""


def library() -> Any:
    """Optuna, quiet.

    Raises:
        ScenarioError: If the extra is not installed.
    """
    try:
        import optuna  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise ScenarioError("tune: needs the extra tune: pip install 'ballplate[tune]'") from error
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna


def searched(trials: Trials, advance: Callable[[int], None] = lambda _: None) -> list[Candidate]:
    """Every candidate of a search, in its order; the first is where it begins.

    Args:
        trials: What carries them out.
        advance: Told how many candidates have been tried.

    Raises:
        ScenarioError: If the extra is not installed.
        TwinError: If a run cannot be carried out.
    """
    optuna = library()
    tune, space = trials.tune, _space(trials.tune.fields)
    sampler = optuna.samplers.TPESampler(
        seed=tune.seed, n_startup_trials=max(10, 2 * len(space)), multivariate=True
    )
    study = optuna.create_study(sampler=sampler)
    study.enqueue_trial(dict(trials.start))
    found: list[Candidate] = []
    ran, proposals = 0, PROPOSALS * tune.candidates
    while ran < tune.candidates and len(found) < proposals:
        asked: list[tuple[Any, Candidate]] = []
        size = min(tune.round, tune.candidates - ran)
        most = min(PROPOSALS * size, proposals - len(found))
        while size and len(asked) < most:
            new = _asked(study, trials, space, len(found), min(size, most - len(asked)))
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


def _asked(
    study: Any, trials: Trials, space: dict[str, Any], begin: int, count: int
) -> list[tuple[Any, Candidate]]:
    """New candidates that the sampler proposes, with their nominal loops."""
    asked = [study.ask(space) for _ in range(count)]
    points = [rounded(trial.params, trials.tune.fields) for trial in asked]
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
        # where the tuning begins is judged on all rigs: it is what the result is compared with
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


def rounded(values: Mapping[str, Any], fields: Mapping[str, Parameter]) -> Point:
    """Values of fields in the digits in which they are run, within their ranges."""
    found: Point = {}
    for key, about in fields.items():
        value = values[key]
        if about.continuous:
            low, high = about.ends
            value = min(max(float(f"{value:.{DIGITS}g}"), low), high)
        found[key] = value
    return found
