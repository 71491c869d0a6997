"""Indicators over the values of one key: what is swept, the table of it, the curve."""

from __future__ import annotations

import csv
import math
import textwrap
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from twin.data_file import DataError, parse_toml
from twin.errors import ScenarioError
from twin.jobs import results
from twin.run.execute import run
from twin.run.loop import Ending
from twin.run.metrics import UNITS
from twin.run.record import write_whole
from twin.scenario.schema import Scenario
from twin.scenario.variants import written

WIDTH = 80
"""Characters in a line of the title."""
MOST = 1000
"""Values that a range may have."""
SHOWN = {
    "tracking_error_percent": ("tracking error e_tt [%]", 1),
    "rms_error": ("RMS, x [mm]", 1e3),
}
"""Indicators that are drawn: words and factor."""


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """What came of a sweep.

    Attributes:
        title: What was swept.
        key: The key whose values are swept.
        values: Its values.
        runs: Name of each curve to the summaries of its runs, one a value.
    """

    title: str
    key: str
    values: tuple[Any, ...]
    runs: Mapping[str, Sequence[Mapping[str, Any]]]


def swept(text: str) -> tuple[str, list[Any]]:
    """Key and values of ``KEY=FIRST:LAST:NUMBER``, evenly spaced, or ``KEY=[A, B, ...]``.

    Raises:
        ScenarioError: If the text is neither.
    """
    key, equals, values = (part.strip() for part in text.partition("="))
    form = f"sweep '{text[:200]}': write KEY=FIRST:LAST:NUMBER, as in duration=5:10:6, or KEY=[A,B]"
    if not key or not equals or not values:
        raise ScenarioError(form)
    if values.startswith("["):
        try:
            listed = parse_toml(f"values = {values}")["values"]
        except (tomllib.TOMLDecodeError, DataError):
            raise ScenarioError(form) from None
        if not listed:
            raise ScenarioError(form)
        return key, listed
    parts = values.split(":")
    try:
        first, last, number = float(parts[0]), float(parts[1]), int(parts[2])
    except (ValueError, IndexError):
        raise ScenarioError(form) from None
    if len(parts) != 3 or not math.isfinite(first + last) or not 2 <= number <= MOST:
        raise ScenarioError(f"{form}; NUMBER: 2 to {MOST}")
    spaced = [float(f"{value:.12g}") for value in np.linspace(first, last, number)]
    whole = "." not in parts[0] + parts[1] and all(value.is_integer() for value in spaced)
    return key, [int(value) for value in spaced] if whole else spaced


def summaries(
    cases: Sequence[tuple[Any, Scenario]], processes: int
) -> Iterator[tuple[Any, dict[str, Any]]]:
    """Name and summary of every run, as they come.

    Raises:
        KeyboardInterrupt: If the user interrupts.
        TwinError: If a scenario cannot be assembled.
    """
    yield from results(_summary, cases, processes)


def as_csv(sweep: Sweep) -> str:
    """A line per run: curve, value, every indicator with its unit in the header."""
    store = StringIO()
    writer = csv.writer(store, lineterminator="\n")
    names = ["outcome", *(name for name in UNITS if name != "real_time_factor")]
    heads = [f"{name} [{UNITS[name]}]" if name in UNITS else name for name in names]
    writer.writerow(["curve", sweep.key, *heads])
    for curve, runs in sweep.runs.items():
        for value, found in zip(sweep.values, runs, strict=True):
            writer.writerow([curve, written(value), *(found.get(name) for name in names)])
    return store.getvalue()


def draw(path: Path, sweep: Sweep) -> None:
    """Draw the curves into a PNG file; a cross marks a run that ended early.

    Raises:
        RecordError: If the file cannot be written.
    """
    import matplotlib as mpl  # noqa: PLC0415  heavy: loaded when needed
    from matplotlib.figure import Figure  # noqa: PLC0415

    from twin.run.overview_plot import COLOURS, DPI, LOOK  # noqa: PLC0415

    numeric = all(isinstance(value, int | float) for value in sweep.values)
    at = np.array(sweep.values if numeric else range(len(sweep.values)), float)
    drawn = {
        name: words
        for name, words in SHOWN.items()
        if any(each.get(name) is not None for runs in sweep.runs.values() for each in runs)
    }
    with mpl.rc_context(LOOK):
        figure = Figure(figsize=(8, 1.4 + 2.8 * max(len(drawn), 1)), dpi=DPI, layout="constrained")
        lines = textwrap.wrap(sweep.title, WIDTH)
        figure.suptitle("\n".join(lines), fontsize=11, fontweight="bold")
        panels = figure.subplots(max(len(drawn), 1), sharex=True, squeeze=False)[:, 0]
        for panel, (name, (words, factor)) in zip(panels, drawn.items(), strict=False):
            for index, (curve, runs) in enumerate(sweep.runs.items()):
                ended = np.array([each["outcome"] != Ending.FINISHED for each in runs])
                known = [np.nan if each.get(name) is None else each[name] for each in runs]
                shown = np.where(ended, np.nan, factor * np.array(known, float))
                colour = COLOURS[index % len(COLOURS)]
                panel.plot(at, shown, "o-", color=colour, ms=4, label=curve)
                if ended.any():
                    panel.plot(at[ended], 0 * at[ended], "x", color=colour, ms=7, clip_on=False)
            panel.set_ylabel(words)
            panel.set_ylim(0, None)
        panels[-1].set_xlabel(
            f"{sweep.key}  (×: the run ended early)" if _early(sweep) else sweep.key
        )
        if not numeric:
            panels[-1].set_xticks(at, [named(value) for value in sweep.values])
        if len(sweep.runs) > 1:
            names = panels[0].get_legend_handles_labels()
            figure.legend(*names, loc="outside lower center", ncols=4, fontsize=9)
        write_whole(path, lambda target: figure.savefig(target, format="png"))


def named(value: Any) -> str:
    """A value in the digits a person wants to read."""
    return f"{value:.6g}" if isinstance(value, float) else written(value)


def _early(sweep: Sweep) -> bool:
    runs = (each for found in sweep.runs.values() for each in found)
    return any(each["outcome"] != Ending.FINISHED for each in runs)


def _summary(scenario: Scenario) -> dict[str, Any]:
    done = run(scenario)
    if done.outcome.interrupted:
        raise KeyboardInterrupt
    return done.summary()
