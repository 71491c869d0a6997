"""The figures of a study."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from twin.data_file import read_toml
from twin.report.numbers import LABELS
from twin.run.picture import LOOK, style
from twin.study.answers import Answer, Curve, SensitivityIndex
from twin.study.design import Design
from twin.study.family import Point
from twin.study.schema import Study

WORDS = read_toml(Path(__file__).with_name("words.toml"))
"""What figures and indices are called."""
FAILED = "#B00000"
ENOUGH = 20
"""Runs from which on there is a 5 % quantile, and a chance to fail worth a number."""
MANY = 5000
"""Number of runs above which a scatter plot is kept as a bitmap."""


def figures(study: Study, found: Sequence[Answer], design: Design) -> dict[str, Figure]:
    """Figures by name: indices, curves, spread, and where runs fail.

    Args:
        study: What was asked.
        found: One answer per variant.
        design: The point of each of an answer's values.
    """
    with mpl.rc_context(LOOK):
        out = {}
        if any(answer.curves for answer in found):
            out["curves"] = _curves(study, found)
        if any(answer.indices for answer in found):
            out["indices"] = _indices(study, found)
        out["spread"] = _spread(study, found)
        if len(study.parameters) > 1 and any(answer.indices for answer in found):
            out["map"] = _map(study, found, design)
        for figure in out.values():
            # text is laid out when drawn: now, while these settings hold
            figure.draw_without_rendering()
    return out


def metric_label(study: Study) -> str:
    """The first metric in words, with its unit."""
    words, unit = LABELS[study.metrics[0]]
    unit = "m" if unit == "mm" else unit
    return f"{words} [{unit}]" if unit else words


def parameter_label(study: Study, key: str) -> str:
    """A parameter's key with its unit."""
    about = study.parameters[key]
    unit = "× nominal" if about.relative else about.unit
    return f"{key} [{unit}]" if unit else key


def where_label(study: Study, where: Point) -> str:
    """Values of some parameters in words."""
    return ", ".join(
        f"{key} = {value:g} {study.parameters[key].unit}".strip()
        if isinstance(value, float)
        else f"{key} = {value}"
        for key, value in where.items()
    )


def ranked(study: Study, found: Sequence[Answer]) -> list[str]:
    """The parameters, the most influential first."""
    sizes = dict.fromkeys(study.parameters, 0.0)
    for answer in found:
        for index in answer.indices:
            sizes[index.key] += abs(index.value) if np.isfinite(index.value) else 0.0
    return sorted(sizes, key=lambda key: -sizes[key])


def _indices(study: Study, found: Sequence[Answer]) -> Figure:
    keys = ranked(study, found)
    height = 0.8 / len(found)
    figure = Figure(
        figsize=(9, 1.3 + len(keys) * max(0.42, 0.17 * len(found))), layout="constrained"
    )
    panel = figure.subplots()
    for k, answer in enumerate(found):
        for index in answer.indices:
            at = keys.index(index.key) + (k - (len(found) - 1) / 2) * height
            _bar(panel, index, at, height * 0.9, k)
        panel.barh(0, 0, color=style(k)["color"], label=answer.variant)
    panel.axvline(0, color="0.3", lw=0.8)
    panel.set(
        xlabel=f"{WORDS['axis'][study.method]}; hollow: undecided",
        title=f"What the {LABELS[study.metrics[0]][0]} depends on",
        yticks=range(len(keys)),
        yticklabels=keys,
    )
    panel.invert_yaxis()
    panel.grid(visible=False, axis="y")
    if len(found) > 1:
        figure.legend(loc="outside lower center", ncols=3, fontsize=8)
    return figure


def _bar(panel: Axes, index: SensitivityIndex, at: float, height: float, k: int) -> None:
    colour = style(k)["color"]
    if not index.decided:
        # no bar: its sign is unknown, only its interval is shown
        reach = (index.value - index.half, index.value + index.half)
        panel.plot(reach, (at, at), color=colour, lw=1, alpha=0.6)
        panel.plot(0, at, "o", mec=colour, mfc="white", ms=4)
        return
    panel.barh(at, index.value, height, color=colour, alpha=0.85)
    if np.isfinite(index.half):
        reach = (index.value - index.half, index.value + index.half)
        panel.plot(reach, (at, at), color="0.2", lw=1.2)
    if np.isfinite(index.first) and 0 < index.first <= 1:
        panel.plot(2 * (index.first,), (at - height / 2, at + height / 2), color="black", lw=2)


def _curves(study: Study, found: Sequence[Answer]) -> Figure:
    shown = found[0].curves
    figure = Figure(figsize=(max(6.5, 3.9 * len(shown)), 5.0), layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, len(shown), sharey=True))
    for number, (panel, curve) in enumerate(zip(panels, shown, strict=True)):
        for k, answer in enumerate(found):
            if answer.curves:
                _curve(panel, answer.curves[number], answer.variant if number == 0 else None, k)
        panel.set(xlabel=parameter_label(study, curve.key))
        if curve.where:
            panel.set_title(where_label(study, curve.where), fontsize=9)
    # from 0 on, unless the metric can be negative
    least = min(0.0, *(float(np.nan_to_num(answer.values).min()) for answer in found))
    panels[0].set(ylabel=metric_label(study), ylim=(least, None))
    if any(each.failed for answer in found for curve in answer.curves for each in curve.spreads):
        panels[0].plot([], [], "x", color=FAILED, label="some or all runs failed")
    if len(panels[0].get_legend_handles_labels()[0]) > 1:
        figure.legend(loc="outside lower center", ncols=3, fontsize=8)
    return figure


def _curve(panel: Axes, curve: Curve, label: str | None, k: int) -> None:
    numeric = all(isinstance(value, int | float) for value in curve.values)
    x = np.array(curve.values if numeric else range(len(curve.values)), float)
    middle, low, high = (
        np.array([getattr(each, name) for each in curve.spreads])
        for name in ("median", "low", "high")
    )
    panel.plot(x, middle, marker="o", ms=3.5, lw=1.4, label=label, **style(k))
    if (high > low).any():
        panel.fill_between(x, low, high, color=style(k)["color"], alpha=0.15, lw=0)
    failed = np.array([each.failed > 0 for each in curve.spreads])
    # a point without finished runs has no median: it is shown on the axis
    if failed.any():
        foot = np.nan_to_num(middle[failed])
        panel.plot(x[failed], foot, "x", color=FAILED, ms=8, clip_on=False, zorder=5)
    if not numeric:
        panel.set_xticks(x, [str(value) for value in curve.values])


def _spread(study: Study, found: Sequence[Answer]) -> Figure:
    figure = Figure(figsize=(9, 1.5 + 0.3 * len(found)), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(3, 1))
    for k, answer in enumerate(found):
        whole, colour = answer.whole, style(k)["color"]
        bar: dict[str, Any] = {"lw": 5, "alpha": 0.35, "solid_capstyle": "butt"}
        if whole.runs < ENOUGH:
            left.plot(answer.values, [k] * len(answer.values), "|", color=colour, ms=9)
        else:
            left.plot((whole.low, whole.high), (k, k), color=colour, **bar)
        left.plot(whole.median, k, "o", color=colour)
        low, high = whole.chance
        right.plot((100 * low, 100 * high), (k, k), color=FAILED, **bar)
        right.plot(100 * whole.failed / max(whole.runs, 1), k, "o", color=FAILED)
    few = any(answer.whole.runs < ENOUGH for answer in found)
    lie = "each run" if few else "where 9 of 10 runs lie"
    left.set(
        xlabel=f"{metric_label(study)}: median, and {lie}",
        yticks=range(len(found)),
        yticklabels=[answer.variant for answer in found],
    )
    most = max(100 * answer.whole.chance[1] for answer in found)
    right.set(xlabel="runs that fail [%]", xlim=(-0.03 * most, 1.05 * most))
    left.invert_yaxis()
    return figure


def _map(study: Study, found: Sequence[Answer], design: Design) -> Figure:
    """Runs over the two most influential parameters: the metric as colour, and which failed."""
    first, second = ranked(study, found)[:2]
    columns = min(3, len(found))
    rows = -(-len(found) // columns)
    size = (max(6.0, 1.5 + 3.2 * columns), 1.2 + 2.7 * rows)
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for panel in axes.flat[len(found) :]:
        panel.set_visible(False)
    panels = list(axes.flat[: len(found)])
    x, y = (design.columns[key] for key in (first, second))
    values = np.concatenate([answer.values for answer in found])
    good = values[np.isfinite(values)]
    scale = np.quantile(good, (0.02, 0.98)) if len(good) else (0, 1)
    many = len(values) > MANY
    for panel, answer in zip(panels, found, strict=True):
        done = np.isfinite(answer.values)
        dots = panel.scatter(
            x[done],
            y[done],
            c=answer.values[done],
            s=14,
            vmin=scale[0],
            vmax=scale[1],
            rasterized=many,
        )
        panel.plot(x[~done], y[~done], "x", color=FAILED, ms=7, mew=2, rasterized=many)
        lost = int((~done).sum())
        failed = f"{lost} of {len(done)} failed (x)" if lost else "none failed"
        panel.set_title(f"{answer.variant}: {failed}", fontsize=9)
    figure.colorbar(dots, ax=panels, label=metric_label(study))
    figure.supxlabel(parameter_label(study, first), fontsize=9)
    figure.supylabel(parameter_label(study, second), fontsize=9)
    return figure
