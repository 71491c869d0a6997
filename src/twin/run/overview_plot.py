"""The picture of one or several runs: where the ball went, and what it took."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from controllers.arrays import Array
from twin.hal.interface import SCREEN
from twin.run.metrics import Motion
from twin.run.overview_held import shade
from twin.run.overview_layout import HEADING, arrange
from twin.writing import write_whole

# Okabe and Ito's colours, told apart with any colour vision; their orange darker and indigo for
# their light blue, which are hard to see as lines on white.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#B57D00", "#4B2E83")
STYLES = ("-", "--", "-.", ":")
LOOK: Any = {"font.size": 9, "axes.grid": True, "grid.alpha": 0.3}
REFERENCE: dict[str, Any] = {
    "color": "black",
    "linewidth": 1.0,
    "linestyle": (0, (1, 1.5)),
    "zorder": 5,
}
WIDTH = 100
"""Characters in a line of the title."""
LEGEND = 150
"""Characters in a line of the legend."""
FEW = 2
"""Runs whose efforts can be told apart as they are; of more, the running RMS is drawn."""
WINDOW = 0.5
"""Seconds over which that is taken."""
SAME = 1e-4
"""Distance in m below which two references are one."""
EDGE = 3.0
"""Distance in mm from the edge of the screen within which a ball that fell was seen last."""
LEAST_ERROR = 0.1
"""Least height of the axis of the tracking error in mm: less than the screen can tell."""
DPI = 110


def draw(path: Path, runs: Mapping[str, Motion], title: str, area: tuple[float, float]) -> None:
    """Draw runs over their reference into a PNG file.

    Args:
        path: Where to write.
        runs: Label to motion; a reference of all is drawn once, else each run's own.
        title: Heading.
        area: Operating area |x|, |y| in m.

    Raises:
        RecordError: If the file cannot be written.
    """
    content = png(runs, title, area)
    write_whole(path, lambda target: target.write_bytes(content))


def png(runs: Mapping[str, Motion], title: str, area: tuple[float, float]) -> bytes:
    """What ``draw`` writes; arguments as for it."""
    content = BytesIO()
    with mpl.rc_context(LOOK):
        # savefig would draw everything once more before, only to lay it out
        canvas = FigureCanvasAgg(_arranged(runs, title, area))
        canvas.print_png(content)  # type: ignore[no-untyped-call]
    return content.getvalue()


def picture(runs: Mapping[str, Motion], title: str, area: tuple[float, float]) -> Figure:
    """The picture of runs over their reference; arguments as for ``draw``."""
    with mpl.rc_context(LOOK):
        figure = _arranged(runs, title, area)
        # ticks are made when drawn: now, while these settings hold
        figure.draw_without_rendering()
    return figure


def _arranged(runs: Mapping[str, Motion], title: str, area: tuple[float, float]) -> Figure:
    """The picture laid out, for the settings in force."""
    figure = Figure(dpi=DPI)
    FigureCanvasAgg(figure)
    lines = textwrap.wrap(title, WIDTH, max_lines=3, placeholder=" ...")
    if lines:
        figure.suptitle("\n".join(lines), fontsize=HEADING, fontweight="bold", y=0.99)
    panels = figure.subplot_mosaic(
        [["plate", "x"], ["plate", "y"], ["error", "angle"], ["error", "effort"]]
    )
    _plate(panels["plate"], area)
    smooth = len(runs) > FEW
    for index, (label, motion) in enumerate(runs.items()):
        _add(panels, motion, label, index, smooth=smooth)
    shade(panels, runs, COLOURS)
    for label, motion, look in _references(runs):
        _refer(panels, motion, label, look)
    _label(panels, smooth=smooth)
    entries = panels["plate"].get_legend_handles_labels()
    columns = max(1, min(len(entries[1]), LEGEND // (5 + max(map(len, entries[1])))))
    legend = figure.legend(*entries, loc="lower center", ncols=columns, fontsize=LOOK["font.size"])
    arrange(figure, panels, legend, len(lines), LOOK["font.size"])
    return figure


def _references(runs: Mapping[str, Motion]) -> list[tuple[str, Motion, dict[str, Any]]]:
    """Label, motion and look of the references: the one of all runs, or each run's own."""
    longest = max(runs.values(), key=lambda motion: float(motion.time[-1]))
    if all(_same_reference(motion, longest) for motion in runs.values()):
        return [("reference", longest, REFERENCE)]
    return [
        (f"reference of {label}", motion, {**REFERENCE, "color": COLOURS[index % len(COLOURS)]})
        for index, (label, motion) in enumerate(runs.items())
    ]


def _same_reference(motion: Motion, longest: Motion) -> bool:
    """Whether two references, each at the instants of its own run, can not be told apart."""
    other = [np.interp(motion.time, longest.time, axis) for axis in longest.reference.T]
    return np.allclose(motion.reference, np.stack(other, axis=1), rtol=0, atol=SAME)


def _refer(panels: Mapping[str, Axes], motion: Motion, label: str, look: Mapping[str, Any]) -> None:
    desired = 1000 * motion.reference
    panels["plate"].plot(*desired.T, label=label, **look)
    for name, axis in (("x", 0), ("y", 1)):
        panels[name].plot(motion.time, desired[:, axis], **look)


def _plate(panel: Axes, area: tuple[float, float]) -> None:
    for (width, height), style in ((SCREEN, "-"), ((2 * area[0], 2 * area[1]), "--")):
        corner = (-500 * width, -500 * height)
        size = (1000 * width, 1000 * height)
        panel.add_patch(Rectangle(corner, *size, fill=False, ec="0.55", ls=style, lw=1))
    panel.text(-343, 186, "screen", color="0.4", va="top", fontsize=8)
    panel.text(-990 * area[0], 985 * area[1], "operating area", color="0.4", va="top", fontsize=8)
    panel.set(
        aspect="equal", xlabel="x [mm]", ylabel="y [mm]", title="Ball on the screen, from above"
    )
    panel.grid(visible=False)


def _add(
    panels: Mapping[str, Axes], motion: Motion, label: str, index: int, *, smooth: bool
) -> None:
    colour, style = COLOURS[index % len(COLOURS)], STYLES[(index // len(COLOURS)) % len(STYLES)]
    look: dict[str, Any] = {"color": colour, "linewidth": 1.2, "linestyle": style}
    ball = 1000 * motion.ball
    panels["plate"].plot(*ball.T, label=label, **look)
    panels["plate"].plot(*ball[0], "o", color=colour, ms=5)
    gone = (np.abs(ball[-1]) > 500 * np.array(SCREEN) - EDGE).any()  # a cross: it left the plate
    panels["plate"].plot(*ball[-1], "X" if gone else "s", color=colour, ms=9 if gone else 5)
    panels["x"].plot(motion.time, ball[:, 0], **look)
    panels["y"].plot(motion.time, ball[:, 1], **look)
    distance = 1000 * np.hypot(*motion.error.T)
    panels["error"].plot(motion.time, distance, **look)
    plate = np.degrees(motion.plate)
    other: dict[str, Any] = {**look, "alpha": 0.55, "linestyle": (0, (4, 1.5))}
    panels["angle"].plot(motion.time, plate[:, 0], **look)
    panels["angle"].plot(motion.time, plate[:, 1], **other)
    effort = _running_rms(motion.u, motion.time) if smooth else motion.u
    panels["effort"].plot(motion.time, effort[:, 0], **{**look, "linewidth": 0.8})
    panels["effort"].plot(motion.time, effort[:, 1], **{**other, "linewidth": 0.8})


def _running_rms(values: Array, time: Array) -> Array:
    """Root mean square over ``WINDOW`` seconds about each instant; values (K, 2), time (K,)."""
    rate = (len(time) - 1) / max(float(time[-1] - time[0]), 1e-9)
    half = min(len(time) // 2, round(0.5 * WINDOW * rate))
    total = np.concatenate([np.zeros((1, 2)), np.cumsum(values**2, axis=0)])
    index = np.arange(len(time))
    first, last = np.maximum(index - half, 0), np.minimum(index + half + 1, len(time))
    mean = (total[last] - total[first]) / (last - first)[:, None]
    level: Array = np.sqrt(np.maximum(mean, 0.0))
    return level


def _label(panels: Mapping[str, Axes], *, smooth: bool) -> None:
    error = panels["error"]
    distances = np.concatenate([np.asarray(line.get_ydata(), float) for line in error.lines])
    top = float(distances[np.isfinite(distances)].max(initial=0.0))
    error.set(
        ylabel="distance from reference [mm]",
        xlabel="time [s]",
        title="Tracking error",
        ylim=(0, max(1.05 * top, LEAST_ERROR)),
    )
    for name in ("x", "y"):
        panels[name].set_ylabel(f"{name} [mm]")
    panels["x"].set_title("Position (dotted: reference)")
    panels["angle"].set_ylabel("plate angle [deg]")
    effort, what = "plate acc.", "Plate and its acceleration (solid: φ about y; dashed: θ about x)"
    if smooth:
        effort, what = "RMS acc.", f"Plate, RMS over {WINDOW:g} s of its acceleration (dashed: θ)"
    panels["effort"].set(ylabel=f"{effort} [rad/s²]", xlabel="time [s]")
    panels["angle"].set_title(what)
    for name, least in (("x", 1.0), ("y", 1.0), ("angle", 0.05), ("effort", 0.05)):
        low, high = map(float, panels[name].get_ylim())
        if high - low < least:
            middle = (low + high) / 2
            panels[name].set_ylim(middle - least / 2, middle + least / 2)
