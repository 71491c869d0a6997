"""Every cell of Tables 9.1 to 9.9: measured, predicted, and what a frictionless rig would do."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from twin.thesis.experiments.batch import DURATION, simulate
from twin.thesis.experiments.fit import identified
from twin.thesis.experiments.judge import judged
from twin.thesis.experiments.rig import Rig
from twin.thesis.experiments.tables import CALIBRATION, Experiment, chosen

Row = dict[str, Any]


def rows(
    tables: Iterable[str] = (),
    advance: Callable[[float], None] = lambda _: None,
    *,
    mechanism: bool = True,
    duration: float = DURATION,
) -> list[Row]:
    """One dictionary a cell, in the thesis's order.

    Its keys: table, row, column, thesis, predicted, frictionless, calibration, low, high, note.
    ``low`` and ``high`` are the predictions with the ends of the friction's 95 % interval; a value
    is None where the ball was lost.

    Args:
        tables: Their numbers; none for all.
        advance: Told the share done, 0 to 1.
        mechanism: Whether on the MuJoCo mechanism, or on the exact model.
        duration: Seconds an experiment.

    Raises:
        ScenarioError: If there is no such table.
    """
    experiments, known = chosen(tables), identified()
    arms = (known.rolling, 0.0, known.low, known.high)
    total = duration * len(arms)
    traces = simulate(
        experiments,
        [Rig(rolling=arm) for arm in arms],
        mechanism=mechanism,
        duration=duration,
        progress=lambda done: advance(done / total),
    )
    found = []
    for experiment, each in zip(experiments, traces, strict=True):
        values = [judged(trace, known.reading, known.start) for trace in each]
        found += [_row(experiment, column, values, each[0].outcome) for column in experiment.cells]
    return found


def _row(
    experiment: Experiment, column: str, values: Sequence[dict[str, float]], outcome: Any
) -> Row:
    predicted, frictionless, *ends = (_number(value[column]) for value in values)
    ends_known = [end for end in (*ends, predicted) if end is not None]
    notes = [experiment.notes.get(column, "")]
    if predicted is None:
        notes.append(f"The predicted run {outcome.ending} at {outcome.time:.1f} s.")
    return {
        "table": experiment.table,
        "row": experiment.name,
        "column": column,
        "thesis": experiment.cells[column],
        "predicted": predicted,
        "frictionless": frictionless,
        "calibration": experiment.table == CALIBRATION and column == "e_tt",
        "low": min(ends_known, default=None),
        "high": max(ends_known, default=None),
        "note": " ".join(filter(None, notes)),
    }


def _number(value: float) -> float | None:
    return None if math.isnan(value) else value
