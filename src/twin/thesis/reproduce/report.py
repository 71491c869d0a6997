"""The comparison in words and figures that a person or a program reads."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from rich.table import Table as Grid
from rich.text import Text

from twin.thesis.reproduce.compare import Cell, Value, Verdict
from twin.thesis.reproduce.measures import COLUMNS
from twin.thesis.reproduce.tables import Table

HEADINGS = ("row", "quantity", "thesis", "exact", "sampled", "MuJoCo", "exact − thesis", "")
MARKS = {Verdict.AGREES: "", Verdict.EXCEPTION: "(!)", Verdict.DIFFERS: "!!"}
STEPS = (1.0, 2.0, 4.0, 5.0)
"""Deviations in % by which cells are counted."""


def of_table(table: Table, cells: Iterable[Cell]) -> list[Cell]:
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


def line(cell: Cell, numbers: dict[str, int]) -> tuple[str, ...]:
    """A cell as a line of a table; a new note is given the next number."""
    deviation = cell.deviation_percent
    note = ""
    if cell.note:
        note = f"[{numbers.setdefault(cell.note, len(numbers) + 1)}]"
    return (
        cell.row,
        COLUMNS[cell.column].name,
        f"{cell.thesis:.5g}",
        shown(cell.exact),
        shown(cell.sampled),
        shown(cell.mujoco),
        "-" if deviation is None else f"{deviation:+.1f} %",
        f"{MARKS[cell.verdict]} {note}".strip(),
    )


def grid(table: Table, cells: Sequence[Cell]) -> tuple[Grid, list[str]]:
    """A table for the terminal, and its notes."""
    out = Grid(*HEADINGS, title=f"Table {table.id}: {table.title}", header_style="bold")
    out.title_justify = "left"
    for column in out.columns[2:7]:
        column.justify = "right"
    numbers: dict[str, int] = {}
    last = ""
    for cell in of_table(table, cells):
        name, *rest = line(cell, numbers)
        out.add_row(*(Text(part) for part in ("" if name == last else name, *rest)))
        last = name
    return out, [f"[{number}] {note}" for note, number in numbers.items()]


def summary(cells: Sequence[Cell]) -> dict[str, Any]:
    """How many cells agree how well.

    Those with noise are judged by the range of the seeds; the worst is sought among the others
    that agree.
    """
    judged = [cell for cell in cells if _deviation(cell) is not None]
    plain = [cell for cell in judged if COLUMNS[cell.column].judged == "value"]
    agreeing = [cell for cell in plain if cell.verdict is Verdict.AGREES]
    return {
        "cells": len(cells),
        "values": len(plain),
        "within": {
            step: sum(abs(_deviation(cell) or 0) <= step for cell in plain) for step in STEPS
        },
        "worst": max(agreeing, key=lambda cell: abs(_deviation(cell) or 0), default=None),
        **{verdict.value: sum(cell.verdict is verdict for cell in cells) for verdict in Verdict},
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
    return f"{text}; the worst that agrees: {_deviation(worst):+.2f} % ({where})."


def _deviation(cell: Cell) -> float | None:
    return cell.deviation_percent
