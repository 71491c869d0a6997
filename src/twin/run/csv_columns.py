"""Reads logs: a CSV file with named columns, their units in the header or in SI, or a run."""

from __future__ import annotations

import csv
import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from controllers.arrays import Array
from twin.errors import LogError
from twin.run.folders import is_record

SCALES = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6},
    "m": {"m": 1.0, "mm": 1e-3, "cm": 1e-2},
    "rad": {"rad": 1.0, "mrad": 1e-3, "deg": math.radians(1)},
    "1": {"1": 1.0, "": 1.0},
    "m/s": {"m/s": 1.0, "mm/s": 1e-3},
    "rad/s": {"rad/s": 1.0, "deg/s": math.radians(1)},
    "rad/s^2": {"rad/s^2": 1.0, "deg/s^2": math.radians(1)},
}
"""SI unit to the units that a header may give instead, and their factors."""


def read_csv(
    path: Path, units: Mapping[str, str], look: Callable[[list[str]], object] = lambda _: None
) -> dict[str, Array]:
    """The columns of known names in SI units, shape (K,) each; NaN where a cell is empty.

    Args:
        path: The file; its first line names the columns, as ``measured_x [mm]``.
        units: Name to SI unit; columns of other names are left out.
        look: Is shown the names of all columns before the rows are read.

    Raises:
        LogError: If a unit is unknown, a cell is no number, two columns have one name, or
            columns are not separated by commas.
        OSError: If the file cannot be read.
    """
    with path.open(newline="", encoding="utf-8-sig") as file:
        rows = csv.reader(file)
        first = next(rows, [])
        if len(first) == 1 and ";" in first[0]:
            raise LogError(
                f"{path.name}: columns are separated by ';', as where a comma is the decimal "
                "point; write ',' between columns and '.' in numbers"
            )
        header = [_split_unit(cell) for cell in first]
        names = [name for name, _ in header]
        if twice := [name for name in units if names.count(name) > 1]:
            raise LogError(f"{path.name}: {twice[0]}: two columns have this name")
        look([name for name, _ in header])
        used = [
            (i, name, scale(name, unit, units[name], path.name))
            for i, (name, unit) in enumerate(header)
            if name in units
        ]
        data = [
            [_number(row, i, path.name, name, rows.line_num) for i, name, _ in used]
            for row in rows
            if row
        ]
    values = np.array(data, dtype=float).reshape(len(data), len(used))
    return {name: values[:, k] * factor for k, (_, name, factor) in enumerate(used)}


def read_columns(
    path: Path, units: Mapping[str, str], needed: Sequence[str]
) -> tuple[dict[str, Array], dict[str, Any]]:
    """The columns of a log or a run in SI units, shape (K,) each, and the run's metadata.

    Args:
        path: A CSV file, which has no metadata, or a Parquet file; of several rigs the first.
        units: Name to SI unit; columns of other names are left out.
        needed: Names that have to be there.

    Raises:
        LogError: If it cannot be read, lacks a column, or holds another unit or no numbers.
    """

    def look(names: list[str]) -> None:
        if missing := [name for name in needed if name not in names]:
            raise LogError(
                f"{path.name}: no column {', '.join(missing)} "
                f"(it has {', '.join(names[:12]) or 'none'}{', ...' if len(names) > 12 else ''})"
            )

    try:
        if path.suffix == ".parquet" or is_record(path):
            return _read_table(path, units, look)
        return read_csv(path, units, look), {}
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise LogError(f"{path.name}: cannot be read: {error}") from error


def _read_table(
    path: Path, units: Mapping[str, str], look: Callable[[list[str]], object]
) -> tuple[dict[str, Array], dict[str, Any]]:
    import pyarrow as pa  # noqa: PLC0415  heavy: a CSV file does without

    from twin.run.record_file import stored  # noqa: PLC0415

    try:
        table = stored(path)
    except pa.ArrowException as error:
        raise LogError(f"{path.name}: cannot be read: {error}") from error
    schema = table.schema
    look(schema.names)
    if "rig" in schema.names and len(table):
        rigs = table["rig"].to_numpy()
        table = table.filter(pa.array(rigs == rigs[0]))
    columns: dict[str, Array] = {}
    for name in units:
        if name not in schema.names:
            continue
        try:
            values = np.asarray(table[name].to_numpy(), dtype=float)
        except (KeyError, TypeError, ValueError):
            raise LogError(f"{path.name}: {name}: is not one column of numbers") from None
        unit = (schema.field(name).metadata or {}).get(b"unit")
        columns[name] = values * scale(
            name, unit.decode() if unit else None, units[name], path.name
        )
    try:
        return columns, json.loads((schema.metadata or {}).get(b"ballplate", b"{}"))
    except (ValueError, RecursionError):
        raise LogError(f"{path.name}: its metadata is not that of a run") from None


def scale(name: str, unit: str | None, known: str, source: str) -> float:
    """Factor from a column's unit to SI.

    Args:
        name: The column.
        unit: Its unit; None for that in SI.
        known: Its unit in SI.
        source: What to call the file in messages.

    Raises:
        LogError: If the unit is none of that quantity.
    """
    if unit is None:
        return 1.0
    allowed = SCALES[known]
    if unit not in allowed:
        listed = ", ".join(filter(None, allowed))
        raise LogError(f"{source}: {name}: unit '{unit}'; known: {listed}")
    return allowed[unit]


def _split_unit(header: str) -> tuple[str, str | None]:
    """Name and unit of a header such as ``measured_x [mm]``; None without a unit."""
    match = re.fullmatch(r"\s*(.*?)\s*\[\s*(.*?)\s*\]\s*", header)
    return (match[1], match[2]) if match else (header.strip(), None)


def _number(row: list[str], index: int, source: str, name: str, line: int) -> float:
    text = row[index].strip() if index < len(row) else ""
    try:
        return float(text) if text else np.nan
    except ValueError:
        raise LogError(f"{source}: line {line}: {name}: '{text}' is not a number") from None
