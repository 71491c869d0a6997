"""A study's results in sentences."""

from __future__ import annotations

import math
from collections.abc import Sequence

from twin.report.numbers import LABELS
from twin.study.answers import Answer
from twin.study.family import Point
from twin.study.figures import metric_label, where_label
from twin.study.schema import Study

NAMED = 5
"""Variants that a sentence ranks; of more, the table does."""
NEGLIGIBLE = 0.01
"""Index below which a parameter is called negligible."""
ROUGH = 0.2
"""Half-width of an interval above which the sample is called small."""


def sentences(study: Study, found: Sequence[Answer]) -> list[str]:
    """The results of a study in sentences.

    Args:
        study: What was asked.
        found: One answer per variant.
    """
    metric, words = metric_label(study), []
    best = [each for each in in_order(found) if not math.isnan(each.whole.median)]
    if len(found) > 1 and best:
        few = [f"{each.variant} {each.whole.median:.3g}" for each in best]
        few = few if len(few) <= NAMED else [*few[:3], f"..., last {few[-1]}"]
        words.append(f"By the median of {metric}, best first: {', '.join(few)}.")
    if len(found) > 1:
        words += _common_importance(found, metric)
    for answer in found:
        if len(found) == 1:
            words += _importance(answer, metric)
        if answer.whole.failed:
            words.append(
                f"{answer.variant}: {answer.whole.failed} of {answer.whole.runs} runs did not end "
                "well; they are kept out of the averages."
            )
        words += [f"{answer.variant}: {note}." for note in answer.notes]
    return (words + _tolerances(study, found)) or ["All runs finished; see the curves."]


def in_order(found: Sequence[Answer]) -> list[Answer]:
    """The variants by their median, the best first; those without one last."""
    return sorted(found, key=lambda each: (math.isnan(each.whole.median), each.whole.median))


def _common_importance(found: Sequence[Answer], metric: str) -> list[str]:
    """Which parameters matter to all or some of several variants."""
    names: dict[str, list[str]] = {}
    for answer in found:
        for index in answer.indices:
            names.setdefault(index.key, [])
            if index.decided and abs(index.value) >= NEGLIGIBLE:
                names[index.key].append(answer.variant)
    words = []
    for key, who in sorted(names.items(), key=lambda item: -len(item[1])):
        if who:
            variants = "all variants" if len(who) == len(found) else ", ".join(who)
            words.append(f"{key} matters to {metric} for {variants}.")
    undecided = [key for key, who in names.items() if not who]
    if undecided:
        words.append(f"Undecided with this sample for all variants: {', '.join(undecided)}.")
    return words


def _importance(answer: Answer, metric: str) -> list[str]:
    if not answer.indices:
        return []
    decided = sorted((i for i in answer.indices if i.decided), key=lambda i: -abs(i.value))
    strong = [i for i in decided if abs(i.value) >= NEGLIGIBLE]
    weak = [i.key for i in decided if abs(i.value) < NEGLIGIBLE]
    undecided = [i.key for i in answer.indices if not i.decided]
    text = ", ".join(f"{i.key} ({i.value:.2g} ± {i.half:.1g})" for i in strong)
    words = [f"What matters to {metric}: {text or 'nothing for certain'}."]
    if weak:
        words.append(f"Negligible (below {NEGLIGIBLE:g}): {', '.join(weak)}.")
    if undecided:
        words.append(f"Undecided with this sample: {', '.join(undecided)}.")
    if any(i.half > ROUGH for i in strong):
        words.append(f"The sample is small: intervals wider than ± {ROUGH:g}; take more samples.")
    return words


def needed(study: Study, found: Sequence[Answer]) -> list[tuple[str, str, str, str]]:
    """How well each parameter must be known: rows of variant, where, parameter, tolerance.

    Nothing is asked of what is drawn from a list, as a frame rate is.
    """
    out = []
    for answer in found:
        known: list[tuple[str, Point, float | None]] = [
            (index.key, {}, index.needed)
            for index in answer.indices
            if study.parameters[index.key].continuous
        ]
        known += [(curve.key, curve.where, curve.needed) for curve in answer.curves]
        for key, where, reach in known:
            if reach is not None:
                about = study.parameters[key]
                unit = "of nominal" if about.relative else about.unit
                # slopes are per m of a metric in m; one mm is asked for
                scale = 1e-3 if LABELS[study.metrics[0]][1] == "mm" else 1.0
                within = f"± {scale * reach:.2g} {unit}".strip()
                out.append((answer.variant, where_label(study, where), key, within))
    return out


def _tolerances(study: Study, found: Sequence[Answer]) -> list[str]:
    """The first few rows of ``needed`` in words."""
    metric, unit = metric_label(study), LABELS[study.metrics[0]][1]
    return [
        f"To predict the {metric} of {variant}{f' at {where}' if where else ''} within "
        f"{f'1 {unit}'.strip()}, {key} must be known within {within}."
        for variant, where, key, within in needed(study, found)[:3]
    ]
