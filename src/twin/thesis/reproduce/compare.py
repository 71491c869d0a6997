"""The thesis's cells beside what was computed, and whether they agree."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from twin.thesis.reproduce.jobs import RowId, RowResult
from twin.thesis.reproduce.measures import COLUMNS
from twin.thesis.reproduce.tables import SimulatedRow, SimulatedTable

WAYS = ("exact", "sampled", "mujoco")
WORTH_A_NOTE = 1.0
"""Deviation in % from which a cause of inexact values is named."""

Results = Mapping[tuple[RowId, str], RowResult]


class Agreement(StrEnum):
    """Whether a cell agrees with the thesis.

    AGREES: within its bound. EXCEPTION: not, for a reason that is known and noted. DIFFERS: not.
    """

    AGREES = "agrees"
    EXCEPTION = "exception"
    DIFFERS = "differs"


@dataclass(frozen=True)
class Value:
    """A computed cell: its value, and the range of the seeds or of the reading, if there is one."""

    value: float
    range: tuple[float, float] | None = None

    def deviation(self, thesis: float) -> float | None:
        """Percent from the thesis's value; None where that is 0."""
        return 100 * (self.value / thesis - 1) if thesis else None


@dataclass(frozen=True, kw_only=True)
class Cell:
    """A numeric cell of the thesis and what it came to here.

    Attributes:
        table: The table's number.
        row: The row's name.
        column: The column's key in ``COLUMNS``.
        thesis: The thesis's value.
        exact: Exact model, continuous control; None if it ended early.
        sampled: Exact model, sampled loop through the seam; None if it ended early.
        mujoco: The mechanism without rolling friction, through the seam; None if it ended early.
        note: What is known of the cell.
        verdict: Whether exact and sampled value agree with the thesis's.
    """

    table: str
    row: str
    column: str
    thesis: float
    exact: Value | None
    sampled: Value | None
    mujoco: Value | None
    note: str
    verdict: Agreement

    @property
    def deviation_percent(self) -> float | None:
        """Deviation of the exact value from the thesis's in %."""
        return self.exact.deviation(self.thesis) if self.exact else None

    def as_dict(self) -> dict[str, Any]:
        """What ``--json`` prints of a cell."""
        values = {way: getattr(self, way) for way in WAYS}
        ranges = {
            f"{way}_range": list(value.range)
            for way, value in values.items()
            if value is not None and value.range is not None
        }
        return {
            "table": self.table,
            "row": self.row,
            "column": COLUMNS[self.column].name,
            "thesis": self.thesis,
            **{way: None if value is None else value.value for way, value in values.items()},
            "deviation_percent": self.deviation_percent,
            "note": self.note,
            "verdict": self.verdict.value,
            **ranges,
        }


def compare(wanted: Iterable[SimulatedTable], found: Results) -> list[Cell]:
    """Every cell of the tables."""
    return [
        _cell(table, index, row, column, found)
        for table in wanted
        for index, row in enumerate(table.rows)
        for column in row.cells
    ]


def _cell(
    table: SimulatedTable, index: int, row: SimulatedRow, column: str, found: Results
) -> Cell:
    thesis = row.cells[column]
    mine = {way: found[(table.id, index), way] for way in WAYS}
    values = {way: _value(finding.values[column], column) for way, finding in mine.items()}
    agrees = all(_agrees(values[way], thesis, column, table.bound) for way in WAYS[:2])
    excused = column in row.exceptions
    remarks = [row.notes.get(column), row.exceptions.get(column)]
    exact = values["exact"]
    deviation = exact.deviation(thesis) if exact else None
    if deviation is not None and abs(deviation) > WORTH_A_NOTE and not excused:
        remarks.append(row.causes.get(column))
    if not agrees and COLUMNS[column].judged == "noise":
        remarks.append("The thesis's value is outside the 5 to 95 % range of the seeds.")
    if table.fitted and column == "e_tt":
        remarks.append(_fitted(table, found[(table.id, index), "fitted"].values[column]))
    remarks += [f"{way}: {finding.ended}." for way, finding in mine.items() if finding.ended]
    return Cell(
        table=table.id,
        row=row.name,
        column=column,
        thesis=thesis,
        **values,
        note=" ".join(filter(None, remarks)),
        verdict=Agreement.AGREES
        if agrees
        else Agreement.EXCEPTION
        if excused
        else Agreement.DIFFERS,
    )


def _fitted(table: SimulatedTable, values: list[float]) -> str:
    assert table.fitted is not None
    low, middle, high = np.quantile(values, (0.05, 0.5, 0.95))
    return f"Exact with {table.fitted['label']}: {middle:.4g} ({low:.4g} to {high:.4g})."


def _value(values: list[float], column: str) -> Value | None:
    """One value of all runs of a row."""
    if not values:
        return None
    if COLUMNS[column].judged == "reading":
        return Value(values[0], (min(values), max(values)))
    if len(values) == 1:
        return Value(values[0])
    low, middle, high = np.quantile(values, (0.05, 0.5, 0.95)).tolist()
    return Value(middle, (low, high))


def _agrees(value: Value | None, thesis: float, column: str, bound: float) -> bool:
    if value is None:
        return False
    kind = COLUMNS[column]
    if kind.judged != "value" and value.range is not None:
        low, high = value.range
        if low <= thesis <= high:
            return True
        if kind.judged == "reading":
            return False
    deviation = value.deviation(thesis)
    return value.value <= kind.zero if deviation is None else abs(deviation) <= bound
