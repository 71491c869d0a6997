"""Columns of the thesis's tables, and the results that are stored next to its data."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

from twin.base.data_file import read_packaged

PACKAGE_NAME = "twin.thesis"


@cache
def read_stored(chapter: str) -> dict[str, Any]:
    """Results computed once for a chapter and kept next to its tables.

    ``chapter_8``: table, row and column to the values under continuous control, one, or with its
    range; ``fitted`` of a row is a second reading of the thesis, in words. ``chapter_9``:
    what ``ballplate fit chapter_9`` found: parameters, correlation, of every search its end with
    all tables and without each, and what docs/chapter9.py finds of its goals.
    """
    return json.loads((files(PACKAGE_NAME) / f"data/{chapter}.json").read_bytes())


@dataclass(frozen=True, kw_only=True)
class ThesisColumn:
    """A column of the thesis's tables.

    Attributes:
        label: Its quantity, as the thesis calls it.
        unit: Its unit.
        compared: "value" against the bound, "reading" against a value read by eye from a figure,
            "noise" against the range of the seeds.
        zero: Absolute bound where the thesis prints 0.
        metric: The indicator of ``twin.run.metrics`` that it is; empty for one of its own.
    """

    label: str
    unit: str
    compared: str = "value"
    zero: float = 0.0
    metric: str = ""

    @property
    def name(self) -> str:
        """Label and unit."""
        return f"{self.label} [{self.unit}]"


THESIS_COLUMNS = {
    name: ThesisColumn(**about)
    for name, about in read_packaged(PACKAGE_NAME, "data/columns.toml").items()
}
"""The columns of this chapter and the next by the names the data files use.

The "average tracking error" is not (C.4), but a root mean square over the run. e_tt (C.7) and the
"max. steady tracking error" are taken from ``metrics.start`` on.
"""
