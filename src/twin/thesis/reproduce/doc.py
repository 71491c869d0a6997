"""The comparison as a document: summary, every table side by side, and figures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from twin.run.record import write_whole
from twin.thesis.reproduce.compare import Cell, Findings, Verdict
from twin.thesis.reproduce.figures import draw_all
from twin.thesis.reproduce.measures import COLUMNS
from twin.thesis.reproduce.report import HEADINGS, STEPS, line, of_table, sentence, summary
from twin.thesis.reproduce.tables import Table

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


def write_doc(path: Path, tables: Sequence[Table], cells: Sequence[Cell], found: Findings) -> None:
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


def _summary(tables: Sequence[Table], cells: Sequence[Cell]) -> list[str]:
    """A line for every table: how many cells agree how well."""
    steps = [f"within {step:g} %" for step in STEPS]
    head = ("table", "cells", "agree", "exceptions", "differ", *steps, "worst that agrees")
    out = ["| " + " | ".join(head) + " |", "|---" + "|--:" * (len(head) - 2) + "|---|"]
    for table in tables:
        found = summary(of_table(table, cells))
        worst: Cell | None = found["worst"]
        within = [f"{count} of {found['values']}" for count in found["within"].values()]
        name = "" if worst is None else f"{_percent(worst)} ({worst.row}, {_quantity(worst)})"
        counts = [str(found[key]) for key in ("cells", *Verdict)]
        out.append("| " + " | ".join((f"{table.id} {table.title}", *counts, *within, name)) + " |")
    return [*out, "", "The last five columns count values without spread only.", ""]


def _percent(cell: Cell) -> str:
    return f"{cell.deviation_percent:+.2f} %"


def _quantity(cell: Cell) -> str:
    return COLUMNS[cell.column].name


def _table(table: Table, cells: Sequence[Cell]) -> list[str]:
    out = [f"### Table {table.id}: {table.title}\n"]
    out += [f"- {row.name}: {row.detail}" for row in table.rows if row.detail]
    out += [f"- {remark}" for remark in table.own]
    if out[1:]:
        out.append("")
    out.append("| " + " | ".join(HEADINGS) + " |")
    out.append("|---|---" + "|--:" * (len(HEADINGS) - 3) + "|---|")
    numbers: dict[str, int] = {}
    last = ""
    for cell in of_table(table, cells):
        name, *rest = line(cell, numbers)
        out.append("| " + " | ".join(("" if name == last else name, *rest)) + " |")
        last = name
    out.append("")
    out += [f"[{number}] {note}  " for note, number in numbers.items()]
    return [*out, ""]
