"""Reader of measurements in JSON: one object a row, one list a column, or one object a line.

Lines may also be as Python prints them.
"""

from __future__ import annotations

import ast
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from controllers.arrays import Array
from twin.base.errors import plural
from twin.base.foreign import decode_text
from twin.run.readers import MAX_DEPTH, MAX_MATRIX_COLUMNS, ForeignTable, numbers_of, split_matrix
from twin.run.record import check_size


def read_json(path: Path) -> ForeignTable:
    """The columns of a JSON file, fields within fields joined by a dot: ``ball.x``, ``state.0``.

    Raises:
        ValueError: If it is no JSON.
    """
    text = decode_text(path.read_bytes())
    notes: list[str] = []
    try:
        found = json.loads(text)
    except json.JSONDecodeError as error:
        found = list(_read_lines(text, error, notes))
    columns = dict(_columns("", found, 0))
    rows = max(map(len, columns.values()), default=0)
    check_size(rows, len(columns), len(columns), path.stat().st_size)
    return ForeignTable(columns, notes=tuple(notes))


def _read_lines(text: str, error: json.JSONDecodeError, notes: list[str]) -> Iterator[Any]:
    """The values of a text with one on each line; lines that are cut are left out.

    Args:
        text: All of it.
        error: Why it is not one value.
        notes: To which is added what is left out.

    Raises:
        ValueError: If more lines are broken than not.
    """
    good = bad = 0
    for line in filter(str.strip, text.splitlines()):
        try:
            yield _value(line)
            good += 1
        except ValueError:
            bad += 1
    if bad >= good:
        raise ValueError(str(error))
    if bad:
        notes.append(f"{plural(bad, 'line')} left out: not JSON")


def _value(line: str) -> Any:
    """The value of a line in JSON, or as Python prints it.

    Raises:
        ValueError: If it is neither.
    """
    try:
        return json.loads(line)
    except json.JSONDecodeError as error:
        try:
            return ast.literal_eval(line.strip())
        except (SyntaxError, TypeError, MemoryError, RecursionError):
            raise ValueError(str(error)) from None


def _columns(name: str, value: Any, depth: int) -> Iterator[tuple[str, Array | list[str]]]:
    """The columns of a value by their names."""
    if depth > MAX_DEPTH:
        return
    if isinstance(value, dict):
        if _is_split(value):
            yield from _rows(
                name, [dict(zip(value["columns"], row, strict=False)) for row in value["data"]]
            )
        elif value and all(key.isdigit() and _is_scalar(each) for key, each in value.items()):
            yield from _columns(name, list(value.values()), depth)
        else:
            for key, each in value.items():
                yield from _columns(f"{name}.{key}" if name else key, each, depth + 1)
    elif isinstance(value, list) and len(value) > 1:
        if all(isinstance(each, dict) for each in value):
            yield from _rows(name, value)
        elif all(map(_is_scalar, value)):
            yield name or "1", numbers_of(np.array(value, dtype=object))
        elif all(isinstance(each, list) for each in value) and len(set(map(len, value))) == 1:
            yield from split_matrix(name, np.array(value, dtype=object))


def _rows(name: str, rows: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, Array | list[str]]]:
    """The columns of rows of named values, empty where a row has no such value."""
    flat = [dict(_scalars(name, row, 0)) for row in rows]
    for key in dict.fromkeys(key for row in flat for key in row):
        yield key, numbers_of(np.array([row.get(key) for row in flat], dtype=object))


def _scalars(name: str, value: Any, depth: int) -> Iterator[tuple[str, Any]]:
    """The numbers and texts within a value by their names."""
    inner: Mapping[Any, Any] = {}
    if isinstance(value, dict):
        inner = value
    elif isinstance(value, list) and len(value) <= MAX_MATRIX_COLUMNS:
        inner = dict(enumerate(value))
    elif _is_scalar(value):
        yield name or "1", value
    if depth <= MAX_DEPTH:
        for key, each in inner.items():
            yield from _scalars(f"{name}.{key}" if name else str(key), each, depth + 1)


def _is_scalar(value: Any) -> bool:
    return value is None or isinstance(value, int | float | str)


def _is_split(value: Mapping[str, Any]) -> bool:
    """Whether an object has the names of its columns apart from its rows, as pandas may write."""
    names, rows = value.get("columns"), value.get("data")
    return (
        isinstance(names, list)
        and isinstance(rows, list)
        and all(isinstance(each, str) for each in names)
        and all(isinstance(each, list) for each in rows)
    )
