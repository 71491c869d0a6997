"""Every cell of Tables 9.1 to 9.9, with friction and without, and the goals that this meets."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from controllers.arrays import Array
from twin.run.loop import Outcome
from twin.thesis.experiments.batch import DURATION, rolling, simulate
from twin.thesis.experiments.fit import identified
from twin.thesis.experiments.judge import judged
from twin.thesis.experiments.tables import (
    CALIBRATION,
    EARLY,
    FIFTEEN,
    LATE,
    SLIDING,
    MeasuredExperiment,
    chosen,
)

Prediction = dict[str, Any]
"""A cell; see ``rows``."""


def rows(
    tables: Iterable[str] = (),
    advance: Callable[[float], None] = lambda _: None,
    *,
    mechanism: bool = True,
    duration: float = DURATION,
) -> list[Prediction]:
    """One dictionary per cell, in the thesis's order.

    Its keys: table, row, column, thesis, predicted, frictionless, calibration, low, high, note.
    ``low`` and ``high`` are the predictions with the ends of the friction's 95 % interval; a value
    is None where the ball was lost.

    Args:
        tables: Their numbers; none for all.
        advance: Called with the share done, 0 to 1.
        mechanism: Whether on the MuJoCo mechanism, or on the exact model.
        duration: Seconds per experiment.

    Raises:
        ScenarioError: If there is no such table.
    """
    experiments, known = chosen(tables), identified()
    arms = (known.rolling, 0.0, known.low, known.high)
    traces = simulate(
        experiments,
        [rolling(arm) for arm in arms],
        mechanism=mechanism,
        duration=duration,
        progress=lambda done: advance(done / duration),
    )
    found = []
    for experiment, each in zip(experiments, traces, strict=True):
        values = [judged(trace, known.reading, known.start) for trace in each]
        found += [_row(experiment, column, values, each[0].outcome) for column in experiment.cells]
    return found


def _row(
    experiment: MeasuredExperiment,
    column: str,
    values: Sequence[dict[str, float]],
    outcome: Outcome,
) -> Prediction:
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


class Goal(NamedTuple):
    """A goal, what was found, and whether it is reached."""

    sentence: str
    found: str
    reached: bool


def goals(rows: Sequence[Prediction]) -> list[Goal]:
    """All goals, judged on the rows of Tables 9.2 to 9.9."""
    errors = {
        name: np.array([_value(r) for r in rows if r["table"] == name and r["column"] == "e_tt"])
        for name in sorted({r["table"] for r in rows} - {"9.1"})
    }
    return [*_numbers(rows), *_orderings(errors)]


def deviations(rows: Sequence[Prediction], tables: Sequence[str]) -> Array:
    """Predicted minus measured tracking errors of tables, in points."""
    return np.array(
        [_value(r) - r["thesis"] for r in rows if r["table"] in tables and r["column"] == "e_tt"]
    )


def _value(row: Prediction) -> float:
    return float("nan") if row["predicted"] is None else float(row["predicted"])


def _numbers(rows: Sequence[Prediction]) -> list[Goal]:
    fifteen, six = np.abs(deviations(rows, FIFTEEN)), np.abs(deviations(rows, SLIDING))
    return [
        Goal(
            "15 predicted errors: mean absolute deviation at most 2.0 points",
            f"{fifteen.mean():.2f}",
            bool(fifteen.mean() <= 2.0),
        ),
        Goal("none of the 15 beyond 5 points", f"{fifteen.max():.2f}", bool(fifteen.max() <= 5)),
        Goal(
            "sliding mode: mean absolute deviation at most 6 points",
            f"{six.mean():.2f}",
            bool(six.mean() <= 6),
        ),
    ]


def _orderings(e: dict[str, Array]) -> list[Goal]:
    means = {name: values.mean() for name, values in e.items()}
    falls = [values[0] > values[1] > values[2] for name, values in e.items() if name in SLIDING]
    worst = all(means[s] > max(means[n] for n in e if n not in SLIDING) for s in SLIDING)
    best = all(
        max(means[integral], means[backstepping]) < means[afl]
        for afl, integral, backstepping in (("9.2", "9.4", "9.6"), ("9.3", "9.5", "9.7"))
    )
    gain = {late: means[late] - means[early] for late, early in zip(LATE, EARLY, strict=True)}
    grows = [float(e[name][2] - e[name][0]) for name in ("9.2", "9.3")]
    little = all(abs(g) < 0.25 * means[name] for name, g in gain.items())
    return [
        Goal(
            "sliding mode improves with frequency",
            ", ".join(" > ".join(f"{v:.1f}" for v in e[name]) for name in SLIDING),
            all(falls),
        ),
        Goal(
            "sliding mode is worst",
            ", ".join(f"{means[name]:.1f}" for name in SLIDING) + " %",
            bool(worst),
        ),
        Goal(
            "AFL with integral action and backstepping are best",
            ", ".join(f"{name}: {means[name]:.1f}" for name in e if name not in SLIDING),
            bool(best),
        ),
        Goal(
            "the predictor changes little (less than a quarter)",
            ", ".join(f"{name}: {g:+.1f}" for name, g in gain.items()) + " points without it",
            bool(little),
        ),
        Goal(
            "the predictor lowers the error",
            ", ".join(f"{name}: {g:+.1f}" for name, g in gain.items()) + " points without it",
            all(g > 0 for g in gain.values()),
        ),
        Goal(
            "AFL's error does not grow with frequency",
            ", ".join(f"{g:+.1f}" for g in grows) + " points from 0.5 to 1 rad/s",
            all(g <= 0 for g in grows),
        ),
    ]
