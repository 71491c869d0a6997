"""Reader of the text files that Octave's ``save`` writes by default."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array
from twin.base.foreign import decode_text
from twin.run.readers import MAX_DEPTH, ForeignTable, split_matrix
from twin.run.record import MOST_ROWS, check_size

_FACT = re.compile(r"# (\w+): ?(.*)")
"""A line with a property of a variable."""
_RANGES = ("range", "double_range")
"""Types of a vector that is stated by its first and last number and its step."""


class _Lines:
    """Lines of a text that are taken one by one."""

    def __init__(self, text: str) -> None:
        self._lines = [line for line in text.splitlines() if line.strip()]
        self._at = 0

    def find_name(self) -> str | None:
        """The name of the next variable; None behind the last one."""
        while self._at < len(self._lines):
            found = _FACT.match(self._lines[self._at])
            self._at += 1
            if found and found[1] == "name":
                return found[2].strip()
        return None

    def take_fact(self, key: str) -> str | None:
        """The value of a property; None, and none is taken, where numbers or a name come first."""
        for at in range(self._at, len(self._lines)):
            found = _FACT.match(self._lines[at])
            if found is None or found[1] == "name":
                return None
            if found[1] == key:
                self._at = at + 1
                return found[2].strip()
        return None

    def take_numbers(self) -> list[list[str]]:
        """The cells of the lines up to the next property."""
        taken = list[list[str]]()
        while self._at < len(self._lines) and not _FACT.match(self._lines[self._at]):
            if not self._lines[self._at].startswith("#"):
                taken.append(self._lines[self._at].split())
            self._at += 1
        return taken


def read_octave(path: Path) -> ForeignTable:
    """The columns of a text file of Octave: matrices, ranges, and the fields of structures.

    Raises:
        ValueError: If a matrix has other numbers of rows or columns than it states.
    """
    lines = _Lines(decode_text(path.read_bytes()))
    columns: dict[str, Array | list[str]] = {}
    notes: list[str] = []
    while (name := lines.find_name()) is not None:
        for own, values in _read_variable(lines, name, 0, notes):
            columns |= dict(split_matrix(own, values))
    check_size(max(map(len, columns.values()), default=0), len(columns), 1, path.stat().st_size)
    return ForeignTable(columns, notes=tuple(notes))


def _read_variable(
    lines: _Lines, name: str, depth: int, notes: list[str]
) -> Iterator[tuple[str, NDArray[Any]]]:
    """The arrays of a variable by their names.

    Args:
        lines: Behind the line with its name.
        name: The name.
        depth: Of structures around it.
        notes: Receives what is left out.

    Raises:
        ValueError: If it is incomplete, or states too many numbers.
    """
    kind = lines.take_fact("type") or ""
    if kind == "scalar struct" and depth <= MAX_DEPTH:
        lines.take_fact("ndims")
        lines.take_numbers()
        for _ in range(int(lines.take_fact("length") or 0)):
            if (field := lines.find_name()) is not None:
                yield from _read_variable(lines, f"{name}.{field}", depth + 1, notes)
    elif kind in _RANGES:
        base, limit, step = map(float, lines.take_numbers()[-1][:3])
        if not step:
            raise ValueError(f"{name}: a range with no step")
        count = round((limit - base) / step) + 1
        if count > MOST_ROWS:
            raise ValueError(f"{name}: has {count} numbers, at most {MOST_ROWS} are read")
        yield name, base + step * np.arange(count)
    elif kind.endswith("matrix") and "complex" not in kind:
        yield name, _read_matrix(lines, name)
    elif kind not in ("scalar", "bool", "string"):
        notes.append(f"{name}: left out: {kind}")


def _read_matrix(lines: _Lines, name: str) -> NDArray[Any]:
    """A matrix, by rows, or with its size before its numbers column by column.

    Raises:
        ValueError: If it is incomplete.
    """
    rows = lines.take_fact("rows")
    if rows is not None:
        shape = int(rows), int(lines.take_fact("columns") or 0)
        cells, by_rows = lines.take_numbers(), True
    else:
        lines.take_fact("ndims")
        size, *cells = lines.take_numbers()
        shape = int(size[0]), int(size[1]) if len(size) == 2 else 0
        by_rows = False
    values = np.array([np.nan if cell == "NA" else float(cell) for row in cells for cell in row])
    if values.size != shape[0] * shape[1]:
        raise ValueError(f"{name}: has {values.size} numbers, states {shape[0]} x {shape[1]}")
    return values.reshape(shape, order="C" if by_rows else "F")
