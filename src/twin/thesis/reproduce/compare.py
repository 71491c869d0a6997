"""The thesis's cells beside what was computed on all processors, and whether they agree."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np
from rich.table import Table
from rich.text import Text

from twin.errors import TwinError
from twin.jobs import cores, results
from twin.thesis.reproduce.cases import (
    COLUMNS,
    SimulatedRow,
    SimulatedTable,
    SimulationCase,
    SimulationTrace,
    judge,
    tables,
)
from twin.thesis.reproduce.simulated import exact, sampled

WAYS = ("exact", "sampled", "mujoco")
WORTH_A_NOTE = 1.0
"""Deviation in % from which a cause of inexact values is named."""


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


WORTH_PROCESSES = 1000.0
"""Simulated seconds from which starting further processes saves time."""
MOST_PROCESSES = 8
FIGURE_STEP = 0.02
"""Seconds between the points that figures are drawn through."""

RowId = tuple[str, int]
"""Number of the table and index of the row."""


@dataclass(frozen=True)
class ReproductionJob:
    """Rows that are simulated as one batch.

    Attributes:
        way: "exact", "sampled" or "mujoco", the columns of the comparison, or "fitted": the exact
            model with the settings that fit a table better than its text's.
        places: The rows.
        cost: Simulated seconds of all its runs together.
    """

    way: str
    places: tuple[RowId, ...]
    cost: float


@dataclass(frozen=True, kw_only=True)
class RowResult:
    """What one simulation of a row gave.

    Attributes:
        place: Number of the table and index of the row.
        way: How it was simulated.
        values: Column to the values of all runs.
        ended: Why a run ended early, in words; empty if all lasted.
        excerpt: The first run, for a figure.
    """

    place: RowId
    way: str
    values: dict[str, list[float]]
    ended: str
    excerpt: SimulationTrace


Results = Mapping[tuple[RowId, str], RowResult]


def plan(wanted: Iterable[SimulatedTable]) -> list[ReproductionJob]:
    """The jobs that tables need, the longest first.

    Rows that differ in law and reference only are put together, which is faster than one by one
    and changes nothing: every case has the same noise.
    """
    batches: dict[Any, list[RowId]] = defaultdict(list)
    for table in wanted:
        ways = ("exact", "sampled", "mujoco", *(("fitted",) if table.fitted else ()))
        for index in range(len(table.rows)):
            for way in ways:
                place = (table.id, index)
                batches[way, _batch(place, way)].append(place)
    jobs = [
        ReproductionJob(way, tuple(places), _cost(places, way))
        for (way, _), places in batches.items()
    ]
    return sorted(jobs, key=lambda job: -job.cost)


def row_results(
    jobs: Sequence[ReproductionJob],
    processes: int | None = None,
    progress: Callable[[float], None] = print,
) -> Iterator[RowResult]:
    """The results of all jobs' rows, as they come.

    Args:
        jobs: What to do, the longest first.
        processes: On how many processors; None for all, or for one if there is little to do.
        progress: Called with the cost of what is done so far.

    Raises:
        TwinError: If a job fails.
    """
    total = sum(job.cost for job in jobs)
    if processes is None:
        few = total < WORTH_PROCESSES
        processes = 1 if few else min(cores(), MOST_PROCESSES, len(jobs))
    done = 0.0
    for index, found in results(_tried, enumerate(jobs), processes):
        done += jobs[index].cost
        progress(done)
        yield from found


def _tried(job: ReproductionJob) -> list[RowResult]:
    """The job's results, or one line that says which job failed."""
    try:
        return carry_out(job)
    except TwinError:
        raise
    except Exception as error:
        where = ", ".join(sorted({table for table, _ in job.places}))
        raise TwinError(f"table {where}, {job.way}: {type(error).__name__}: {error}") from error


def carry_out(job: ReproductionJob) -> list[RowResult]:
    """Simulate the rows of a job."""
    cases = [_case(place, job.way) for place in job.places]
    if job.way in ("exact", "fitted"):
        traces = exact(cases)
    else:
        traces = sampled(cases, mechanism=job.way == "mujoco")
    return [
        RowResult(
            place=place,
            way=job.way,
            values=judge(trace, case, tables()[place[0]].columns),
            ended=trace.ended,
            excerpt=trace.excerpt(FIGURE_STEP),
        )
        for place, case, trace in zip(job.places, cases, traces, strict=True)
    ]


def _case(place: RowId, way: str) -> SimulationCase:
    table = tables()[place[0]]
    case = SimulationCase(**table.rows[place[1]].setup)
    if way != "fitted":
        return case
    assert table.fitted is not None
    return replace(case, **{key: value for key, value in table.fitted.items() if key != "label"})


def _batch(place: RowId, way: str) -> object:
    """What rows of one batch have in common."""
    case = _case(place, way)
    if case.observer is None:
        return (place[0] if way == "exact" else "", case.duration)
    return repr(replace(case, controller={}, reference={}, steady_from=0.0))


def _cost(places: Iterable[RowId], way: str) -> float:
    """Simulated seconds of all runs together."""
    return sum(case.duration * case.seeds for case in (_case(place, way) for place in places))


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
