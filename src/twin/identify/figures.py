"""The pictures of an identification."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from twin.identify.holdout import Horizons
from twin.identify.search import Fit
from twin.identify.whiteness import Whiteness
from twin.identify.windows import LOOKBACK
from twin.run.picture import COLOURS, LOOK

SHOWN = 6
"""So many windows of the fit are drawn."""


def horizon_figure(horizons: Horizons) -> Figure:
    """Replay error against horizon with its baselines, and one replay."""
    with mpl.rc_context(LOOK):
        figure = Figure(figsize=(12, 4), layout="constrained")
        left, right = figure.subplots(1, 2)
        for name, values, colour in (
            ("fitted twin", horizons.twin, COLOURS[0]),
            ("frictionless twin", horizons.frictionless, COLOURS[1]),
            ("ball stays", horizons.still, COLOURS[2]),
        ):
            left.loglog(horizons.ahead, 1000 * values, "o-", color=colour, label=name, ms=4)
        left.axhline(1000 * horizons.noise, color="0.5", lw=1, ls="--", label="screen's noise")
        left.set(
            xlabel="seconds ahead", ylabel="median distance [mm]", title="Replay error, held out"
        )
        left.legend(fontsize=8)
        time, measured, replayed = horizons.example
        for axis, name in enumerate("xy"):
            right.plot(time, 1000 * measured[:, axis], ".", color=COLOURS[axis], ms=3, alpha=0.6)
            right.plot(time, 1000 * replayed[:, axis], color=COLOURS[axis], lw=1.2, label=name)
        right.axvline(0, color="0.5", lw=1, ls=":")
        right.set(
            xlabel="seconds ahead of the last sample used",
            ylabel="position [mm]",
            title="A median one of them",
        )
        right.legend(fontsize=8)
        figure.draw_without_rendering()
    return figure


def fit_figure(fit: Fit) -> Figure:
    """Some windows of the fit, evenly chosen."""
    windows = fit.problem.windows
    theta = fit.theta[None]
    delay = np.full((1, 1), fit.theta[fit.problem.names.index("delay")])
    seen = windows.seen(*fit.problem.replayed(theta, fit.starts), delay)[0][0]
    chosen = np.unique(np.linspace(0, len(windows) - 1, SHOWN).round().astype(int))
    with mpl.rc_context(LOOK):
        figure = Figure(figsize=(12, 5), layout="constrained")
        panels = figure.subplots(2, 3).ravel()
        for panel, which in zip(panels, chosen, strict=False):
            there = windows.weight[which, :, 0] > 0
            time = windows.begin[which] + windows.time[which, there]
            for axis, name in enumerate("xy"):
                ball = 1000 * windows.ball[which, there, axis]
                panel.plot(time, ball - ball[0], ".", color=COLOURS[axis], ms=3, alpha=0.6)
                way = 1000 * seen[which, there, axis] - ball[0]
                panel.plot(time, way, color=COLOURS[axis], lw=1.2, label=name)
            rest = "begun at rest" if windows.resting[which] else "begun in roll"
            panel.set_title(f"{time[0] - LOOKBACK:.1f} s, {rest}", fontsize=9)
        for panel in panels[len(chosen) :]:
            panel.set_axis_off()
        panels[0].legend(fontsize=8)
        figure.supxlabel("time [s]", fontsize=10)
        figure.supylabel("position [mm]", fontsize=10)
        figure.draw_without_rendering()
    return figure


def white_figure(whiteness: Whiteness) -> Figure:
    """Autocorrelation of the residuals with its band."""
    with mpl.rc_context(LOOK):
        figure = Figure(figsize=(12, 2.6), layout="constrained")
        panel = figure.subplots()
        lags = 1 + np.arange(len(whiteness.correlation))
        panel.bar(lags, whiteness.correlation, width=0.5, color=COLOURS[0])
        panel.axhspan(-whiteness.band, whiteness.band, color="0.85", zorder=0)
        panel.set(
            xlabel="lag [samples of 16 ms]",
            ylabel="correlation",
            title="Autocorrelation of the residuals; 95 % of white ones within the band",
        )
        figure.draw_without_rendering()
    return figure
