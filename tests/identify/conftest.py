"""Logs that tests write, break and read."""

import csv
import importlib
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from twin.identify.logs import COLUMNS

sys.path.insert(0, str(Path(__file__).parents[2] / "docs"))
identify_coverage = importlib.import_module("identify_coverage")
sys.path.pop(0)


@pytest.fixture(scope="session")
def columns_of():
    """Gives the columns of a run folder's log in SI units by name."""

    def of(folder):
        table = pq.read_table(folder / "run.parquet")
        return {
            name: table[name].to_numpy().copy() for name in COLUMNS if name in table.column_names
        }

    return of


@pytest.fixture(scope="session")
def write():
    """Writes a CSV file of columns; ``texts`` replaces cells (row, name) by words."""

    def written(path, columns, *, rows=None, headers=None, texts=None):
        headers, texts = headers or {}, texts or {}
        with path.open("w", newline="", encoding="utf-8") as file:
            out = csv.writer(file)
            out.writerow([headers.get(name, name) for name in columns])
            for k in range(len(columns["time"])) if rows is None else rows:
                out.writerow(
                    [
                        texts.get((k, name), repr(float(values[k])))
                        for name, values in columns.items()
                    ]
                )
        return path

    return written


@pytest.fixture(scope="session")
def broken():
    """Columns of which some are changed by a function each."""

    def changed(columns, **changes):
        new = {name: change(columns[name].copy()) for name, change in changes.items()}
        return {**columns, **new}

    return changed


@pytest.fixture(scope="session")
def axis_log():
    """Gives logs of a rig that is simulated without any of the twin's code."""
    return identify_coverage.axis_log


@pytest.fixture(scope="session")
def coverage():
    """Counts how often intervals hold."""
    return identify_coverage.coverage
