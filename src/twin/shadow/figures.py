"""The picture of a shadow: score, replay error with its band, and the sequential test over time."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from controllers.arrays import Array
from twin.run.picture import COLOURS, LOOK
from twin.shadow import dead_time
from twin.shadow.alarms import THRESHOLD
from twin.shadow.follow import Shadow

ALARM = COLOURS[1]
SIDES = 1.96
"""Half-width of a 95 % band in standard deviations."""


def picture(found: Shadow) -> Figure:
    """Score, error along x and y with the 95 % band, and the statistic, over time."""
    with mpl.rc_context(LOOK):
        figure = Figure(figsize=(12, 8.5), layout="constrained")
        panels = figure.subplots(4, 1, sharex=True)
        _score(panels[0], found)
        for axis, panel in enumerate(panels[1:3]):
            _error(panel, found, axis)
        _test(panels[3], found)
        for panel in panels:
            _marks(panel, found)
        panels[3].set_xlabel("time [s]")
        figure.draw_without_rendering()
    return figure


def _score(panel: Axes, found: Shadow) -> None:
    panel.set(ylabel="score", title="Replay error over its predicted spread (1: as predicted)")
    run = found.replays
    panel.axhline(1, color="0.4", lw=1)
    if run is None:
        return
    told, silent = run.counted, ~run.counted
    end = run.time + run.ahead
    panel.semilogy(end[told], np.maximum(run.score[told], 0.02), ".", color=COLOURS[0])
    panel.plot(
        end[silent],
        np.full(silent.sum(), 0.02),
        "x",
        color="0.6",
        ms=4,
        label="cannot tell: the ball rests, or was not seen",
    )
    if silent.any():
        panel.legend(fontsize=8, loc="upper left")


def _error(panel: Axes, found: Shadow, axis: int) -> None:
    run = found.replays
    panel.set(ylabel=f"error, {'xy'[axis]} [mm]")
    if run is None or not run.counted.any():
        return
    panel.set_title(
        f"Measured ball minus replay after {run.ahead:g} s, with the predicted 95 % band",
        fontsize=9,
    )
    told = run.counted
    end = (run.time + run.ahead)[told]
    error = 1000 * run.error[told, axis]
    half = 1000 * SIDES * np.sqrt(run.spread[told, axis, axis])
    panel.bar(end, 2 * half, 0.8 * run.ahead, -half, color=COLOURS[5], alpha=0.35)
    panel.plot(end, error, ".", color=COLOURS[0])
    most = max(3.0, 1.2 * _percentile(np.abs(error), 95), 1.2 * _percentile(half, 80))
    panel.set_ylim(-most, most)


def _test(panel: Axes, found: Shadow) -> None:
    every, late = np.maximum(found.ratio, 0.1), np.maximum(found.delayed, 0.1)
    panel.semilogy(found.time, every, color=COLOURS[0], lw=1.2, label="all causes")
    panel.semilogy(found.time, late, color=COLOURS[1], lw=1, label="dead time alone")
    for threshold in (THRESHOLD, dead_time.THRESHOLD):
        panel.axhline(threshold, color=ALARM, lw=1, ls="--")
    panel.legend(fontsize=7, loc="upper left")
    panel.set(ylabel="log likelihood ratio", title="A change against none; dashed: alarm")


def _marks(panel: Axes, found: Shadow) -> None:
    for begin, end in found.gaps:
        panel.axvspan(begin, end, color="0.8", lw=0)
    for alarm in found.alarms:
        panel.axvline(alarm.time, color=ALARM, lw=1.2)
        panel.axvline(alarm.since, color=ALARM, lw=1, ls=":")


def _percentile(values: Array, percent: float) -> float:
    return float(np.percentile(values, percent))
