"""The pictures of a report beside the one of the run itself."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Literal

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from twin.report.diagnosis import spectrum
from twin.run.finished import Run, columns
from twin.run.picture import LOOK, MOST, picture, style

Format = Literal["svg", "png", "pdf"]
DETAILS: dict[str, tuple[str, str, str, tuple[float | None, float | None]]] = {
    "spectrum": (
        "Spectrum of the error (RMS of x, y)",
        "frequency [Hz]",
        "amplitude [mm]",
        (1e-5, None),
    ),
    "estimate": ("Error of the estimated position", "time [s]", "distance [mm]", (0, None)),
    "share": (
        "How often the error was smaller",
        "distance from reference [mm]",
        "share of time [%]",
        (0, 100),
    ),
    "late": ("How late the periods began", "lateness [us]", "periods", (None, None)),
}
"""Of each panel title, labels and range."""


def overview(runs: Sequence[Run]) -> Figure:
    """Path on the plate, positions, error, angles and effort."""
    area = runs[0].scenario.rig.limits.area
    return picture({run.name: run.motion for run in runs}, "", area)


def details(runs: Sequence[Run]) -> Figure:
    """Error spectrum, estimation error, distribution of the error; in real time, lateness."""
    late = {index: each for index, run in enumerate(runs) if (each := lateness(run)) is not None}
    names = ["spectrum", "estimate", "share", *(["late"] if late else [])]
    with mpl.rc_context(LOOK):
        figure = Figure(figsize=(12, 3.4), layout="constrained")
        panels = dict(zip(names, figure.subplots(1, len(names)), strict=True))
        for index, run in enumerate(runs):
            frequency, amplitude = spectrum(run)
            level = np.maximum(1000 * np.sqrt((amplitude**2).mean(axis=1)), 1e-6)
            look = {**style(index), "lw": 1}
            panels["spectrum"].loglog(frequency[1:], level[1:], label=run.name, **look)
            distance = np.sort(1000 * np.hypot(*run.motion.error.T))
            share = 100 * np.arange(1, len(distance) + 1) / len(distance)
            panels["share"].plot(distance, share, **look)
            if "true_x" in run.rows:
                wrong = 1000 * (columns(run.rows, "estimated")[:, 0::4] - run.motion.ball)
                panels["estimate"].plot(run.motion.time, np.hypot(*wrong.T), **look)
        if not panels["estimate"].lines:
            _instead(panels["estimate"], "on a real rig nobody knows\nwhere the ball truly is")
        top = max((float(each.max()) for each in late.values()), default=0.0)
        for index, each in late.items():
            edges = np.linspace(0, max(top, 1.0), 60).tolist()
            panels["late"].hist(each, edges, histtype="step", log=True, **style(index))
        for name, panel in panels.items():
            title, below, beside, limits = DETAILS[name]
            panel.set(title=title, xlabel=below, ylabel=beside, ylim=limits)
        if 1 < len(runs) <= MOST:
            entries = panels["spectrum"].get_legend_handles_labels()
            figure.legend(*entries, loc="outside lower center", ncols=4, fontsize=9)
        figure.draw_without_rendering()
    return figure


def _instead(panel: Axes, words: str) -> None:
    """Words where there is nothing to draw."""
    panel.text(0.5, 0.5, words, ha="center", va="center", transform=panel.transAxes, color="0.4")
    panel.set(xticks=[], yticks=[])


def lateness(run: Run) -> np.ndarray | None:
    """How late each period of a real-time run began, us, shape (K,); None in simulated time."""
    names = [name for name in run.rows if name.startswith("late")]
    return 1e6 * run.rows[names[0]] if names else None


def encoded(figure: Figure, kind: Format) -> bytes:
    """A figure as a file's content; the same figure gives the same bytes."""
    store = io.BytesIO()
    left_out = {"svg": ("Date", "Creator", "Format", "Type"), "pdf": ("CreationDate",)}
    fixed = dict.fromkeys(left_out.get(kind, ()))
    with mpl.rc_context({"svg.hashsalt": "ballplate", "svg.fonttype": "path"}):
        figure.savefig(store, format=kind, dpi=150, metadata=fixed or None)
    return store.getvalue()
