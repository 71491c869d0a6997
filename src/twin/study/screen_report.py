"""What a screened study shows: biases, estimates and the points at the ends, as tables and JSON."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pyarrow.csv as pa_csv

from controllers.analysis import number
from twin.base.errors import plural
from twin.base.page import Block, Table, Text, digits
from twin.base.writing import write_whole
from twin.run.tables import INDICATOR_LABELS
from twin.study.fidelity import Estimate
from twin.study.report import metric_label
from twin.study.schema import Study
from twin.study.screen import Screened


def blocks(study: Study, found: Screened) -> list[Block]:
    """What a screened study shows: biases, estimates, and the points that decide."""
    return [
        Text([describe(found), *found.notes], "Exact equations and mechanism"),
        bias_table(found),
        joined_table(study, found),
        checked_table(study, found),
    ]


def write_rows(found: Screened, folder: Path) -> None:
    """Write screened.csv, a row for each run beyond the study's own.

    Raises:
        RecordError: If it cannot be written.
    """
    write_whole(folder / "screened.csv", lambda path: pa_csv.write_csv(found.rows, path))


def describe(found: Screened) -> str:
    """What ran on which plant."""
    counts = found.counts
    engine = {"c": "compiled C", "python": "Python"}[found.engine]
    left = f" The exact equations have no {', '.join(found.left_out)}." if found.left_out else ""
    return (
        f"{plural(counts['mechanism'], 'run')} on the mechanism; the same points on the exact "
        "equations "
        f"({plural(counts['paired'], 'different run')}); {plural(found.times, 'time')} as many "
        "further points there "
        f"({counts['wide']} different runs, simulated in {engine}); and {counts['checked']} of "
        f"these, the worst and the best, on the mechanism.{left}"
    )


def bias_table(found: Screened) -> Table:
    """The bias of each indicator."""
    rows = [
        (
            each.variant,
            _with_unit(each.indicator),
            digits(each.mean, places=4),
            digits(each.difference.value, places=3),
            digits(each.difference.width / 2, places=2),
            "-" if math.isnan(each.correlation) else f"{each.correlation:.3f}",
            str(each.points),
        )
        for each in found.biases
    ]
    heads = ("variant", "indicator", "mechanism", "exact minus mechanism", "± 95 %")
    title = "Bias of the exact equations, means over the same points with the same noise"
    return Table(title, (*heads, "correlation", "points"), rows, words=(0, 1))


def _with_unit(indicator: str) -> str:
    unit = INDICATOR_LABELS[indicator][1]
    return f"{indicator} [{'m' if unit == 'mm' else unit}]" if unit else indicator


def joined_table(study: Study, found: Screened) -> Table:
    """Each statistic of the mechanism from one plant and from both."""
    rows = [
        (
            each.variant,
            each.statistic,
            *map(_in_words, (each.alone, each.joined)),
            _ratio(each.alone.width, each.joined.width),
        )
        for each in found.joined
    ]
    heads = (
        "variant",
        "statistic or total index",
        "mechanism alone",
        "both plants",
        "times narrower",
    )
    title = f"{metric_label(study)} on the mechanism, with 95 % intervals"
    return Table(title, heads, rows, words=(0, 1))


def _in_words(estimate: Estimate) -> str:
    low, high = (digits(each, places=3) if math.isfinite(each) else "?" for each in estimate[1:])
    return f"{digits(estimate.value, places=4)} ({low} to {high})"


def _ratio(wide: float, narrow: float) -> str:
    return f"{wide / narrow:.1f}" if 0 < narrow < math.inf and wide < math.inf else "-"


def checked_table(study: Study, found: Screened) -> Table:
    """The worst and best points on the exact equations, on both plants."""
    rows = [
        (
            each.variant,
            each.which,
            *(digits(each.point[key]) for key in study.parameters),
            *(
                "failed" if math.isnan(value) else digits(value, places=4)
                for value in (each.exact, each.mechanism)
            ),
        )
        for each in found.checked
    ]
    heads = ("variant", "on the exact equations", *study.parameters, "exact", "mechanism")
    return Table(f"{metric_label(study)} at the ends", heads, rows, words=(0, 1))


def numbers_of(found: Screened) -> dict[str, Any]:
    """All of it as JSON takes it."""

    def interval(estimate: Estimate) -> dict[str, float | None]:
        return {name: number(value) for name, value in estimate._asdict().items()}

    return {
        "times": found.times,
        "engine": found.engine,
        "left_out": found.left_out,
        "runs": dict(found.counts),
        "bias": [
            each._asdict()
            | {"difference": interval(each.difference), "correlation": number(each.correlation)}
            for each in found.biases
        ],
        "estimates": [
            each._asdict() | {"alone": interval(each.alone), "joined": interval(each.joined)}
            for each in found.joined
        ],
        "checked": [
            each._asdict() | {"exact": number(each.exact), "mechanism": number(each.mechanism)}
            for each in found.checked
        ],
        "notes": found.notes,
    }
