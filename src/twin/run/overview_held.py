"""Strips in a run's picture where friction held the ball at rest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from controllers.arrays import Array, Mask
from twin.run.metrics import Motion

PANELS = ("x", "y", "error")
LOOK: Any = {"alpha": 0.6, "linewidth": 0}
HEIGHT, HIGHEST = 0.035, 0.14
"""Height of a strip, and of all of them at most, as shares of a panel's."""
GREY = "0.5"
"""Colour of the legend's entry for several runs, each of which has bands in its own."""


def shade(panels: Mapping[str, Axes], runs: Mapping[str, Motion], colours: Sequence[str]) -> None:
    """Mark where friction held the ball: a thin strip for each such run, below the curves.

    Args:
        panels: The panels by name.
        runs: Label to motion.
        colours: Of the runs, again from the first when they are used up.
    """
    found: list[tuple[str, str, Mask, Array]] = [
        (label, colours[index % len(colours)], motion.held, motion.time)
        for index, (label, motion) in enumerate(runs.items())
        if motion.held is not None and motion.held.any()
    ]
    if not found:
        return
    height = min(HEIGHT, HIGHEST / len(found))
    share = len(found) * height
    for panel in (panels[name] for name in PANELS):  # room for them below the curves
        low, high = map(float, panel.get_ylim())
        panel.set_yticks([at for at in panel.get_yticks() if low <= at <= high])
        panel.set_ylim(low - share / (1 - share) * (high - low), high)
    for lane, (_, colour, held, time) in enumerate(reversed(found)):
        edges = np.flatnonzero(np.diff(held, prepend=False, append=False))
        first, last = time[edges[::2]], time[edges[1::2] - 1]
        spans = list(zip(first, last - first, strict=True))
        place = (lane * height, 0.8 * height)
        for panel in (panels[name] for name in PANELS):
            across = panel.get_xaxis_transform()
            panel.broken_barh(spans, place, transform=across, facecolors=colour, **LOOK)
    shares = [100 * float(held.mean()) for _, _, held, _ in found]
    ends = dict.fromkeys(f"{share:.1f}" for share in (min(shares), max(shares)))
    words = f"held by friction, {' to '.join(ends)} % of the time"
    whose = f"{found[0][0]} " if len(found) == 1 < len(runs) else ""
    colour = found[0][1] if len(found) == 1 else GREY
    panels["plate"].fill_between([], [], [], label=whose + words, facecolor=colour, **LOOK)
