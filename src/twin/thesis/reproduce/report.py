"""The comparison as a person reads it: on the terminal, and as a document with figures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from rich.table import Table
from rich.text import Text

from twin import markdown
from twin.thesis.reproduce.compare import Agreement, Cell, Results, Value
from twin.thesis.reproduce.figures import draw_all
from twin.thesis.reproduce.measures import COLUMNS
from twin.thesis.reproduce.tables import SimulatedTable
from twin.writing import write_whole

HEADINGS = ("row", "quantity", "thesis", "exact", "sampled", "MuJoCo", "exact − thesis", "")
MARKS = {Agreement.AGREES: "", Agreement.EXCEPTION: "(!)", Agreement.DIFFERS: "!!"}
STEPS = (1.0, 2.0, 4.0, 5.0)
"""Deviations in % by which cells are counted."""
GROUPS = {
    "full_state": "Full state feedback, Tables 8.1 to 8.11",
    "observers": "Observers, Tables 8.12 and 8.13",
    "tracking": "Tracking with EKF, Tables 8.14 to 8.21",
}
INTRODUCTION = """\
# The thesis's simulation tables, computed anew

Written by `ballplate reproduce --doc docs/reproduction.md`. Every numeric cell of Tables 8.1 to
8.21 is laid beside three values:

- **exact**: the exact model (5.9) under continuous control. Full state feedback is integrated by
  a multistep method with relative tolerance 1e-9; with an observer, plant, observer (for the EKF
  with its Riccati differential equation), dead time and held noise are integrated together by RK4
  at 10 ms. Halving that step changes no indicator by more than 0.05 % (estimation errors: 0.1 %).
- **sampled**: the same plant under the controller that also drives a rig, at 2 ms through the
  seam. It is another implementation, discrete throughout, yet with the same noise it agrees with
  *exact* to 0.7 %, and to a quarter of that at 0.5 ms.
- **MuJoCo**: the same loop on the mechanism (cams, spring, cardan joint, rolling contact) without
  rolling friction and without sensor imperfections beyond those of the table.

*exact* and *sampled* must agree with the thesis: values without spread to 4 % (Tables 8.1 to
8.11) or 5 % (angles and efforts from Table 8.12 on), settling times within what was read by eye
from a figure, noisy errors within the 5 to 95 % range of 20 seeds. (!) marks a cell that does not
and whose reason is known, !! one without; no cell is left out. The mechanism's column is there to
see what a real transmission makes of it; it need not agree.
"""


def of_table(table: SimulatedTable, cells: Iterable[Cell]) -> list[Cell]:
    """The cells of one table."""
    return [cell for cell in cells if cell.table == table.id]


def shown(value: Value | None) -> str:
    """A computed value in the digits worth reading, with its range."""
    if value is None:
        return "-"
    if value.range is None or value.range[1] - value.range[0] < 1e-3 * value.value:
        return f"{value.value:.5g}"
    low, high = value.range
    return f"{value.value:.4g} ({low:.3g} to {high:.3g})"


def lines(table: SimulatedTable, cells: Sequence[Cell]) -> tuple[list[tuple[str, ...]], list[str]]:
    """A table's cells under ``HEADINGS``, each row named once, and the numbered notes."""
    numbers: dict[str, int] = {}
    found: list[tuple[str, ...]] = []
    last = ""
    for cell in of_table(table, cells):
        found.append(("" if cell.row == last else cell.row, *_line(cell, numbers)))
        last = cell.row
    return found, [f"[{number}] {note}" for note, number in numbers.items()]


def _line(cell: Cell, numbers: dict[str, int]) -> tuple[str, ...]:
    """A cell as a line of a table without its row's name; a new note is given the next number."""
    deviation = cell.deviation_percent
    note = ""
    if cell.note:
        note = f"[{numbers.setdefault(cell.note, len(numbers) + 1)}]"
    return (
        COLUMNS[cell.column].name,
        f"{cell.thesis:.5g}",
        shown(cell.exact),
        shown(cell.sampled),
        shown(cell.mujoco),
        "-" if deviation is None else f"{deviation:+.1f} %",
        f"{MARKS[cell.verdict]} {note}".strip(),
    )


def grid(table: SimulatedTable, cells: Sequence[Cell]) -> tuple[Table, list[str]]:
    """A table for the terminal, and its notes."""
    out = Table(*HEADINGS, title=f"Table {table.id}: {table.title}", header_style="bold")
    out.title_justify = "left"
    for column in out.columns[2:7]:
        column.justify = "right"
    rows, notes = lines(table, cells)
    for row in rows:
        out.add_row(*map(Text, row))
    return out, notes


def summary(cells: Sequence[Cell]) -> dict[str, Any]:
    """How many cells agree how well.

    Those with noise are judged by the range of the seeds; the worst is sought among the others
    that agree.
    """
    judged = [cell for cell in cells if cell.deviation_percent is not None]
    plain = [cell for cell in judged if COLUMNS[cell.column].judged == "value"]
    agreeing = [cell for cell in plain if cell.verdict is Agreement.AGREES]
    return {
        "cells": len(cells),
        "values": len(plain),
        "within": {
            step: sum(abs(cell.deviation_percent or 0) <= step for cell in plain) for step in STEPS
        },
        "worst": max(agreeing, key=lambda cell: abs(cell.deviation_percent or 0), default=None),
        **{kind.value: sum(cell.verdict is kind for cell in cells) for kind in Agreement},
    }


def sentence(cells: Sequence[Cell]) -> str:
    """The summary in one line."""
    found = summary(cells)
    within = ", ".join(f"{count} within {step:g} %" for step, count in found["within"].items())
    text = f"{found['cells']} cells: {found['agrees']} agree, {found['exception']} are exceptions"
    text += f" with a known reason, {found['differs']} differ. "
    text += f"Of {found['values']} values without spread {within}"
    worst: Cell | None = found["worst"]
    if worst is None:
        return f"{text}."
    where = f"Table {worst.table}, {worst.row}, {COLUMNS[worst.column].name}"
    return f"{text}; the worst that agrees: {worst.deviation_percent:+.2f} % ({where})."


def write_doc(
    path: Path, tables: Sequence[SimulatedTable], cells: Sequence[Cell], found: Results
) -> None:
    """Write the document, and its figures into ``figures`` beside it.

    Raises:
        RecordError: If a file cannot be written.
    """
    parts = [INTRODUCTION, "## Summary\n", sentence(cells) + "\n", *_summary(tables, cells)]
    group = ""
    for table in tables:
        if table.group != group:
            group = table.group
            parts += [f"## {GROUPS[group]}\n", *(f"- {remark}" for remark in table.shared), ""]
        parts += _table(table, cells)
        for name, title in draw_all(path.parent / "figures", table, found).items():
            parts.append(f"![{title}](figures/{name})\n")
    text = "\n".join(parts).rstrip() + "\n"
    write_whole(path, lambda target: target.write_text(text, encoding="utf-8"))


def _summary(tables: Sequence[SimulatedTable], cells: Sequence[Cell]) -> list[str]:
    """A line for every table: how many cells agree how well."""
    steps = [f"within {step:g} %" for step in STEPS]
    head = ("table", "cells", "agree", "exceptions", "differ", *steps, "worst that agrees")
    rows = []
    for table in tables:
        found = summary(of_table(table, cells))
        worst: Cell | None = found["worst"]
        within = [f"{count} of {found['values']}" for count in found["within"].values()]
        name = "" if worst is None else f"{_percent(worst)} ({worst.row}, {_quantity(worst)})"
        counts = [str(found[key]) for key in ("cells", *Agreement)]
        rows.append((f"{table.id} {table.title}", *counts, *within, name))
    remark = "The last five columns count values without spread only.\n"
    return [markdown.table(head, rows, words=(0, -1)), remark]


def _percent(cell: Cell) -> str:
    return f"{cell.deviation_percent:+.2f} %"


def _quantity(cell: Cell) -> str:
    return COLUMNS[cell.column].name


def _table(table: SimulatedTable, cells: Sequence[Cell]) -> list[str]:
    out = [f"### Table {table.id}: {table.title}\n"]
    out += [f"- {row.name}: {row.detail}" for row in table.rows if row.detail]
    out += [f"- {remark}" for remark in table.own]
    if out[1:]:
        out.append("")
    rows, notes = lines(table, cells)
    out.append(markdown.table(HEADINGS, rows, words=(0, 1, -1)))
    out += [f"{note}  " for note in notes]
    return [*out, ""]
