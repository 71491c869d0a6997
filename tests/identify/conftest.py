"""Logs that tests write, break and read."""

import csv

import numpy as np
import pytest

from docs import identify_coverage
from twin.identify.axis_logs import AxisLog


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


@pytest.fixture(scope="module")
def log():
    """Commands that jump and rest, and a ball that is seen until 5 s before the last of them."""
    rng = np.random.default_rng(5)
    time = np.arange(0.0, 25.0, 0.02)
    tilt = 0.05 * np.sin(1.7 * time) + 0.02 * rng.standard_normal(len(time)) * (time % 3 < 2)
    sampled = np.arange(0.0, 20.0, 0.015)
    ball = 0.06 * np.sin(2.3 * sampled) + 0.03 * np.sin(0.9 * sampled)
    return AxisLog(time, tilt, True, sampled, ball)
