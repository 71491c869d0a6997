"""The pictures of a tune."""

from __future__ import annotations

import math
from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

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
            ax.plot(*zip(*front(whole), strict=True), "-", lw=1, color=OTHER, label="best so far")
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
        ax.set_xlabel("largest RMS effort of a run [rad/s²]")
        ax.set_ylabel(f"cost of the worst {found.tune.tail:.0%}, first {few} rigs")
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


def sensitivities(found: TuneResult) -> Figure:
    """Cost of the result with one field changed, over that of the result."""
    with mpl.rc_context({"font.size": 9}):
        names = list(found.tune.fields)[::-1]
        figure = _figure(10, 0.9 + 0.34 * len(names))
        ax = figure.subplots()
        for each in found.neighbours:
            at = names.index(each.key)
            value = each.value if isinstance(each.value, str) else f"{each.value:.4g}"
            bad = each.ratio is None
            ax.plot(
                1.0 if each.ratio is None else each.ratio,
                at,
                "x" if bad else "o",
                ms=7,
                color=AFTER if each.kept else BEFORE,
                mfc=AFTER if each.kept else "none",
            )
            ax.annotate(
                f"{value}: fails" if bad else value,
                (1.0 if each.ratio is None else each.ratio, at),
                xytext=(0, 5),
                textcoords="offset points",
                ha="center",
                fontsize=7,
            )
        ax.axvline(1.0, lw=1, color=OTHER)
        ax.set_yticks(range(len(names)), names)
        ax.set_ylim(-0.6, len(names) - 0.3)
        ax.margins(x=0.1)
        ax.set_xlabel("cost over that of the result; hollow: a constraint is not kept")
    return figure


def before_and_after(found: TuneResult) -> Figure:
    """Every fresh rig's indicator in every task, before and after, as cumulative shares."""
    with mpl.rc_context({"font.size": 9}):
        tasks = found.tune.tasks
        columns = min(len(tasks), 4)
        rows = math.ceil(len(tasks) / columns)
        figure = _figure(10, 2.9 * rows)
        axes = figure.subplots(rows, columns, squeeze=False, sharey=True).ravel()
        for ax, task in zip(axes, tasks, strict=False):
            for side, colour, label in (
                (found.before, BEFORE, "before"),
                (found.after, AFTER, "after"),
            ):
                known = sorted(v for v in side.values[task.name] if v is not None)
                shares = np.arange(1, len(known) + 1) / side.rigs
                ax.step(known, shares, where="post", color=colour, label=label)
            ax.axvline(task.scale, ls=":", color="#555555")
            ax.set_title(task.name)
            ax.set_xscale("log")
            ax.set_ylim(0, 1.02)
            ax.set_xlabel(f"{task.indicator.replace('_', ' ')}{unit(task.indicator)}")
        axes[0].set_ylabel("share of the fresh rigs")
        axes[0].legend(frameon=False)
        for ax in axes[len(tasks) :]:
            ax.set_visible(False)
    return figure


def unit(indicator: str) -> str:
    """The unit of an indicator's own number, in brackets; empty for none."""
    for end, text in (("percent", "%"), ("deg", "deg"), ("_max", "rad/s²"), ("_rms", "rad/s²")):
        if indicator.endswith(end):
            return f" [{text}]"
    return " [m]"
