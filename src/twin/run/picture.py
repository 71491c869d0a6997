"""The picture of one or several runs: where the ball went, and the effort."""

from __future__ import annotations

import textwrap
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from io import BytesIO
from numbers import Real
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import FillBetweenPolyCollection
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont, get_font
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse, Patch, Rectangle
from matplotlib.transforms import offset_copy

from twin.base.data_file import read_toml
from twin.base.errors import ScenarioError, nearest
from twin.base.page import TEXT_AS_TEXT
from twin.run.metrics import Motion
from twin.scenario.schema import Dimensions

MARKED_PANELS = ("x", "y", "error")
STRIP_STYLE: Any = {"alpha": 0.6, "linewidth": 0}
STRIP_HEIGHT = 0.035
"""Height of a strip as a share of a panel's."""
MAX_NAMED_SHARES = 3
"""Runs that the legend names with their share of the time."""
NEUTRAL_GREY = "0.5"
"""Colour of the legend's entry for several runs, each of which has bands in its own."""


def shade(panels: Mapping[str, Axes], runs: Mapping[str, Motion], colours: Sequence[str]) -> None:
    """Mark where friction held the ball: a strip at the foot in the colour of each run.

    Args:
        panels: The panels by name.
        runs: Label to motion.
        colours: Of the runs, again from the first when they are used up.
    """
    shares: dict[str, float] = {}
    for index, (label, motion) in enumerate(runs.items()):
        if motion.held is None or not motion.held.any():
            continue
        shares[label] = 100 * float(motion.held.mean())
        look = {"where": motion.held, "facecolor": colours[index % len(colours)], **STRIP_STYLE}
        for panel in (panels[name] for name in MARKED_PANELS):
            across = panel.get_xaxis_transform()
            panel.fill_between(motion.time, 0, STRIP_HEIGHT, transform=across, **look)
    if shares:
        words = f"held by friction, {_of_time(shares)} of the time"
        panels["plate"].fill_between([], [], [], label=words, facecolor=NEUTRAL_GREY, **STRIP_STYLE)


def _of_time(shares: Mapping[str, float]) -> str:
    """Shares of the time in %: of one run, of each of a few, or from the least to the largest."""
    if len(shares) == 1:
        return f"{next(iter(shares.values())):.1f} %"
    if len(shares) <= MAX_NAMED_SHARES:
        return ", ".join(f"{literal(label)} {share:.1f} %" for label, share in shares.items())
    return f"{min(shares.values()):.1f} to {max(shares.values()):.1f} %"


# Okabe and Ito's colours, distinct with any colour vision; their orange darker and indigo for
# their light blue, which are hard to see as lines on white.
RUN_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#B57D00", "#4B2E83")
LINE_STYLES = ("-", "--", "-.", ":")
LOOK_COUNT = len(RUN_COLOURS) * len(LINE_STYLES)
"""Runs that differ in colour or style; the legend has no more."""
RC_PARAMETERS: Any = {
    "font.size": 9,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.formatter.limits": (-4, 4),  # ticks stay short, whatever ran away
}
REFERENCE_STYLE: dict[str, Any] = {
    "color": "black",
    "linewidth": 1.0,
    "linestyle": (0, (1, 1.5)),
    "zorder": 5,
}
WALL_STYLE: dict[str, Any] = {"color": "0.55", "linewidth": 2.0}
"""Style of the lines in the panels of x and y where walls stop the ball."""
SECOND_AXIS_STYLE: dict[str, Any] = {"alpha": 0.55, "linestyle": (0, (4, 1.5))}
"""Style of theta, which is drawn with phi in one panel."""
MAX_TITLE_LETTERS = 100
"""Characters in a line of the title."""
LEGEND_WIDTH = 150
"""Characters in a line of the legend."""
SAME_REFERENCE_M = 1e-4
"""Distance in m below which two references are one."""
EDGE_DISTANCE_M = 0.003
"""Distance in m from the edge of the screen within which a ball that fell was seen last."""
LEAST_ERROR = 0.1
"""Least height of the axis of the tracking error in mm: less than the screen can tell."""
PICTURE_DPI = 110
POINTS_PER_INCH = 72.0
"""Points; the lengths below are in points."""
PICTURE_WIDTH_PT, PANELS_HEIGHT_PT, TITLE_SIZE_PT = 864.0, 434.0, 12.0
"""Width of the picture, height of all panels, font size of the title."""
ROOM_BELOW_PT, ROOM_ABOVE_PT = 39.0, 22.0
"""Room below the lowest panel, for ticks and label, and above the highest, for its title."""
LABEL_OFFSET_PT = -44.0
"""From a panel to the label of its vertical axis: past a tick of five digits and a sign."""
_PANEL_TABLES = read_toml(Path(__file__).with_suffix(".toml"))
PANEL_PLACES: dict[str, list[float]] = {
    name: about["place"] for name, about in _PANEL_TABLES.items()
}
"""Left, bottom, width and height of each panel. To have matplotlib find them costs half as much
again as the whole picture: it draws every text to see how large it is."""


def _panel_tables(plate: Dimensions) -> dict[str, dict[str, Any]]:
    """The panels that the picture of a rig has, by name."""
    if plate.axes == 2:
        return _PANEL_TABLES
    own = {name: about.get("of_one_axis") for name, about in _PANEL_TABLES.items()}
    return {
        name: {
            **_PANEL_TABLES[name],
            "place": table["place"],
            "words": _PANEL_TABLES[name]["words"] | table.get("words", {}),
        }
        for name, table in own.items()
        if table is not None
    }


REFERENCE_LABEL = "reference"
HAVE_NO_REFERENCE = ("error", "angle", "effort")
"""Panels that do not draw the reference."""
MM_PER_INCH = 25.4
MIN_WIDTH_MM, MAX_WIDTH_MM = 30.0, 400.0
"""Widths that a single panel may have."""
PAPER_FONT_PT = 8
LEAST_SHAPE = 0.6
"""Height of a single panel over time, legend included, as a share of its width, at least."""


def style(index: int) -> dict[str, Any]:
    """Colour and style of the lines of one of several runs, the same in every picture of them."""
    again = index // len(RUN_COLOURS) % len(LINE_STYLES)
    return {"color": RUN_COLOURS[index % len(RUN_COLOURS)], "linestyle": LINE_STYLES[again]}


NO_GLYPH = "\N{WHITE SQUARE}"
"""Stands for a character that no font has."""
NO_GLYPH_WARNING = (
    f"pictures: no font in use has some of the characters, {NO_GLYPH} stands for them; "
    "name a font that has them in a matplotlibrc, as font.family: sans-serif, Noto Sans CJK SC"
)


def literal(text: str) -> str:
    """A text that somebody chose, as matplotlib shows it as it is: no formula, and in a legend.

    What no font in use has becomes `NO_GLYPH`, with one warning in all.
    """
    if not text.isascii():
        known = _characters(tuple(mpl.rcParams["font.family"]))
        shown = "".join(c if ord(c) in known or c.isspace() else NO_GLYPH for c in text)
        if shown != text:
            _warn_of_glyphs()
        text = shown
    plain = text.replace("$", r"\$")
    return f" {plain}" if plain.startswith("_") else plain


@cache  # however many pictures there are
def _warn_of_glyphs() -> None:
    warnings.warn(NO_GLYPH_WARNING, stacklevel=3)


@cache
def _characters(families: tuple[str, ...]) -> frozenset[int]:
    """Code points that fonts of these families have, plain and bold."""
    found: list[set[int]] = []
    for weight in ("normal", "bold"):
        fonts = [FontProperties(family=[each], weight=weight) for each in families]
        found.append({code for font in fonts for code in get_font(findfont(font)).get_charmap()})
    return frozenset(found[0] & found[1])


@contextmanager
def styled_figure(width: float, height: float) -> Iterator[Figure]:
    """A figure of a size in inches to draw on within, in the one look of all."""
    with mpl.rc_context(RC_PARAMETERS):
        figure = Figure(figsize=(width, height), layout="constrained")
        yield figure
        # ticks and texts are laid out when drawn: now, while these settings hold
        figure.draw_without_rendering()


def png(runs: Mapping[str, Motion], title: str, plate: Dimensions) -> bytes:
    """Runs drawn over their reference, as PNG.

    Args:
        runs: Label to motion; a reference of all is drawn once, else each run's own.
        title: Heading.
        plate: Screen and operating area.
    """
    content = BytesIO()
    with mpl.rc_context(RC_PARAMETERS):
        # savefig would draw everything once more before, only to lay it out
        canvas = FigureCanvasAgg(_arrange_panels(runs, title, plate))
        canvas.print_png(content)  # type: ignore[no-untyped-call]
    return content.getvalue()


def picture(
    runs: Mapping[str, Motion], title: str, plate: Dimensions, kind: type[Figure] = Figure
) -> Figure:
    """The picture of runs over their reference, a figure of a kind; others as for ``png``."""
    with mpl.rc_context(RC_PARAMETERS):
        figure = _arrange_panels(runs, title, plate, kind)
        # ticks are made when drawn: now, while these settings hold
        figure.draw_without_rendering()
    return figure


class PaperFigure(Figure):
    """A figure with text as text in PDF, PS and SVG files, in fonts that journals accept."""

    def savefig(self, fname: Any, **options: Any) -> None:
        """Write it, as ``Figure.savefig`` does."""
        with mpl.rc_context(TEXT_AS_TEXT):
            super().savefig(fname, **options)


def panel(
    runs: Mapping[str, Motion], names: str | Sequence[str], plate: Dimensions, width_mm: float
) -> PaperFigure:
    """One panel of the picture, or several below each other, for a paper or a thesis.

    Args:
        runs: Label to motion, as for ``png``.
        names: Which: keys of ``PANEL_PLACES``, from the top.
        plate: Screen and operating area.
        width_mm: Width of the figure in mm; its height follows the panels' shapes.

    Raises:
        ScenarioError: If there is no such panel, one is given twice, or the width is not 30 to 400
            mm.
    """
    chosen: list[Any] = list(names) if isinstance(names, list | tuple) else [names]
    shapes = [_paper_shape(name, plate) for name in chosen]
    if not chosen or len(set(chosen)) < len(chosen):
        raise ScenarioError(f"panel {chosen}: give one or more panels, each once")
    if not isinstance(width_mm, Real) or not MIN_WIDTH_MM <= width_mm <= MAX_WIDTH_MM:
        limits = f"{MIN_WIDTH_MM:g} to {MAX_WIDTH_MM:g}"
        raise ScenarioError(f"width_mm: must be {limits}, got {width_mm!r}")
    with mpl.rc_context({**RC_PARAMETERS, "font.size": PAPER_FONT_PT}):
        width = width_mm / MM_PER_INCH
        size = width, width * sum(shapes)
        figure = PaperFigure(figsize=size, dpi=PICTURE_DPI, layout="constrained")
        FigureCanvasAgg(figure)
        rows = figure.add_gridspec(len(shapes), height_ratios=shapes)
        panels = {each: figure.add_subplot(rows[0]) for each in PANEL_PLACES}
        _draw(panels, runs, plate)
        entries = _panel_legend(panels["plate"], chosen, plate.axes)
        for each in PANEL_PLACES.keys() - set(chosen):
            panels[each].remove()
        for row, name in enumerate(chosen):
            panels[name].set_subplotspec(rows[row])
            for words in panels[name].texts:
                words.remove()  # too large for it: plate and area are outlines that everybody knows
            panels[name].set(title="", xlabel="x [mm]" if name == "plate" else "time [s]")
            panels[name].tick_params(labelbottom=True)
        if "error" in chosen:
            panels["error"].set_ylabel("error [mm]")
        if len(entries) > 1:
            figure.legend(*zip(*entries, strict=True), loc="outside lower center", ncols=3)
        figure.draw_without_rendering()
    return figure


def _paper_shape(name: str, plate: Dimensions) -> float:
    """Height of a panel by itself as a share of its width.

    Raises:
        ScenarioError: If there is no such panel.
    """
    tables = _panel_tables(plate)
    if not isinstance(name, str) or name not in tables:
        known = nearest(str(name), PANEL_PLACES)
        lacks = ": a rig of one axis has none" if name in PANEL_PLACES else f": unknown{known}"
        raise ScenarioError(f"panel '{name!s:.40}'{lacks}")
    *_, wide, high = tables[name]["place"]
    shape = float(high / wide)
    return shape if name == "plate" else max(shape, LEAST_SHAPE)


def _panel_legend(plate: Axes, names: Sequence[str], axes: int) -> list[tuple[Artist, str]]:
    """The entries of the legend of single panels, from those of the whole picture."""
    shown = set(names)
    entries: list[tuple[Artist, str]] = []
    for handle, label in zip(*plate.get_legend_handles_labels(), strict=True):
        if isinstance(handle, FillBetweenPolyCollection):
            if not shown.isdisjoint(MARKED_PANELS):
                entries.append((handle, "held by friction"))
        elif label != REFERENCE_LABEL or shown - set(HAVE_NO_REFERENCE):
            entries.append((handle, label))
    if shown & {"angle", "effort"} and axes == 2:
        entries.append((Line2D([], [], color="black"), "φ"))
        entries.append((Line2D([], [], color="black", **SECOND_AXIS_STYLE), "θ"))
    return entries


def _arrange_panels(
    runs: Mapping[str, Motion], title: str, plate: Dimensions, kind: type[Figure] = Figure
) -> Figure:
    """The picture laid out, for the settings in force."""
    figure = kind(
        dpi=PICTURE_DPI,
        figsize=(PICTURE_WIDTH_PT / POINTS_PER_INCH, PANELS_HEIGHT_PT / POINTS_PER_INCH),
    )
    FigureCanvasAgg(figure)
    tables = _panel_tables(plate)
    # of their true size from the start, on which it depends which ticks there are
    panels = {
        name: figure.add_axes(
            (
                left / PICTURE_WIDTH_PT,
                low / PANELS_HEIGHT_PT,
                wide / PICTURE_WIDTH_PT,
                high / PANELS_HEIGHT_PT,
            )
        )
        for name, (left, low, wide, high) in PANEL_PLACES.items()
    }
    _draw(panels, runs, plate)
    legend = _legend(figure, panels["plate"], len(runs))
    for name in PANEL_PLACES.keys() - tables.keys():
        panels.pop(name).remove()
    places = {name: about["place"] for name, about in tables.items()}
    _place(figure, panels, places, legend, title)
    return figure


def _draw(panels: Mapping[str, Axes], runs: Mapping[str, Motion], plate: Dimensions) -> None:
    """Draw runs into the panels."""
    _outline(panels["plate"], plate)
    for name, between in zip("xy", plate.rim, strict=True):
        if between:
            for side in (-500, 500):
                panels[name].axhline(side * (between - 2 * plate.ball), **WALL_STYLE)
    # seen last at the edge of the screen: it left the plate
    lost = [
        bool((plate.within(m.ball[-1], EDGE_DISTANCE_M) != m.ball[-1]).any()) for m in runs.values()
    ]
    for index, (label, motion) in enumerate(runs.items()):
        _add(panels, motion, label, index, plate.axes, lost=lost[index])
    _refer(panels, runs)
    _label(panels, plate)
    shade(panels, runs, RUN_COLOURS)
    if any(lost):
        panels["plate"].plot([], [], "X", color=NEUTRAL_GREY, label="left the plate")


def _legend(figure: Figure, panel: Axes, runs: int) -> Legend:
    """Description of the curves, as far as they can be distinguished."""
    entries = list(zip(*panel.get_legend_handles_labels(), strict=True))
    entries = [*entries[: min(runs, LOOK_COUNT)], *entries[runs:]]
    columns = max(
        1, min(len(entries), LEGEND_WIDTH // (5 + max(len(words) for _, words in entries)))
    )
    return figure.legend(*zip(*entries, strict=True), loc="lower center", ncols=columns)


def _place(
    figure: Figure,
    panels: Mapping[str, Axes],
    places: Mapping[str, Sequence[float]],
    legend: Legend,
    title: str,
) -> None:
    """Put all in its place: the legend below, the title above."""
    lines = textwrap.wrap(title, MAX_TITLE_LETTERS, max_lines=3, placeholder=" ...")
    bottom = POINTS_PER_INCH * legend.get_window_extent().height / figure.dpi + ROOM_BELOW_PT
    height = (
        bottom
        + PANELS_HEIGHT_PT
        + ROOM_ABOVE_PT
        + (1.22 * TITLE_SIZE_PT * len(lines) + 8 if lines else 4)
    )
    figure.set_size_inches(PICTURE_WIDTH_PT / POINTS_PER_INCH, height / POINTS_PER_INCH)
    if lines:
        top = 1 - 5 / height
        figure.suptitle(literal("\n".join(lines)), fontsize=TITLE_SIZE_PT, fontweight="bold", y=top)
    for name, (left, low, wide, high) in places.items():
        panel = panels[name]
        panel.set_position(
            (
                left / PICTURE_WIDTH_PT,
                (bottom + low) / height,
                wide / PICTURE_WIDTH_PT,
                high / height,
            )
        )
        side = offset_copy(panel.transAxes, figure, x=LABEL_OFFSET_PT, units="points")
        panel.yaxis.set_label_coords(0.0, 0.5, side)
        below = offset_copy(panel.transAxes, figure, y=-20, units="points")
        panel.xaxis.set_label_coords(0.5, 0.0, below)
        panel.set_title(panel.get_title(), y=1.0, pad=5)  # else looked for in each drawing


def _refer(panels: Mapping[str, Axes], runs: Mapping[str, Motion]) -> None:
    """Draw the reference of each run, the longest of those that are one."""
    shown: list[Motion] = []
    for motion in sorted(runs.values(), key=lambda each: -each.time[-1]):
        if any(_same_reference(motion, longer) for longer in shown):
            continue
        shown.append(motion)
        desired = 1000 * motion.reference
        panels["plate"].plot(*desired.T, **REFERENCE_STYLE)
        for name, axis in (("x", 0), ("y", 1)):
            panels[name].plot(motion.time, desired[:, axis], **REFERENCE_STYLE)
    panels["plate"].plot([], [], label=REFERENCE_LABEL, **REFERENCE_STYLE)


def _same_reference(motion: Motion, longest: Motion) -> bool:
    """Whether two references, each at the instants of its own run, cannot be distinguished."""
    other = [np.interp(motion.time, longest.time, axis) for axis in longest.reference.T]
    return np.allclose(motion.reference, np.stack(other, axis=1), rtol=0, atol=SAME_REFERENCE_M)


def _outline(panel: Axes, plate: Dimensions) -> None:
    screen, area = plate.screen, plate.area
    # walls that one axis alone has go to the edges of the plate along the other
    walls = tuple(b or s for b, s in zip(plate.rim, screen, strict=True)) if any(plate.rim) else ()
    lines = ((screen, "-", 1.0), ((2 * area[0], 2 * area[1]), "--", 1.0), (walls, "-", 2.0))
    for sides, style, thick in lines:
        if not sides:
            continue
        width, height = sides
        size = (1000 * width, 1000 * height)
        edge: Patch = Rectangle((-500 * width, -500 * height), *size)
        if plate.round and style == "-":
            edge = Ellipse((0, 0), *size)
        edge.set(fill=False, ec="0.55", ls=style, lw=thick)
        panel.add_patch(edge)
    panel.text(-490 * screen[0], 471 * screen[1], "plate", color="0.4", va="top", fontsize=8)
    panel.text(-990 * area[0], 985 * area[1], "operating area", color="0.4", va="top", fontsize=8)
    panel.set(aspect="equal")
    panel.grid(visible=False)


def _add(
    panels: Mapping[str, Axes], motion: Motion, label: str, index: int, axes: int, *, lost: bool
) -> None:
    look: dict[str, Any] = {**style(index), "linewidth": 1.2}
    colour = look["color"]
    ball = 1000 * motion.ball
    panels["plate"].plot(*ball.T, label=literal(label), **look)
    panels["plate"].plot(*ball[0], "o", color=colour, ms=5)
    end: dict[str, Any] = {"color": colour, "marker": "X" if lost else "s", "ms": 9 if lost else 5}
    panels["plate"].plot(*ball[-1], **end)
    distance = 1000 * np.hypot(*motion.error.T)
    for name, values in (("x", ball[:, 0]), ("y", ball[:, 1]), ("error", distance)):
        panels[name].plot(motion.time, values, **look)
        if lost:
            panels[name].plot(motion.time[-1], values[-1], **{**end, "ms": 7})
    plate = np.degrees(motion.plate)
    other: dict[str, Any] = {**look, **SECOND_AXIS_STYLE}
    panels["angle"].plot(motion.time, plate[:, 0], **look)
    # the larger the effort, the further behind: a noisy command would hide all others
    usual = float(np.median(np.abs(np.nan_to_num(motion.u))))
    effort = {"linewidth": 0.8, "zorder": 2 + 1 / (1 + usual)}
    panels["effort"].plot(motion.time, motion.u[:, 0], **{**look, **effort})
    if axes == 2:
        panels["angle"].plot(motion.time, plate[:, 1], **other)
        panels["effort"].plot(motion.time, motion.u[:, 1], **{**other, **effort})


def _label(panels: Mapping[str, Axes], plate: Dimensions) -> None:
    tables, error = _panel_tables(plate), panels["error"]
    lines = [np.asarray(line.get_ydata(), float) for line in error.lines]
    top = max((float(each[np.isfinite(each)].max(initial=0.0)) for each in lines), default=0.0)
    for name, about in tables.items():
        panels[name].set(**about["words"])
    error.set(ylim=(0, max(1.05 * top, LEAST_ERROR)))
    if plate.axes == 2:
        for name in ("x", "angle"):
            panels[name].tick_params(labelbottom=False)  # those of the panel below serve it
    for name, least in ((name, about.get("least", 0.0)) for name, about in tables.items()):
        low, high = map(float, panels[name].get_ylim())
        if high - low < least:
            middle = (low + high) / 2
            panels[name].set_ylim(middle - least / 2, middle + least / 2)
