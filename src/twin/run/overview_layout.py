"""Where the parts of a run's picture stand.

Known from the lines of title and legend and from the texts at the ticks. To let matplotlib find it
takes as long as drawing the picture: it draws every text to see how large it is.
"""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.transforms import offset_copy

INCH = 72.0
"""Points; all lengths below are in points."""
LINE = 1.22
"""Height of a line of text over its font size."""
DIGIT, MINUS = 0.64, 0.84
"""Widths of characters at a tick over their font size; of all others a digit's is enough."""
EDGE = 7.0
"""Between the outermost texts and the edge of the picture, and between a text and the next."""
NEAR = 3.0
"""Between the texts at an axis and its label."""
TICK = 7.0
"""From an axis to the text at its ticks."""
TITLE = 6.0
"""From a panel to its title."""
HEADING = 12.0
"""Font size of the title of all."""
LEFT: tuple[str, ...] = ("plate", "error")
RIGHT: tuple[str, ...] = ("x", "y", "angle", "effort")
"""The panels of the two columns, from the top."""
SHARES = (1.15 / 2.15, 1 / 2.15)
"""The columns' parts of the width."""
WIDE, ROW = 864.0, 82.0
"""Width of the picture, and height of one of four panels above each other."""
GAP = 23.0
"""Between two panels of a column with ticks, but no label and no title between them."""


def arrange(
    figure: Figure, panels: Mapping[str, Axes], legend: Legend, lines: int, size: float
) -> None:
    """Place panels, their labels and their titles; what is drawn in them is known.

    Args:
        figure: The picture, made as high as it has to be.
        panels: Those of ``LEFT`` and ``RIGHT`` by name.
        legend: Stands at the bottom.
        lines: Lines of the title at the top.
        size: Font size of the texts of the panels.
    """
    text = LINE * size
    label = TICK + text + NEAR - EDGE / 2  # from an axis down to its label
    title = TITLE + 1.2 * text  # of a panel, whose title is larger than its other texts
    between = label + text + title + EDGE
    half = 2 * ROW + GAP
    bottom = INCH * legend.get_window_extent().height / figure.dpi + label + text + EDGE
    top = bottom + 2 * half + between
    height = top + title + (LINE * HEADING * lines + EDGE + NEAR if lines else EDGE)
    figure.set_size_inches(WIDE / INCH, height / INCH)
    floors = {
        LEFT: (top - half, bottom),
        RIGHT: (top - ROW, top - half, bottom + ROW + GAP, bottom),
    }
    tall = {LEFT: half, RIGHT: ROW}
    for names in (LEFT, RIGHT):  # which ticks there are follows from the height alone
        for name in names:
            panels[name].set_position((0.1, 0.1, 0.4, tall[names] / height))
    beside = {name: TICK + _widest(panel.yaxis, size) + NEAR for name, panel in panels.items()}
    margins = {names: max(beside[name] for name in names) + text + EDGE for names in floors}
    free = WIDE - sum(margins.values()) - 3 * EDGE
    left = 0.0
    for (names, places), share in zip(floors.items(), SHARES, strict=True):
        left += margins[names]
        for name, floor in zip(names, places, strict=True):
            panel = panels[name]
            box = (left / WIDE, floor / height, share * free / WIDE, tall[names] / height)
            panel.set_position(box)
            side = offset_copy(panel.transAxes, figure, x=-beside[name], units="points")
            panel.yaxis.set_label_coords(0.0, 0.5, side)
            below = offset_copy(panel.transAxes, figure, y=-label, units="points")
            panel.xaxis.set_label_coords(0.5, 0.0, below)
            panel.set_title(panel.get_title(), y=1.0, pad=TITLE)  # else looked for in each drawing
        left += share * free + 2 * EDGE


def _widest(axis: Axis, size: float) -> float:
    """Width of the longest text at the ticks of an axis."""
    texts = axis.get_major_formatter().format_ticks(list(axis.get_majorticklocs()))
    widths = (DIGIT * len(text) + (MINUS - DIGIT) * text.count("−") for text in texts)
    return size * max(widths, default=0.0)
