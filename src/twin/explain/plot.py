"""The picture of an explanation: what each effect does to the error, and its share of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from twin.explain.attribution import Explanation
from twin.run.picture import COLOURS, drawn
from twin.writing import write_whole

LEFT, ALONE, SHARE = COLOURS[1], COLOURS[0], COLOURS[2]


def draw(path: Path, explanation: Explanation) -> None:
    """Draw an explanation into a PNG file.

    Raises:
        RecordError: If the file cannot be written.
    """
    rows = len(explanation.contributions)
    height = 3.6 + 0.36 * max(rows, 3)
    with drawn(12, height) as figure:
        title = f"{explanation.scenario.title}: what makes the error"
        figure.suptitle(title, fontsize=12, fontweight="bold")
        panels = figure.subplot_mosaic(
            [["errors", "shares"], ["time", "time"]],
            width_ratios=(1.5, 1),
            height_ratios=(height - 3.2, 2.2),
        )
        _errors(panels["errors"], explanation)
        _shares(panels["shares"], explanation)
        _time(panels["time"], explanation)
        write_whole(path, lambda target: figure.savefig(target, dpi=110, format="png"))


def _errors(panel: Axes, explanation: Explanation) -> None:
    whole, none = explanation.size(explanation.whole), explanation.size(explanation.none)
    for y, part in enumerate(explanation.contributions):
        for case, beside, at, colour, mark, label in (
            (part.without, whole, y - 0.13, LEFT, "o", "all but this one"),
            (part.alone, none, y + 0.13, ALONE, "s", "this one alone"),
        ):
            size = explanation.size(case)
            bar: dict[str, Any] = {"lw": 5, "alpha": 0.35, "solid_capstyle": "butt"}
            panel.plot([beside, size], [at] * 2, color=colour, **bar)
            panel.plot(size, at, mark, color=colour, ms=6, label="" if y else label)
            if case.rms is None:
                panel.text(whole, at, f" {case.outcome}", color=colour, fontsize=7, va="center")
    panel.axvline(whole, color=LEFT, lw=1, ls="--")
    panel.axvline(none, color=ALONE, lw=1, ls="--")
    top = -0.75
    panel.annotate("all effects", (whole, top), color=LEFT, ha="right", fontsize=8)
    panel.annotate(" none", (none, top), color=ALONE, ha="left", fontsize=8)
    labels = [part.effect.label for part in explanation.contributions]
    panel.set_yticks(range(len(labels)), labels)
    panel.set_ylim(len(labels) - 0.4, -1.1)
    panel.set_xlim(left=0)
    percent = explanation.in_percent
    panel.set_xlabel("tracking error $e_{tt}$ [%]" if percent else "RMS distance [mm]")
    panel.set_title("Error without each effect, and with it alone")
    panel.figure.legend(*panel.get_legend_handles_labels(), loc="outside lower left", ncols=2)


def _shares(panel: Axes, explanation: Explanation) -> None:
    shares = [part.share for part in explanation.contributions]
    values = [100 * share if share is not None else 0.0 for share in shares]
    places = range(len(values))
    panel.barh(places, values, height=0.55, color=SHARE, alpha=0.8)
    reach = max([*np.abs(values), 1.0])
    for y, (share, value) in enumerate(zip(shares, values, strict=True)):
        text = "a run was cut short" if share is None else f"{value:z.1f} %"
        panel.text(max(value, 0) + 0.02 * reach, y, text, va="center", fontsize=8)
    panel.set_yticks(places, [""] * len(values))
    panel.set_ylim(len(values) - 0.4, -1.1)
    panel.set_xlim(min(0.0, *values) * 1.25, 1.25 * reach)
    panel.set_xticks([at for at in panel.get_xticks() if abs(at) <= max(100.0, reach)])
    panel.set_xlim(min(0.0, *values) * 1.25, 1.25 * reach)
    panel.axvline(0, color="0.3", lw=0.8)
    panel.set_xlabel("share of the error [%]")
    panel.set_title(_remainder(explanation), fontsize=9.5)


def _remainder(explanation: Explanation) -> str:
    if explanation.rest is None or explanation.base is None:
        return "Share"
    left, rest = 100 * explanation.base, 100 * explanation.rest
    return f"Share (left with none {left:z.1f} %, not additive {rest:z.1f} %)"


def _time(panel: Axes, explanation: Explanation) -> None:
    period = explanation.scenario.rig.period
    cases = {"all effects": (explanation.whole, LEFT), "none": (explanation.none, ALONE)}
    if explanation.contributions:
        first = explanation.contributions[0]
        cases[f"all but {first.effect.label}"] = (first.without, SHARE)
    for label, (case, colour) in cases.items():
        time = period * np.arange(len(case.distance))
        panel.plot(time, 1000 * case.distance, color=colour, lw=1, label=label)
    panel.set(xlabel="time [s]", ylabel="distance from reference [mm]", ylim=(0, None))
    start = explanation.scenario.metrics.start
    if start > 0:
        panel.axvline(start, color="0.4", lw=0.8, ls=":", label="judged from here")
    panel.figure.legend(*panel.get_legend_handles_labels(), loc="outside lower right", ncols=4)
