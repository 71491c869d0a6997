"""The indicators of runs side by side, as tables."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from twin.base.page import Table, digits
from twin.run.indicators import BOARD_INDICATORS, INDICATORS

if TYPE_CHECKING:
    from twin.run.finished import Run

TIMING_NAMES = ("judged_from", "real_time_factor")
"""Further columns in a table of runs just made."""
_ALL_LABELS = {name: (about["words"], about["printed"]) for name, about in INDICATORS.items()}
INDICATOR_LABELS = {name: label for name, label in _ALL_LABELS.items() if name not in TIMING_NAMES}
"""Indicator to the words and the unit it is printed with."""

FIRST_LABELS = {name: INDICATOR_LABELS[name] for name in (
    "tracking_error_percent", "rms_error", "overshoot_percent", "settling_time", "steady_error",
    "late_percent", *BOARD_INDICATORS,
)}  # fmt: skip
"""Indicators that are printed first, for a reference that moves and for one that comes to rest."""
ORDERED_LABELS = FIRST_LABELS | _ALL_LABELS
"""The same, then all the others."""


def differing(runs: Sequence[Run]) -> list[tuple[str, list[str]]]:
    """The settings that are not the same in all runs: dotted key, a value in JSON per run."""
    settings = [in_json(run.settings) for run in runs]
    keys = dict.fromkeys(key for each in settings for key in each)
    values = ((key, [each.get(key, "-") for each in settings]) for key in keys)
    return [(key, each) for key, each in values if len(set(each)) > 1]


def flat(tables: Mapping[str, Any], path: str = "") -> dict[str, Any]:
    """Values of nested tables by dotted key."""
    found: dict[str, Any] = {}
    for key, value in tables.items():
        if isinstance(value, dict):
            found |= flat(value, f"{path}{key}.")
        else:
            found[f"{path}{key}"] = value
    return found


def in_json(tables: Mapping[str, Any]) -> dict[str, str]:
    """The same with every value in JSON."""
    return {key: json.dumps(value) for key, value in flat(tables).items()}


def indicators(
    title: str,
    runs: Mapping[str, Mapping[str, Any]],
    labels: Mapping[str, tuple[str, str]] = INDICATOR_LABELS,
    note: str = "",
) -> Table:
    """A row per indicator that applies to at least one run, a column per run.

    Args:
        title: Above the table.
        runs: Heading to summary.
        labels: Indicator to the words and the unit it is printed with.
        note: Below the table.
    """
    found = []
    for key, (label, unit) in labels.items():
        values = [each.get(key) for each in runs.values()]
        if any(value or (value is not None and key != "late_percent") for value in values):
            texts = (
                each["outcome"]
                if value is None and each.get("outcome", "finished") != "finished"
                else digits(value, unit)
                for value, each in zip(values, runs.values(), strict=True)
            )
            found.append((label, *texts, unit))
    if not found and runs:  # all ended before there was anything to judge
        found.append(("outcome", *(each["outcome"] for each in runs.values()), ""))
    return Table(title, ("", *runs, "unit"), found, words=(0, -1), note=note)


def by_run(runs: Mapping[str, Mapping[str, Any]], what: str = "") -> Table:
    """The indicators that come first, a line per run, for more runs than a table has columns for.

    Args:
        runs: Heading to summary.
        what: What the headings are.
    """
    rows = indicators("", runs, FIRST_LABELS).rows
    heads = (what, *(f"{row[0]} [{row[-1]}]" for row in rows))
    return Table("", heads, list(zip(runs, *(row[1:-1] for row in rows), strict=True)))
