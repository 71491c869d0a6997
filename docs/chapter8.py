"""The pages on chapter 8 of the thesis, reproduction*.md, with figures like its 8.1 to 8.28.

uv run python docs/chapter8.py
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray
from PIL import Image

from controllers.arrays import Array
from controllers.ballplate import BALL_ACCELERATIONS, BallPlate
from docs.pages import filled, write
from twin.base.page import markdown
from twin.base.writing import write_whole
from twin.run.picture import REFERENCE_STYLE, RUN_COLOURS
from twin.thesis import chapter8
from twin.thesis.chapter8 import ThesisCell
from twin.thesis.chapter8_runs import Results, plan, row_results
from twin.thesis.chapter8_tables import SimulatedTable, tables
from twin.thesis.columns import THESIS_COLUMNS

MECHANISM: dict[str, Any] = {"color": "0.1", "linestyle": (0, (4, 4)), "linewidth": 0.6}
"""The mechanism's lines, dashed over the exact model's."""
LOOK: Any = {
    "font.size": 8.5,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "lines.linewidth": 1.1,
}
PALETTE = 96
"""Colours a picture keeps: enough for lines, and a third of the size."""


def draw_table(path: Path, table: SimulatedTable, found: Results) -> None:
    """Errors or positions, plate angles and efforts of a table's rows, on both plants.

    Raises:
        RecordError: If the file cannot be written.
    """
    step = table.rows[0].setup["reference"]["kind"] == "hold"
    with _drawn(path, 3, f"Table {table.id}: {table.title}", mechanism=True) as panels:
        for index, row in enumerate(table.rows):
            label = row.detail or _omega(row.name)
            ours, mujoco = (found[(table.id, index), way].excerpt for way in ("sampled", "mujoco"))
            _add(panels, ours, step=step, color=RUN_COLOURS[index], label=label)
            _add(panels, mujoco, step=step, zorder=4, **MECHANISM)
        for axis, name in enumerate("xy"):
            panels[0, axis].set_ylabel(f"{name} [mm]" if step else f"error of {name} [mm]")
            if step:
                panels[0, axis].plot(
                    ours["time"], 1000 * ours["reference"][:, axis], **REFERENCE_STYLE
                )


def draw_observer(path: Path, table: SimulatedTable, index: int, found: Results) -> None:
    """True and estimated states and the efforts of one observer.

    Raises:
        RecordError: If the file cannot be written.
    """
    row = table.rows[index]
    shown = found[(table.id, index), "sampled"].excerpt
    names = (("x", "x'", "φ", "φ'"), ("y", "y'", "θ", "θ'"))
    scales = ((1000, "mm"), (1000, "mm/s"), (180 / np.pi, "deg"), (180 / np.pi, "deg/s"))
    title = f"Table {table.id}: {row.name}, first of the noisy runs"
    with _drawn(path, 5, title) as panels:
        for axis in (0, 1):
            for state, (scale, unit) in enumerate(scales):
                panel, at = panels[state, axis], 4 * axis + state
                for values, colour, label in (
                    (shown["estimate"], RUN_COLOURS[1], "estimated"),
                    (shown["state"], RUN_COLOURS[0], "true"),
                ):
                    panel.plot(shown["time"], scale * values[:, at], color=colour, label=label)
                panel.set_ylabel(f"{names[axis][state]} [{unit}]")
            panels[4, axis].plot(shown["time"], shown["applied"][:, axis], color=RUN_COLOURS[0])
            panels[4, axis].set_ylabel(f"{names[axis][2]}″ [rad/s²]")


class Terms(NamedTuple):
    """Accelerations over c1 along a motion, each of shape (..., 2) for x and y, in m/s^2.

    Attributes:
        main: g sin(phi) and -g sin(theta), the right of (6.42).
        neglected: Centrifugal and gyroscopic terms, the left of (6.42).
        unlisted: What (6.44) leaves out and (6.42) does not name: the plate accelerations and
            cos(theta) beside sin(phi).
    """

    main: Array
    neglected: Array
    unlisted: Array


def terms(model: BallPlate, x: Array, u: Array) -> Terms:
    """Split the ball's acceleration along a motion.

    Args:
        model: The exact model.
        x: States, shape (..., 8).
        u: Plate accelerations in rad/s^2, shape (..., 2).
    """
    exact = model.derivative(x, u)[..., BALL_ACCELERATIONS] / model.c1
    main = model.flat(x, u)[..., BALL_ACCELERATIONS] / model.c1
    drift = model.f(x)[..., BALL_ACCELERATIONS] / model.c1
    gravity = main.copy()
    gravity[..., 0] *= np.cos(x[..., 6])
    return Terms(main, drift - gravity, exact - main - (drift - gravity))


def draw_neglected(path: Path, table: SimulatedTable, found: Results) -> None:
    """Main and neglected terms of (6.42) on the exact model, as in the thesis's Figure 8.6.

    Raises:
        RecordError: If the file cannot be written.
    """
    title = "Main and neglected terms of (6.42), AFL, full state feedback"
    with _drawn(path, 2, title) as panels:
        for index, row in enumerate(table.rows):
            shown = found[(table.id, index), "sampled"].excerpt
            parts = terms(BallPlate(), shown["state"], shown["applied"])
            look = {"color": RUN_COLOURS[index], "label": _omega(row.name)}
            for axis in (0, 1):
                panels[0, axis].plot(shown["time"], parts.main[:, axis], **look)
                panels[1, axis].plot(shown["time"], 1000 * parts.neglected[:, axis], **look)
        for axis, name in enumerate("xy"):
            panels[0, axis].set_ylabel(f"main, {name} [m/s²]")
            panels[1, axis].set_ylabel(f"neglected, {name} [mm/s²]")


@contextmanager
def _drawn(path: Path, rows: int, title: str, *, mechanism: bool = False) -> Iterator[NDArray[Any]]:
    """Panels, two a row, to draw on within; then they are written as a PNG of few colours.

    Args:
        path: Of the picture.
        rows: Of panels.
        title: Above them.
        mechanism: Whether the legend tells of the mechanism's lines.
    """
    with mpl.rc_context(LOOK):
        figure = Figure(figsize=(9.6, 0.6 + 1.65 * rows), layout="constrained")
        figure.suptitle(title, fontsize=10.5, fontweight="bold")
        panels = figure.subplots(rows, 2, sharex=True)
        for panel in panels[-1]:
            panel.set_xlabel("time [s]")
        yield panels
        handles, labels = panels[0, 0].get_legend_handles_labels()
        if mechanism:
            handles.append(Line2D([], [], **MECHANISM))
            labels.append("the same on the MuJoCo mechanism")
        figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
        raw = BytesIO()
        figure.savefig(raw, format="png", dpi=100)
    # median cut, which is the default, takes the mean of colours of few pixels: blue became teal
    picture = Image.open(raw).convert("RGB").quantize(PALETTE, method=Image.Quantize.FASTOCTREE)
    write_whole(path, lambda target: picture.save(target, format="PNG", optimize=True))


def _add(panels: NDArray[Any], shown: Mapping[str, Array], *, step: bool, **look: Any) -> None:
    for axis, (angle, acceleration) in enumerate((("φ [deg]", "φ″"), ("θ [deg]", "θ″"))):
        ball = shown["state"][:, 4 * axis]
        first = ball if step else shown["reference"][:, axis] - ball
        panels[0, axis].plot(shown["time"], 1000 * first, **look)
        panels[1, axis].plot(shown["time"], np.degrees(shown["state"][:, 4 * axis + 2]), **look)
        panels[2, axis].plot(shown["time"], shown["applied"][:, axis], **look)
        panels[1, axis].set_ylabel(angle)
        panels[2, axis].set_ylabel(f"{acceleration} [rad/s²]")


def _omega(name: str) -> str:
    return name.replace("omega ", "ω = ") + " rad/s" if name.startswith("omega") else name


def draw_all(folder: Path, table: SimulatedTable, found: Results) -> dict[str, str]:
    """Draw what belongs to a table: file name to what it shows.

    Raises:
        RecordError: If a file cannot be written.
    """
    slug = f"table-{table.id.replace('.', '-')}"
    if table.group == "observers":
        drawn = {}
        for index, row in enumerate(table.rows):
            name = f"{slug}-{row.name.lower().replace(' ', '-')}.png"
            draw_observer(folder / name, table, index, found)
            drawn[name] = f"States and efforts, {row.name}"
        return drawn
    draw_table(folder / f"{slug}.png", table, found)
    drawn = {f"{slug}.png": f"Table {table.id}: {table.title}"}
    if table.id == "8.5":
        draw_neglected(folder / "neglected.png", table, found)
        drawn["neglected.png"] = "Main and neglected terms"
    return drawn


PAGES = {
    "Full state feedback, Tables 8.1 to 8.5": ("8.1", "8.2", "8.3", "8.4", "8.5"),
    "Full state feedback, Tables 8.6 to 8.11": ("8.6", "8.7", "8.8", "8.9", "8.10", "8.11"),
    "Observers, Tables 8.12 and 8.13": ("8.12", "8.13"),
    "Tracking with EKF, Tables 8.14 to 8.17": ("8.14", "8.15", "8.16", "8.17"),
    "Tracking with EKF, Tables 8.18 to 8.21": ("8.18", "8.19", "8.20", "8.21"),
}


def write_doc(
    path: Path, tables: Sequence[SimulatedTable], cells: Sequence[ThesisCell], found: Results
) -> None:
    """Write the pages, and their figures into ``figures`` beside them.

    Raises:
        RecordError: If a file cannot be written.
    """
    groups = []
    for title, names in PAGES.items():
        parts = []
        for table in (each for each in tables if each.id in names):
            rows, notes = chapter8.lines(_of(table, cells))
            made = markdown(chapter8.CHAPTER8_HEADINGS, rows, words=(0, 1, -1))
            parts.append((table, made, notes, draw_all(path.parent / "figures", table, found)))
        if parts:
            page = f"{path.stem}-{names[0].replace('.', '-')}.md"
            groups.append((page, title, parts[0][0].shared, parts))
    text = filled(
        "reproduction",
        sentence=chapter8.sentence(cells),
        steps=chapter8.DEVIATION_STEPS_PERCENT,
        summary=[(table, chapter8.summary(_of(table, cells))) for table in tables],
        columns=THESIS_COLUMNS,
        groups=groups,
    )
    write(path, text)


def _of(table: SimulatedTable, cells: Sequence[ThesisCell]) -> list[ThesisCell]:
    """The cells of one table."""
    return [cell for cell in cells if cell.table == table.id]


def main() -> None:
    """Compute all tables and write the page."""
    wanted = list(tables().values())
    results = row_results(plan(wanted))
    found = {(one.place, one.way): one for one in results}
    write_doc(
        Path(__file__).parent / "reproduction.md", wanted, chapter8.compare(wanted, found), found
    )


if __name__ == "__main__":
    main()
