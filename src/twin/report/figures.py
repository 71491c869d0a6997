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
from twin.run.overview_plot import COLOURS, LOOK, picture

Format = Literal["svg", "png", "pdf"]


def overview(runs: Sequence[Run]) -> Figure:
    """Path on the plate, positions, error, angles and effort."""
    area = runs[0].scenario.rig.limits.area
    return picture({run.name: run.motion for run in runs}, "", area)


def details(runs: Sequence[Run]) -> Figure:
    """Error spectrum, estimation error, distribution of the error, lateness of the loop."""
    with mpl.rc_context(LOOK):
        figure = Figure(figsize=(12, 5.6), layout="constrained")
        panels = figure.subplot_mosaic([["spectrum", "estimate"], ["share", "late"]])
        for index, run in enumerate(runs):
            colour = COLOURS[index % len(COLOURS)]
            _spectrum(panels["spectrum"], run, colour)
            _share(panels["share"], run, colour)
        _estimates(panels["estimate"], runs)
        _late(panels["late"], runs)
        if len(runs) > 1:
            names = panels["spectrum"].get_legend_handles_labels()
            figure.legend(*names, loc="outside lower center", ncols=4, fontsize=9)
        figure.draw_without_rendering()
    return figure


def _spectrum(panel: Axes, run: Run, colour: str) -> None:
    frequency, amplitude = spectrum(run)
    level = 1000 * np.sqrt((amplitude**2).mean(axis=1))
    panel.loglog(frequency[1:], np.maximum(level[1:], 1e-6), color=colour, lw=1, label=run.name)
    panel.set(
        xlabel="frequency [Hz]",
        ylabel="amplitude [mm]",
        title="Spectrum of the tracking error (root mean square of x and y)",
        ylim=(1e-5, None),
    )


def _estimates(panel: Axes, runs: Sequence[Run]) -> None:
    panel.set(xlabel="time [s]", ylabel="distance [mm]", title="Error of the estimated position")
    known = [(i, run) for i, run in enumerate(runs) if "true_x" in run.rows]
    if not known:
        _instead(panel, "on a real rig nobody knows where the ball truly is")
        return
    for index, run in known:
        wrong = columns(run.rows, "estimated")[:, 0::4] - run.motion.ball
        colour = COLOURS[index % len(COLOURS)]
        panel.plot(run.motion.time, 1000 * np.hypot(*wrong.T), color=colour, lw=0.8)
    panel.set_ylim(0, None)


def _share(panel: Axes, run: Run, colour: str) -> None:
    distance = np.sort(1000 * np.hypot(*run.motion.error.T))
    share = 100 * np.arange(1, len(distance) + 1) / len(distance)
    panel.plot(distance, share, color=colour, lw=1.2)
    panel.set(
        xlabel="distance from the reference [mm]",
        ylabel="share of time below [%]",
        title="How often the error was below a value",
        ylim=(0, 100),
    )


def _late(panel: Axes, runs: Sequence[Run]) -> None:
    panel.set(xlabel="lateness [us]", ylabel="periods", title="How late the periods began")
    timed = [(run, lateness(run)) for run in runs]
    found = [(run, late) for run, late in timed if late is not None]
    if not found:
        _instead(panel, "simulated time: no period can be late")
        return
    top = max(float(late.max()) for _, late in found)
    edges = np.linspace(0, max(top, 1.0), 60)
    for index, (_, late) in enumerate(found):
        panel.hist(late, edges.tolist(), histtype="step", color=COLOURS[index % len(COLOURS)])
    panel.set_yscale("log")


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
