"""Tables 8.1 to 8.21, which the thesis simulated: every cell next to the thesis's, with a verdict.

*sampled* is a run on the equations (5.9), *mujoco* one on the mechanism without rolling friction,
both at 2 ms through the seam. *exact* is the same under continuous control, integrated once by
commit eda4a26 and kept as data: full state feedback by LSODA at a relative tolerance of 1e-9;
plant, observer in continuous time, dead time and held noise together by RK4 at 10 ms.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np

from twin.base.errors import plural
from twin.thesis.chapter8_runs import COMPUTED_WAYS, Results
from twin.thesis.chapter8_tables import REASON_WORDS, Reason, SimulatedTable
from twin.thesis.columns import THESIS_COLUMNS, read_stored

WORTH_A_NOTE = 1.0
"""Deviation in % from which a cause of inexact values is named."""


class Agreement(StrEnum):
    """Whether a cell agrees with the thesis.

    AGREES: within its bound. EXCEPTION: not, and it is noted among those that do not, with its
    ``Reason`` or with none. DIFFERS: not, and it is not noted.
    """

    AGREES = "agrees"
    EXCEPTION = "exception"
    DIFFERS = "differs"


class Value(NamedTuple):
    """A computed cell: its value, and the range of the seeds or of the reading, if there is one."""

    value: float
    range: tuple[float, float] | None = None

    def deviation(self, thesis: float) -> float | None:
        """Percent from the thesis's value; None where that is 0."""
        return 100 * (self.value / thesis - 1) if thesis else None


@dataclass(frozen=True, kw_only=True)
class ThesisCell:
    """A numeric cell of the thesis and its value here.

    Attributes:
        table: The table's number.
        row: The row's name.
        column: The column's key in ``THESIS_COLUMNS``.
        thesis: The thesis's value.
        exact: Equations (5.9), continuous control, as kept.
        sampled: Equations (5.9), sampled loop through the seam; None if it ended early.
        mujoco: The mechanism without rolling friction, through the seam; None if it ended early.
        note: What is known of the cell.
        verdict: Whether exact and sampled value agree with the thesis's.
        because: What kind of reason an exception has; None for other cells.
    """

    table: str
    row: str
    column: str
    thesis: float
    exact: Value
    sampled: Value | None
    mujoco: Value | None
    note: str
    verdict: Agreement
    because: Reason | None = None

    @property
    def mark(self) -> str:
        """Of a cell that does not agree: (!) with a reason, !! without."""
        if self.verdict is Agreement.AGREES:
            return ""
        return "!!" if self.because in {None, Reason.UNEXPLAINED} else "(!)"

    @property
    def deviation_percent(self) -> float | None:
        """Deviation of the exact value from the thesis's in %."""
        return self.exact.deviation(self.thesis)

    def as_dict(self) -> dict[str, Any]:
        """The ``--json`` form of a cell."""
        found: dict[str, Any] = {
            "table": self.table,
            "row": self.row,
            "column": THESIS_COLUMNS[self.column].name,
            "thesis": self.thesis,
            "deviation_percent": self.deviation_percent,
            "note": self.note,
            "verdict": self.verdict.value,
            "because": self.because and self.because.value,
        }
        for way in COMPUTED_WAYS:
            value: Value | None = getattr(self, way)
            found[way] = value and value.value
            if value and value.range:
                found[f"{way}_range"] = list(value.range)
        return found


def compare(wanted: Iterable[SimulatedTable], found: Results) -> list[ThesisCell]:
    """Every cell of the tables."""
    return [
        _cell(table, index, column, found)
        for table in wanted
        for index, row in enumerate(table.rows)
        for column in row.cells
    ]


def _cell(table: SimulatedTable, index: int, column: str, found: Results) -> ThesisCell:
    row = table.rows[index]
    thesis, known = row.cells[column], read_stored("chapter_8")[table.id][row.name]
    exact, *span = known[column]
    mine = {way: found[(table.id, index), way] for way in COMPUTED_WAYS[1:]}
    values = {way: _value(result.values[column], column) for way, result in mine.items()}
    of_exact = Value(exact, (span[0], span[1]) if span else None)
    agrees = all(_agrees(v, thesis, column, table.bound) for v in (of_exact, values["sampled"]))
    known_not_to = row.exceptions.get(column)
    remarks = [row.notes.get(column), known_not_to and known_not_to.note]
    deviation = of_exact.deviation(thesis)
    if deviation is not None and abs(deviation) > WORTH_A_NOTE and not known_not_to:
        remarks.append(row.causes.get(column))
    if not agrees and THESIS_COLUMNS[column].compared == "noise":
        remarks.append("Outside the 5 to 95 % range.")
    if column == "e_tt":
        remarks.append(known["fitted"])
    remarks += [f"{way}: {result.ended}." for way, result in mine.items() if result.ended]
    differs = Agreement.EXCEPTION if known_not_to else Agreement.DIFFERS
    return ThesisCell(
        table=table.id,
        row=row.name,
        column=column,
        thesis=thesis,
        exact=of_exact,
        **values,
        note=" ".join(filter(None, remarks)),
        verdict=Agreement.AGREES if agrees else differs,
        because=known_not_to.because if known_not_to and not agrees else None,
    )


def _value(values: list[float], column: str) -> Value | None:
    """One value of all runs of a row."""
    if not values:
        return None
    if THESIS_COLUMNS[column].compared == "reading":
        return Value(values[0], (min(values), max(values)))
    if len(values) == 1:
        return Value(values[0])
    low, middle, high = np.quantile(values, (0.05, 0.5, 0.95)).tolist()
    return Value(middle, (low, high))


def _agrees(value: Value | None, thesis: float, column: str, bound: float) -> bool:
    if value is None:
        return False
    kind = THESIS_COLUMNS[column]
    if kind.compared != "value" and value.range is not None:
        low, high = value.range
        if low <= thesis <= high:
            return True
        if kind.compared == "reading":
            return False
    deviation = value.deviation(thesis)
    return value.value <= kind.zero if deviation is None else abs(deviation) <= bound


CHAPTER8_HEADINGS = (
    "row",
    "quantity",
    "thesis",
    "exact",
    "sampled",
    "MuJoCo",
    "exact − thesis",
    "",
)
DEVIATION_STEPS_PERCENT = (1.0, 2.0, 4.0, 5.0)
"""Deviations in % by which cells are counted."""


def format_computed(value: Value | None) -> str:
    """A computed value in the digits worth reading, with its range."""
    if value is None:
        return "-"
    if value.range is None or value.range[1] - value.range[0] < 1e-3 * value.value:
        return f"{value.value:.5g}"
    low, high = value.range
    return f"{value.value:.4g} ({low:.3g} to {high:.3g})"


def lines(cells: Iterable[ThesisCell]) -> tuple[list[tuple[str, ...]], list[str]]:
    """A table's cells under ``HEADINGS``, each row named once, and the numbered notes.

    Notes that differ only in the value of a fitted reading are one note, with the values in the
    order of the cells.
    """
    notes: dict[str, list[str]] = {}
    found: list[tuple[str, ...]] = []
    last = ""
    for cell in cells:
        off = cell.deviation_percent
        mark = cell.mark
        if cell.note:
            text, *values = split_note(cell.note)
            notes.setdefault(text, []).extend(values)
            mark = f"{mark} [{list(notes).index(text) + 1}]"
        found.append(
            (
                "" if cell.row == last else cell.row,
                THESIS_COLUMNS[cell.column].name,
                f"{cell.thesis:.5g}",
                *(format_computed(getattr(cell, way)) for way in COMPUTED_WAYS),
                "-" if off is None else f"{off:+.1f} %",
                mark.strip(),
            )
        )
        last = cell.row
    numbered = enumerate(notes.items(), start=1)
    return found, [f"[{number}] {join_note(text, values)}" for number, (text, values) in numbered]


def split_note(note: str) -> list[str]:
    """The text of a note and, if it ends with the value of a fitted reading, that value."""
    found = re.fullmatch(r"(.*Exact with [^:]*): ([^ ]+(?: \([^)]*\))?)\.", note)
    return [found[1], found[2]] if found else [note]


def join_note(text: str, values: Sequence[str]) -> str:
    """A note with its values."""
    return f"{text}: {', '.join(values)}." if values else text


def summary(cells: Sequence[ThesisCell]) -> dict[str, Any]:
    """How many cells agree how well.

    Cells with noise are evaluated by the range of the seeds; the worst is sought among the others
    that agree.
    """
    plain = [
        (abs(cell.deviation_percent), cell)
        for cell in cells
        if cell.deviation_percent is not None and THESIS_COLUMNS[cell.column].compared == "value"
    ]
    agreeing = [each for each in plain if each[1].verdict is Agreement.AGREES]
    worst = max(agreeing, key=lambda each: each[0], default=None)
    return {
        "cells": len(cells),
        "values": len(plain),
        "within": {step: sum(off <= step for off, _ in plain) for step in DEVIATION_STEPS_PERCENT},
        "worst": worst and worst[1],
        **{kind.value: sum(cell.verdict is kind for cell in cells) for kind in Agreement},
        "disagree": sum(cell.verdict is not Agreement.AGREES for cell in cells),
        "because": {kind.value: sum(cell.because is kind for cell in cells) for kind in Reason},
    }


def sentence(cells: Sequence[ThesisCell]) -> str:
    """The summary in one line."""
    found = summary(cells)
    within = ", ".join(f"{count} within {step:g} %" for step, count in found["within"].items())
    why = [f"{found['because'][kind]} {words}" for kind, words in REASON_WORDS.items()]
    why = [each for each in why if not each.startswith("0 ")]
    if found["differs"]:
        why.insert(0, f"{found['differs']} new, not noted so far")
    text = f"{plural(found['cells'], 'cell')}: {found['agrees']} agree, {found['disagree']} do not"
    text += f" ({', '.join(why)}). " if why else ". "
    text += f"Of {plural(found['values'], 'value')} without spread {within}"
    worst: ThesisCell | None = found["worst"]
    if worst is None:
        return f"{text}."
    where = f"Table {worst.table}, {worst.row}, {THESIS_COLUMNS[worst.column].name}"
    return f"{text}; the worst that agrees: {worst.deviation_percent:+.2f} % ({where})."
