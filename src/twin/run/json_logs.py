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


LABEL_FIELDS = frozenset({"topic", "signal", "channel", "name", "metric", "sensor"})
"""Fields of a row that say what its value is of, in small letters."""
VALUE_FIELDS = frozenset({"data", "payload", "value", "message", "msg", "fields"})
"""Fields of a row with that value, in small letters."""
MIN_INDEXED_ROWS = 10
"""Least number of rows of objects with one index: fewer are no log."""
MAX_LABELS = 50
"""Largest number of labels for which each has columns of its own."""


def _columns(name: str, value: Any, depth: int) -> Iterator[tuple[str, Array | list[str]]]:
    """The columns of a value by their names."""
    if depth > MAX_DEPTH:
        return
    if isinstance(value, dict):
        if _is_split(value):
            yield from _index(value.get("index"))
            yield from _rows(
                name, [dict(zip(value["columns"], row, strict=False)) for row in value["data"]]
            )
        elif (rows := _rows_by_index(value)) is not None:
            yield from _index(list(rows))
            yield from _rows(name, list(rows.values()))
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
    flat = _by_label([dict(_scalars("", row, 0)) for row in rows])
    for key in dict.fromkeys(key for row in flat for key in row):
        yield (
            f"{name}.{key}" if name else key,
            numbers_of(np.array([row.get(key) for row in flat], dtype=object)),
        )


def _by_label(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows whose values are of what another field states, as ``topic``, with its name before them.

    Those of others, and of one label alone, stay as they are.
    """
    fields = dict.fromkeys(key for row in rows for key in row)
    label = next((key for key in fields if key.casefold() in LABEL_FIELDS), "")
    labels = {row.get(label) for row in rows}
    if not 2 <= len(labels) <= MAX_LABELS or not all(isinstance(each, str) for each in labels):
        return rows
    inner = {
        key: rest
        for key, (head, _, rest) in ((key, key.partition(".")) for key in fields)
        if head.casefold() in VALUE_FIELDS
    }
    if not inner:
        return rows

    def named(row: dict[str, Any], key: str) -> str:
        return "/".join(filter(None, (row[label], inner[key]))) if key in inner else key

    return [{named(row, key): each for key, each in row.items() if key != label} for row in rows]


def _index(values: Any) -> Iterator[tuple[str, Array | list[str]]]:
    """The column of an index of pandas; none of one that only counts rows from 0."""
    if not isinstance(values, list) or len(values) < 2 or not all(map(_is_scalar, values)):
        return
    cells = [str(each) for each in values]
    if cells == [str(k) for k in range(len(values))]:
        return
    yield "index", numbers_of(np.array(values, dtype=object))


def _rows_by_index(value: Mapping[str, Any]) -> dict[str, dict[str, Any]] | None:
    """The rows of an object of columns, each an object by one index, or the other way round."""
    inner = list(value.values())
    if len(inner) < 2 or not all(isinstance(each, dict) and each for each in inner):
        return None
    keys = list(inner[0])
    if max(len(keys), len(inner)) < MIN_INDEXED_ROWS or not all(
        list(each) == keys and all(map(_is_scalar, each.values())) for each in inner
    ):
        return None
    if len(keys) <= len(inner):
        return dict(value)
    return {key: {name: each[key] for name, each in value.items()} for key in keys}


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
