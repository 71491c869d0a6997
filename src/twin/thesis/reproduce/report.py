"""The comparison as a person reads it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from rich.table import Table
from rich.text import Text

from twin.thesis.reproduce.compare import Agreement, Cell, Value
from twin.thesis.reproduce.measures import COLUMNS
from twin.thesis.reproduce.tables import SimulatedTable

HEADINGS = ("row", "quantity", "thesis", "exact", "sampled", "MuJoCo", "exact − thesis", "")
MARKS = {Agreement.AGREES: "", Agreement.EXCEPTION: "(!)", Agreement.DIFFERS: "!!"}
STEPS = (1.0, 2.0, 4.0, 5.0)
"""Deviations in % by which cells are counted."""


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
