"""The picture of one or several runs: where the ball went, and what it took."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import Rectangle

from twin.hal.interface import SCREEN
from twin.run.metrics import Motion
from twin.run.record import write_whole

# Okabe and Ito's colours: told apart with any colour vision, and in grey.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
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
DPI = 110


def draw(path: Path, runs: Mapping[str, Motion], title: str, area: tuple[float, float]) -> None:
    """Draw runs over their reference into a PNG file.

    Args:
        path: Where to write.
        runs: Label to motion; the first one's reference is drawn.
        title: Heading.
        area: Operating area |x|, |y| in m.

    Raises:
        RecordError: If the file cannot be written.
    """
    with mpl.rc_context(LOOK):
        drawn = _arranged(runs, title, area)
        write_whole(path, lambda target: drawn.savefig(target, dpi=DPI, format="png"))


def picture(runs: Mapping[str, Motion], title: str, area: tuple[float, float]) -> Figure:
    """The picture of runs over their reference; arguments as for ``draw``."""
    with mpl.rc_context(LOOK):
        figure = _arranged(runs, title, area)
        # ticks are made when drawn: now, while these settings hold
        figure.draw_without_rendering()
    return figure


def _arranged(runs: Mapping[str, Motion], title: str, area: tuple[float, float]) -> Figure:
    """The picture laid out, for the settings in force."""
    figure = Figure(figsize=(12, 7.2), dpi=DPI)
    if title:
        lines = textwrap.wrap(title, WIDTH, max_lines=3, placeholder=" ...")
        figure.suptitle("\n".join(lines), fontsize=12, fontweight="bold")
    panels = figure.subplot_mosaic(
        [["plate", "x"], ["plate", "y"], ["error", "angle"], ["error", "effort"]],
        width_ratios=(1.15, 1),
    )
    reference = next(iter(runs.values()))
    _plate(panels["plate"], area)
    panels["plate"].plot(*(1000 * reference.reference.T), label="reference", **REFERENCE)
    for name, axis in (("x", 0), ("y", 1)):
        panels[name].plot(reference.time, 1000 * reference.reference[:, axis], **REFERENCE)
        panels[name].set_ylabel(f"{name} [mm]")
    for index, (label, motion) in enumerate(runs.items()):
        _add(panels, motion, label, index)
    _label(panels, single=len(runs) == 1)
    # once; as the figure's own engine it would lay out, and draw, once more for each file
    ConstrainedLayoutEngine().execute(figure)
    return figure


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


def _add(panels: Mapping[str, Axes], motion: Motion, label: str, index: int) -> None:
    colour, style = COLOURS[index % len(COLOURS)], STYLES[(index // len(COLOURS)) % len(STYLES)]
    look: dict[str, Any] = {"color": colour, "linewidth": 1.2, "linestyle": style}
    ball = 1000 * motion.ball
    panels["plate"].plot(*ball.T, label=label, **look)
    panels["plate"].plot(*ball[0], "o", color=colour, ms=5)
    panels["plate"].plot(*ball[-1], "s", color=colour, ms=5)
    panels["x"].plot(motion.time, ball[:, 0], **look)
    panels["y"].plot(motion.time, ball[:, 1], **look)
    distance = 1000 * np.hypot(*motion.error.T)
    panels["error"].plot(motion.time, distance, label=label, **look)
    plate = np.degrees(motion.plate)
    other: dict[str, Any] = {**look, "alpha": 0.55, "linestyle": (0, (4, 1.5))}
    panels["angle"].plot(motion.time, plate[:, 0], **look)
    panels["angle"].plot(motion.time, plate[:, 1], **other)
    panels["effort"].plot(motion.time, motion.u[:, 0], **{**look, "linewidth": 0.8})
    panels["effort"].plot(motion.time, motion.u[:, 1], **{**other, "linewidth": 0.8})


def _label(panels: Mapping[str, Axes], *, single: bool) -> None:
    panels["plate"].legend(loc="lower right", fontsize=8)
    panels["error"].set(
        ylabel="distance from reference [mm]",
        xlabel="time [s]",
        title="Tracking error",
        ylim=(0, None),
    )
    if not single:
        panels["error"].legend(loc="center right", fontsize=8)
    panels["x"].set_title("Position (dotted: reference)")
    panels["angle"].set_ylabel("plate angle [deg]")
    panels["effort"].set(ylabel="plate acc. [rad/s²]", xlabel="time [s]")
    panels["angle"].set_title("Plate and its acceleration (solid: φ about y; dashed: θ about x)")
