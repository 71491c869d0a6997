"""The pictures of a study."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from twin.picture import COLOURS, LOOK
from twin.study.answers import Answer
from twin.study.schema import Study


def figures(study: Study, found: Sequence[Answer]) -> dict[str, Figure]:
    """Name to picture: indices, curves, distribution, chance of failure."""
    with mpl.rc_context(LOOK):
        out = {"spread": _spread(study, found)}
        if any(answer.indices for answer in found):
            out["indices"] = _indices(study, found)
        if any(answer.curves for answer in found):
            out["curves"] = _curves(study, found)
    return out


def _colour(k: int) -> str:
    return COLOURS[k % len(COLOURS)]


def _indices(study: Study, found: Sequence[Answer]) -> Figure:
    keys = list(study.parameters)
    figure = Figure(figsize=(10, 1.2 + 0.35 * len(keys) * len(found)), layout="constrained")
    panel = figure.subplots()
    height = 0.8 / len(found)
    for k, answer in enumerate(found):
        for index in answer.indices:
            at = keys.index(index.key) + (k - (len(found) - 1) / 2) * height
            panel.barh(
                at,
                index.value,
                height * 0.9,
                xerr=index.half if np.isfinite(index.half) else None,
                color=_colour(k),
                alpha=1.0 if index.decided else 0.3,
                label=answer.variant if index is answer.indices[0] else None,
            )
    name = {"sobol": "total Sobol index", "morris": "mu*", "lhs": "rank correlation"}
    panel.set(
        xlabel=f"{name.get(study.method, 'rank correlation')} of {study.metrics[0]} "
        "(pale: undecided)",
        yticks=range(len(keys)),
        yticklabels=keys,
    )
    panel.invert_yaxis()
    if len(found) > 1:
        panel.legend(fontsize=8)
    figure.draw_without_rendering()
    return figure


def _curves(study: Study, found: Sequence[Answer]) -> Figure:
    keys = list(study.parameters)
    figure = Figure(figsize=(max(6, 5 * len(keys)), 4.2), layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, len(keys)))
    for panel, key in zip(panels, keys, strict=True):
        for k, answer in enumerate(found):
            curve = next(each for each in answer.curves if each.key == key)
            numeric = all(isinstance(value, int | float) for value in curve.values)
            x = list(curve.values) if numeric else list(range(len(curve.values)))
            middle, low, high = (
                [getattr(each, name) for each in curve.spreads]
                for name in ("median", "low", "high")
            )
            panel.plot(x, middle, "o-", color=_colour(k), ms=4, label=answer.variant)
            panel.fill_between(x, low, high, color=_colour(k), alpha=0.15, lw=0)
            if not numeric:
                panel.set_xticks(x, [str(value) for value in curve.values])
        panel.set(xlabel=f"{key} {study.parameters[key].unit}".strip(), ylabel=study.metrics[0])
    if len(found) > 1:
        panels[0].legend(fontsize=8)
    figure.draw_without_rendering()
    return figure


def _spread(study: Study, found: Sequence[Answer]) -> Figure:
    figure = Figure(figsize=(10, 1.4 + 0.35 * len(found)), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(3, 1))
    for k, answer in enumerate(found):
        whole = answer.whole
        left.plot((whole.low, whole.high), (k, k), color=_colour(k), lw=3, alpha=0.5)
        left.plot(whole.median, k, "o", color=_colour(k))
        low, high = whole.chance
        share = whole.failed / max(whole.runs, 1)
        right.errorbar(
            100 * share,
            k,
            xerr=[[100 * (share - low)], [100 * (high - share)]],
            fmt="o",
            color=_colour(k),
        )
    left.set(
        xlabel=f"{study.metrics[0]}: median and 5 to 95 % of the runs that finished",
        yticks=range(len(found)),
        yticklabels=[answer.variant for answer in found],
    )
    right.set(xlabel="runs that failed [%]", xlim=(-2, 102))
    left.invert_yaxis()
    figure.draw_without_rendering()
    return figure
