"""Experiments: scenarios times points times rigs, and a table of what each run gave."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from functools import partial
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from twin.study.carry import carry
from twin.study.store import Store
from twin.study.work import ScenarioRuns, carry_out

if TYPE_CHECKING:
    import pandas as pd


def evaluate(
    runs: ScenarioRuns,
    labels: Mapping[str, Any],
    store: Store,
    *,
    executor: Executor | None = None,
    processes: int | None = None,
    seen: bool = False,
    whole: bool = False,
    progress: Callable[[int, int], None] = lambda *_: None,
) -> pd.DataFrame:
    """Finish runs: a row for each, with its labels, outcome, reason and every indicator.

    Args:
        runs: What to run; ``seen`` as they were made.
        labels: Columns that tell what each run is, as its candidate, task and rig.
        store: Where finished ones are, and are put.
        executor: Anything with the interface of ``concurrent.futures``; None for processes here.
        processes: So many of them, or of its workers; None for one a processor.
        seen: Whether they are judged by what the rig's computer sees, not by the truth.
        whole: Whether batches are as large as can be, of which a kill may cost all.
        progress: Told how many runs are finished, and how many of those did not end well.

    Raises:
        TwinError: If a process is killed, or a chunk of runs is lost too often.
    """
    rows = carry(
        runs,
        store,
        executor=executor,
        processes=processes,
        do=partial(carry_out, seen=seen),
        whole=whole,
        progress=progress,
    )
    found: pd.DataFrame = labelled(labels, rows).to_pandas()
    return found


def labelled(labels: Mapping[str, Any], rows: pa.Table) -> pa.Table:
    """Rows of runs behind their labels, without their keys."""
    return pa.table({**labels, **{name: rows[name] for name in rows.column_names if name != "key"}})
