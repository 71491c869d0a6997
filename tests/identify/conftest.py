"""Logs that tests write, break and read."""

import csv

import pytest

from docs import identify_coverage


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
def axis_log():
    """Gives logs of a rig that is simulated without any of the twin's code."""
    return identify_coverage.axis_log


@pytest.fixture(scope="session")
def coverage():
    """Counts how often intervals hold."""
    return identify_coverage.coverage
