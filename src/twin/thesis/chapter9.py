"""Tables 9.1 to 9.9, measured on the rig: predicted from one number, explained by four, held out.

The measurements are the shipped table ``chapter_9`` of ``ballplate fit``; columns are evaluated
alike, as the rig's computer sees its runs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from controllers.analysis import number
from twin.run.finished import run
from twin.study.experiments import Store
from twin.thesis.columns import THESIS_COLUMNS, read_stored
from twin.tune.cells import FitTable, Runs, Sample, read

SETTLING_TIME_S = 3.0
SETTLING_NOTE = (
    "Read by eye by the thesis; here the time from which x stays within 5 % of the step of where "
    "it comes to rest."
)
"""Settling time of Table 9.1 in s, and how it is read."""
ROLLING_FRICTION_MM, ROLLING_LOW_MM, ROLLING_HIGH_MM = 0.17649, 0.16693, 0.18605
"""Rolling friction in mm from the three tracking errors of Table 9.3, as
``ballplate fit friction_of_table_9_3`` finds it, and its 95 % interval by Student's t. The
scenarios ``thesis/9_*`` have it."""
CALIBRATION_TABLE = "9.3"
"""The table with the three tracking errors that the prediction knows."""

Row = dict[str, Any]
"""A cell: table, row, column, thesis; predicted, frictionless, low, high by one number, low and
high with the ends of its interval; explained, held_out by the four numbers fitted to all tables and
to all but its own; calibration, note. None where the ball was lost."""


def tables() -> tuple[str, ...]:
    """The numbers of the tables."""
    return read("chapter_9").groups


def best(group: str = "") -> Sample:
    """The four numbers without a table, by default with all, of the search that ended lowest."""
    ends = [search_end(search, group) for search in read_stored("chapter_9")["searches"]]
    return min(ends, key=lambda end: end[0])[1]


def search_end(search: Mapping[str, Any], group: str) -> tuple[float, Sample]:
    """Chi-squared and numbers at the end of a search without a table, or with all."""
    end = search["without"][group] if group else search
    numbers = end["parameters"]
    return float(end["chi2"]), tuple(float(numbers[name]) for name in read("chapter_9").parameters)


def chosen(ids: Iterable[str]) -> FitTable:
    """The experiments of the tables of these numbers, all for none."""
    about, wanted = read("chapter_9"), {*ids}
    some = tuple(each for each in about.experiments if not wanted or each.group in wanted)
    return about.model_copy(update={"experiments": some})


def predicting(about: FitTable) -> FitTable:
    """The same experiments with the numbers that the prediction knows: friction alone."""
    known = read("friction_of_table_9_3")
    # a seed of its own each, and nothing that was found out later
    experiments = tuple(each.model_copy(update={"set": each.set[:1]}) for each in about.experiments)
    return known.model_copy(update={"experiments": experiments})


def rows(
    ids: Iterable[str] = (),
    advance: Callable[[float], None] = lambda _: None,
    *,
    settings: Sequence[str] = (),
    processes: int = 1,
) -> list[Row]:
    """One dictionary per cell, in the thesis's order; see ``Row``.

    Args:
        ids: Numbers of tables; none for all.
        advance: Called with the share done, 0 to 1.
        settings: Further settings of the explanation, which is on the exact equations.
        processes: On how many processors.

    Raises:
        ScenarioError: If a setting is wrong.
    """
    about = chosen(ids)
    explaining = about.model_copy(update={"set": (*about.set, *settings)})
    arms = [(arm,) for arm in (ROLLING_FRICTION_MM, 0.0, ROLLING_LOW_MM, ROLLING_HIGH_MM)]
    places = range(len(about.experiments))
    first = run_samples(
        predicting(about),
        [(arm, k) for k in places for arm in arms],
        processes,
        lambda share: advance(0.7 * share),
    )
    second = run_samples(
        explaining,
        [(one, k) for k in places for one in (best(), best(about.experiments[k].own_group))],
        processes,
        lambda share: advance(0.7 + 0.3 * share),
    )
    found = []
    for k, each in enumerate(about.experiments):
        table, _, name = each.label.partition(", ")
        for column, kind in THESIS_COLUMNS.items():
            explained: list[float | None] = [None, None]
            if column == "t_ss" and each.own_group == "9.1":
                thesis, note = SETTLING_TIME_S, SETTLING_NOTE
                values = [number(_settling_time(predicting(about), arm, k)) for arm in arms]
            elif kind.metric in each.measured:
                thesis, note = each.measured[kind.metric].value, each.measured[kind.metric].note
                values = [number(first[arm, k][kind.metric]) for arm in arms]
                fitted = (best(), best(each.own_group))
                explained = [number(second[one, k][kind.metric]) for one in fitted]
            else:
                continue
            predicted, frictionless, *ends = values
            known = [value for value in (*ends, predicted) if value is not None]
            found.append(
                {
                    "table": table,
                    "row": name,
                    "column": column,
                    "thesis": thesis,
                    "predicted": predicted,
                    "frictionless": frictionless,
                    "explained": explained[0],
                    "held_out": explained[1],
                    "calibration": table == CALIBRATION_TABLE and column == "e_tt",
                    "low": min(known, default=None),
                    "high": max(known, default=None),
                    "note": note,
                }
            )
    return found


def run_samples(
    about: FitTable,
    wanted: Sequence[tuple[Sample, int]],
    processes: int,
    advance: Callable[[float], None],
) -> Mapping[tuple[Sample, int], Mapping[str, float]]:
    """The indicators of runs that are kept nowhere."""
    carried_out = Runs(
        about,
        Store(None),
        processes=processes,
        progress=lambda done, _: advance(done / len(wanted)),
    )
    return carried_out.indicators(wanted)


def _settling_time(about: FitTable, arm: Sample, place: int) -> float:
    """When the ball of Table 9.1 comes within 5 % of the step of its place at rest for good, s."""
    scenario = Runs(about, Store(None)).scenario(arm, about.experiments[place])
    rows = run(scenario.model_copy(update={"baseline": False})).rows
    time, x = rows["time"], rows["estimated_x"]
    end = x[time > time[-1] - 1].mean()
    outside = np.flatnonzero(np.abs(x - end) > 0.05 * 0.15)
    return float(time[outside[-1]]) if len(outside) else 0.0
