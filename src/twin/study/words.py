"""The answer of a study in words."""

from __future__ import annotations

import math
from collections.abc import Sequence

from twin.study.answers import Answer
from twin.study.design import Point
from twin.study.figures import metric_label, where_label
from twin.study.schema import Study

NEGLIGIBLE = 0.01
"""Index below which a parameter is said not to matter."""
ROUGH = 0.2
"""Half-width of an interval from which on the sample is said to be small."""


def sentences(study: Study, found: Sequence[Answer]) -> list[str]:
    """The answer in words."""
    metric, words = metric_label(study), []
    best = sorted(
        (a for a in found if not math.isnan(a.whole.median)), key=lambda a: a.whole.median
    )
    if len(found) > 1 and best:
        order = ", ".join(f"{a.variant} {a.whole.median:.3g}" for a in best)
        words.append(f"By the median of {metric}, best first: {order}.")
    if len(found) > 1:
        words += _agreed(found, metric)
    for answer in found:
        if len(found) == 1:
            words += _importance(answer, metric)
        if answer.whole.failed:
            words.append(
                f"{answer.variant}: {answer.whole.failed} of {answer.whole.runs} runs did not end "
                "well; they are kept out of the averages."
            )
        words += [f"{answer.variant}: {note}." for note in answer.notes]
    return (words + _known(study, found)) or ["All runs finished; see the curves."]


def _agreed(found: Sequence[Answer], metric: str) -> list[str]:
    """What the indices of several variants say together."""
    names: dict[str, list[str]] = {}
    for answer in found:
        for index in answer.indices:
            names.setdefault(index.key, [])
            if index.decided and abs(index.value) >= NEGLIGIBLE:
                names[index.key].append(answer.variant)
    words = []
    for key, who in sorted(names.items(), key=lambda item: -len(item[1])):
        if who:
            all_ = "all variants" if len(who) == len(found) else ", ".join(who)
            words.append(f"{key} matters to {metric} for {all_}.")
    open_ = [key for key, who in names.items() if not who]
    if open_:
        words.append(f"Undecided with this sample for all variants: {', '.join(open_)}.")
    return words


def _importance(answer: Answer, metric: str) -> list[str]:
    if not answer.indices:
        return []
    sure = sorted((i for i in answer.indices if i.decided), key=lambda i: -abs(i.value))
    strong = [i for i in sure if abs(i.value) >= NEGLIGIBLE]
    weak = [i.key for i in sure if abs(i.value) < NEGLIGIBLE]
    open_ = [i.key for i in answer.indices if not i.decided]
    text = ", ".join(f"{i.key} ({i.value:.2g} ± {i.half:.1g})" for i in strong)
    words = [f"What matters to {metric}: {text or 'nothing for certain'}."]
    if weak:
        words.append(f"Negligible (below {NEGLIGIBLE:g}): {', '.join(weak)}.")
    if open_:
        words.append(f"Undecided with this sample: {', '.join(open_)}.")
    if any(i.half > ROUGH for i in strong):
        words.append(f"The sample is small: intervals wider than ± {ROUGH:g}; take more samples.")
    return words


def needed(study: Study, found: Sequence[Answer]) -> list[tuple[str, str, str, str]]:
    """How well each parameter must be known: variant, where, parameter, within what."""
    out = []
    for answer in found:
        known: list[tuple[str, Point, float | None]] = [
            (index.key, {}, index.needed) for index in answer.indices
        ]
        known += [(curve.key, curve.where, curve.needed) for curve in answer.curves]
        for key, where, reach in known:
            if reach is not None:
                about = study.parameters[key]
                unit = "of nominal" if about.relative else about.unit
                within = f"± {reach:.2g} {unit}".strip()
                out.append((answer.variant, where_label(study, where), key, within))
    return out


def _known(study: Study, found: Sequence[Answer]) -> list[str]:
    """The first few of them in words."""
    metric = metric_label(study)
    return [
        f"To predict the {metric} of {variant}{f' at {where}' if where else ''} within 1, {key} "
        f"must be known within {within}."
        for variant, where, key, within in needed(study, found)[:3]
    ]
