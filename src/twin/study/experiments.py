"""Experiments: scenarios times points times rigs, and a table of what each run gave."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from twin.study.carry import carry
from twin.study.store import Store
from twin.study.work import ScenarioRuns

if TYPE_CHECKING:
    import pandas as pd


def evaluate(
    runs: ScenarioRuns, labels: Mapping[str, Any], store: Store, **how: Any
) -> pd.DataFrame:
    """Finish runs: a row for each, with its labels, outcome, reason and every indicator.

    Args:
        runs: What to run.
        labels: Columns that tell what each run is, as its candidate, task and rig.
        store: Where finished ones are, and are put.
        how: Who carries them out, and how, as for ``carry``.

    Raises:
        TwinError: If a process is killed, or a chunk of runs is lost too often.
    """
    found: pd.DataFrame = labelled(labels, carry(runs, store, **how)).to_pandas()
    return found


def labelled(labels: Mapping[str, Any], rows: pa.Table) -> pa.Table:
    """Rows of runs behind their labels, without their keys."""
    return pa.table({**labels, **{name: rows[name] for name in rows.column_names if name != "key"}})
