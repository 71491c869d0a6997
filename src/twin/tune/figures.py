"""The pictures of a tune."""

from __future__ import annotations

import math
from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from twin.report.numbers import LABELS
from twin.tune.tune import TuneResult

BEFORE, AFTER, OTHER = "#d55e00", "#009e73", "#9aa7b1"


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def trade_off(found: TuneResult) -> Figure:
    """Cost against effort of every candidate that lost no rig, and the best at each effort."""
    with mpl.rc_context({"font.size": 9}):
        figure = _figure(10, 4)
        ax = figure.subplots()
        ran = [
            (c, s.effort, s.cost)
            for c in found.candidates
            for s in c.scores[:1]
            if s.effort is not None and s.cost is not None
        ]
        few = found.tune.rigs[0]
        whole = [(e, k) for c, e, k in ran]
        if whole:
            ax.plot(*zip(*whole, strict=True), "o", ms=4, color=OTHER, label="candidates")
            best = zip(*front(whole), strict=True)
            ax.plot(*best, "-", lw=1, color=OTHER, label="least cost at each effort")
        for candidate, colour, label in (
            (found.candidates[0], BEFORE, "before"),
            (found.chosen, AFTER, "after"),
        ):
            for c, effort, cost in ran:
                if c is candidate:
                    ax.plot(effort, cost, "o", ms=9, color=colour, label=label)
        ax.axvline(found.tune.limits.effort, ls=":", color="#555555")
        ax.annotate(
            "largest allowed",
            (found.tune.limits.effort, 0.97),
            xycoords=("data", "axes fraction"),
            ha="right",
            va="top",
            rotation=90,
            color="#555555",
        )
        ax.set_xscale("log")
        ax.set_yscale("log")
        _ticks(ax.xaxis, ax.yaxis)
        ax.set_xlabel("largest RMS effort of a run [rad/s²]")
        ax.set_ylabel(f"cost of the worst {found.tune.tail:.0%}, first {few} rigs")
        if ran:
            ax.legend(frameon=False, loc="upper center", ncols=4)
        ax.margins(y=0.2)
    return figure


def front(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Points that no other beats in both numbers, in the order of the first."""
    kept: list[tuple[float, float]] = []
    for point in sorted(points):
        if not kept or point[1] < kept[-1][1]:
            kept.append(point)
    return kept


def before_and_after(found: TuneResult) -> Figure:
    """Every fresh rig's indicator in every task, before and after, as cumulative shares."""
    with mpl.rc_context({"font.size": 9}):
        tasks = found.tune.tasks
        columns = min(len(tasks), 4)
        rows = math.ceil(len(tasks) / columns)
        figure = _figure(10, 2.9 * rows)
        axes = figure.subplots(rows, columns, squeeze=False, sharey=True).ravel()
        for ax, task in zip(axes, tasks, strict=False):
            label, unit = LABELS[task.indicator]
            factor = 1000 if unit == "mm" else 1
            for side, colour, when in (
                (found.before, BEFORE, "before"),
                (found.after, AFTER, "after"),
            ):
                values = side["tasks"][task.name]["values"]
                known = sorted(factor * value for value in values if value is not None)
                shares = np.arange(1, len(known) + 1) / side["rigs"]
                ax.step(known, shares, where="post", color=colour, label=when)
            ax.axvline(factor * task.scale, ls=":", color="#555555")
            ax.set_title(task.name)
            ax.set_xscale("log")
            _ticks(ax.xaxis)
            ax.set_ylim(0, 1.02)
            ax.set_xlabel(f"{label} [{unit}]")
        axes[0].set_ylabel("share of the fresh rigs")
        axes[0].legend(frameon=False)
        for ax in axes[len(tasks) :]:
            ax.set_visible(False)
    return figure


def _ticks(*axes: Axis) -> None:
    """Put plain numbers at 1, 2 and 5 of each decade of logarithmic axes."""
    for axis in axes:
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(NullFormatter())
