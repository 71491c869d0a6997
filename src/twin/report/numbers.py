"""The indicators of runs side by side: rows for HTML, CSV and LaTeX."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from twin.page import Table, digits
from twin.run.files import INDICATORS

if TYPE_CHECKING:
    import pandas as pd

    from twin.run.finished import Run

TIMES = ("judged_from", "real_time_factor")
"""What a table of runs just made has besides."""
_ALL = {name: (about["words"], about["printed"]) for name, about in INDICATORS.items()}
LABELS = {name: label for name, label in _ALL.items() if name not in TIMES}
"""Indicator to the words and the unit it is printed with."""

FIRST = (
    "tracking_error_percent", "rms_error", "overshoot_percent", "settling_time", "steady_error",
    "late_percent",
)  # fmt: skip
"""What is asked for first, of a reference that moves and of one that comes to rest."""


class IndicatorRow(NamedTuple):
    """One indicator: what it is called, its unit, one text per run."""

    label: str
    unit: str
    values: tuple[str, ...]


def rows(runs: Sequence[Run]) -> list[IndicatorRow]:
    """The indicators that apply to at least one run."""
    return _rows([run.metrics for run in runs], LABELS)


def first_rows(summaries: Sequence[Mapping[str, Any]]) -> list[IndicatorRow]:
    """The indicators that are asked for first, those that apply to at least one run."""
    return _rows(summaries, {key: LABELS[key] for key in FIRST})


def all_rows(summaries: Sequence[Mapping[str, Any]]) -> list[IndicatorRow]:
    """The same, then all the others."""
    return _rows(summaries, {key: LABELS[key] for key in FIRST} | _ALL)


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


def own_settings(runs: Mapping[str, Run]) -> list[str]:
    """What differs between the laws, observers and references of runs, a line per key."""
    if len(runs) < 2:
        return []
    tables = {table for run in runs.values() for table in run.classes}
    return [
        f"{key}: " + ", ".join(f"{name} {value}" for name, value in zip(runs, each, strict=True))
        for key, each in differing(list(runs.values()))
        if key.partition(".")[0] in tables and not key.endswith(".sha256")
    ]


def ranking(summaries: Mapping[str, Mapping[str, Any]]) -> str:
    """Which of several runs had the lowest tracking error, in one sentence; heading to summary."""
    key, label, unit = "tracking_error_percent", "Tracking error e_tt", " %"
    if not any(each.get(key) for each in summaries.values()):
        key, label, unit = "rms_error", "RMS error on x", " mm"
    factor = 1000 if unit == " mm" else 1
    found = {
        heading: factor * each[key]
        for heading, each in summaries.items()
        if each.get(key) is not None and each.get("outcome") == "finished"
    }
    if not found:
        return "None of the runs went to its end."
    best, worst = min(found, key=found.__getitem__), max(found, key=found.__getitem__)
    lost = sum(each.get("outcome") != "finished" for each in summaries.values())
    early = f"; {lost} ended early" if lost else ""
    if found[best] == found[worst]:
        return f"{label}: {found[best]:.3g}{unit} in every run{early}."
    return (
        f"{label}: lowest {found[best]:.3g}{unit} ({best}), "
        f"highest {found[worst]:.3g}{unit} ({worst}){early}."
    )


def _rows(
    summaries: Sequence[Mapping[str, Any]], labels: Mapping[str, tuple[str, str]]
) -> list[IndicatorRow]:
    found = []
    for key, (label, unit) in labels.items():
        values = [each.get(key) for each in summaries]
        if any(value or (value is not None and key != "late_percent") for value in values):
            texts = (
                each["outcome"]
                if value is None and each.get("outcome", "finished") != "finished"
                else digits(value, unit)
                for value, each in zip(values, summaries, strict=True)
            )
            found.append(IndicatorRow(label, unit, tuple(texts)))
    if not found and summaries:  # all ended before there was anything to judge
        found.append(IndicatorRow("outcome", "", tuple(each["outcome"] for each in summaries)))
    return found


def indicators(
    title: str, found: Sequence[IndicatorRow], names: Sequence[str], note: str = ""
) -> Table:
    """Rows as a table with a column per run."""
    cells = [(row.label, *row.values, row.unit) for row in found]
    heads = ("", *names, "unit")
    return Table(title, heads, cells, words=(0, -1), note=note)


def as_csv(runs: Sequence[Run]) -> str:
    """The table as comma-separated values with a header line."""
    text: str = _frame(runs).to_csv(index=False, lineterminator="\n")
    return text


def as_latex(runs: Sequence[Run]) -> str:
    """The table for a paper; needs nothing but LaTeX itself."""
    frame = _frame(runs).rename(columns={"indicator": ""})
    frame = frame.iloc[:, [0, *range(2, 2 + len(runs)), 1]]
    style = (
        frame.style.hide(axis="index").format(escape="latex").format_index(escape="latex", axis=1)
    )
    text: str = style.to_latex(column_format=f"l{'r' * len(runs)}l", hrules=True)
    for rule in ("toprule", "midrule", "bottomrule"):
        text = text.replace(rule, "hline")
    return text.replace("|", "$|$").replace("²", "$^2$")


def _frame(runs: Sequence[Run]) -> pd.DataFrame:
    """Indicator, unit, and one text per run."""
    import pandas as pd  # noqa: PLC0415  heavy: only files need it

    heads = ["indicator", "unit", *(run.name for run in runs)]
    return pd.DataFrame([(row.label, row.unit, *row.values) for row in rows(runs)], columns=heads)
