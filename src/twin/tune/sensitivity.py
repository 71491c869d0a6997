"""How much each field matters: what a step of it away from the result does to the cost.

Measured, not estimated from the candidates of the search: those crowd where the sampler looked, and
any importance made of them says as much of the sampler as of the fields.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from twin.study.distribution import Parameter
from twin.tune.candidate import Candidate, score
from twin.tune.search import rounded
from twin.tune.trials import Trials

STEP = 0.1
"""Of a field, as a share of its range; of the range of its logarithm if that is searched."""


class Neighbour(NamedTuple):
    """The result with one field changed.

    Attributes:
        key: The field.
        value: What it was changed to.
        ratio: Cost over that of the result, on the rigs of the first rung; None if its controller
            is refused, or it loses a rig.
        kept: Whether it keeps every constraint.
    """

    key: str
    value: float | str
    ratio: float | None
    kept: bool


def neighbours(trials: Trials, chosen: Candidate) -> list[Neighbour]:
    """The result with every field a step lower and higher, or every other value of it.

    Args:
        trials: What carries candidates out.
        chosen: The result.

    Raises:
        TwinError: If a run cannot be carried out.
    """
    tune = trials.tune
    about = tune.fields
    moved = [
        (key, rounded({**chosen.fields, key: value}, about))
        for key in about
        for value in _beside(about[key], chosen.fields[key])
    ]
    loops = trials.loops([point for _, point in moved])
    ran = [
        (point, loop)
        for (_, point), loop in zip(moved, loops, strict=True)
        if not isinstance(loop, str)
    ]
    points = [chosen.fields, *(point for point, _ in ran)]
    first, *gave = trials.indicators(
        [(point, tune.rigs[0]) for point in points], tune.draw, tune.search
    )
    scores = iter([score(tune, loop, found) for (_, loop), found in zip(ran, gave, strict=True)])
    whole = score(tune, chosen.loop, first).cost
    found = []
    for (key, point), loop in zip(moved, loops, strict=True):
        got = None if isinstance(loop, str) else next(scores)
        cost = None if got is None else got.cost
        ratio = None if cost is None or not whole else cost / whole
        found.append(Neighbour(key, point[key], ratio, got is not None and got.kept))
    return found


def _beside(about: Parameter, value: float | str) -> list[float | str]:
    """Values a step beside one, within the range."""
    if about.values is not None:
        return [other for other in about.values if other != value]
    assert not isinstance(value, str)
    low, high = about.ends
    if about.integers is not None:
        step = max(1, round(STEP * (high - low)))
        sides: list[float] = [value - step, value + step]
    elif about.loguniform is not None:
        factor = math.exp(STEP * math.log(high / low))
        sides = [value / factor, value * factor]
    else:
        sides = [value - STEP * (high - low), value + STEP * (high - low)]
    inside = [min(max(side, low), high) for side in sides]
    return [side for side in inside if side != value]


def importance(found: list[Neighbour]) -> dict[str, float | None]:
    """Of each field, the largest rise of the cost by a step, as a share of it; None if it fails."""
    keys = dict.fromkeys(each.key for each in found)
    rises: dict[str, float | None] = {}
    for key in keys:
        own = [each.ratio for each in found if each.key == key]
        rises[key] = None if None in own else max(r - 1 for r in own if r is not None)
    return rises
