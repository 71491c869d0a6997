"""The files of a study: HTML report, figures, rows, and a summary in Markdown."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq
from markupsafe import Markup

from twin.html import inline, render
from twin.report.numbers import LABELS
from twin.study.answers import Answer, Spread
from twin.study.experiments import labelled
from twin.study.figures import figures, metric_label, parameter_label, where_label
from twin.study.schema import Study
from twin.study.summary import NEGLIGIBLE, needed, sentences
from twin.study.work import Work
from twin.writing import write_whole

HEADINGS = {
    "spread": "How large it is, and how often runs fail",
    "indices": "Which parameters matter",
    "curves": "Over each parameter",
    "map": "Over the two parameters that matter most, and where runs fail",
}
NAMES = {
    "sobol": ("total index", "first-order index"),
    "morris": ("mu*", "sigma"),
    "lhs": ("rank correlation", ""),
    "montecarlo": ("rank correlation", ""),
}

ENOUGH = 20
"""Runs from which on there is a 5 % quantile, and a chance to fail worth a number."""


def write(work: Work, rows: pa.Table, found: Sequence[Answer], folder: Path) -> None:
    """Write report.html, figures/*.svg, rows.parquet and rows.csv.

    Raises:
        RecordError: If a file cannot be written.
    """
    study, drawn = work.study, _inline_figures(work, found)
    for name, picture in drawn.items():
        _write(folder / "figures" / f"{name}.svg", picture)
    table = labelled(work.labels, rows)
    write_whole(folder / "rows.parquet", lambda path: pq.write_table(table, path))
    write_whole(folder / "rows.csv", lambda path: pa_csv.write_csv(table, path))
    two = NAMES.get(study.method, ("", ""))
    page = render(
        "study/report.html.j2",
        title=study.title,
        good=any(answer.whole.failed < answer.whole.runs for answer in found),
        sentences=sentences(study, found),
        figures=drawn,
        headings=HEADINGS,
        metric=metric_label(study),
        grids=grids(study, found),
        compared=[compared(answer) for answer in found],
        indices=[row for answer in found for row in _indices(answer)],
        index_name=two[0],
        second_name=two[1],
        needed=needed(study, found),
        unit=LABELS[study.metrics[0]][1],
        endings=endings(work, rows),
        about=_about(work),
    )
    _write(folder / "report.html", page)


def document(work: Work, found: Sequence[Answer], path: Path) -> None:
    """Write the results as Markdown, and the figures beside it.

    Raises:
        RecordError: If a file cannot be written.
    """
    study = work.study
    lines = [f"# {study.title}", "", _about(work), ""]
    lines += [f"- {sentence}" for sentence in sentences(study, found)]
    for name, picture in _inline_figures(work, found).items():
        file = f"{path.stem}-{name}.svg"
        _write(path.with_name(file), picture)
        lines += ["", f"![{HEADINGS[name]}]({file})"]
    head = ("variant", f"median {metric_label(study)}", "5 %", "95 %", "runs", "failed", "chance")
    lines += ["", "| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    lines += ["| " + " | ".join(compared(answer)) + " |" for answer in found]
    _write(path, "\n".join(lines) + "\n")


def _inline_figures(work: Work, found: Sequence[Answer]) -> dict[str, Markup]:
    # every variant has the same points in the same order
    at = [task.point for task in work.tasks if task.variant == work.tasks[0].variant]
    drawn = figures(work.study, found, work.design[at])
    return {name: inline(figure) for name, figure in drawn.items()}


def _about(work: Work) -> str:
    study = work.study
    steps = " and ".join(f"{1000 * step:g}" for step in sorted(work.steps))
    return (
        f"Scenario {study.scenario} ({', '.join(study.set) or 'as it is'}), method {study.method}: "
        f"{len(work.design)} points, {study.seeds} seeds, {len(study.compared)} variants, "
        f"{len(work.tasks)} runs. Every variant had the same points and the same noise. "
        f"Physics step {steps} ms; docs/performance.md tells the error of 2 ms."
    )


def endings(work: Work, rows: pa.Table) -> list[str]:
    """How many runs failed in which way, with the reason of one of them."""
    counted: dict[tuple[str, str], list[str]] = {}
    columns = (rows["outcome"].to_pylist(), rows["reason"].to_pylist())
    for task, outcome, reason in zip(work.tasks, *columns, strict=True):
        if outcome != "finished":
            counted.setdefault((task.variant, outcome), []).append(reason)
    return [
        f"{variant}: {len(reasons)} {outcome}, as '{reasons[0]}'"
        for (variant, outcome), reasons in counted.items()
    ]


def _write(path: Path, text: str) -> None:
    write_whole(path, lambda target: target.write_text(text, encoding="utf-8"))


class Grid(NamedTuple):
    """A table of a metric over the values of a parameter, a column per variant.

    Attributes:
        title: The metric, and where the other parameters stand.
        headings: The parameter, then the variants.
        rows: Value and one cell per variant each.
    """

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def grids(study: Study, found: Sequence[Answer]) -> list[Grid]:
    """The medians of a study with curves: parameter by variant."""
    with_curves = [answer for answer in found if answer.curves]
    made = []
    for number, curve in enumerate(with_curves[0].curves if with_curves else ()):
        where = where_label(study, curve.where)
        columns = [answer.curves[number].spreads for answer in with_curves]
        rows = tuple(
            (str(value), *(_cell(spreads[at]) for spreads in columns))
            for at, value in enumerate(curve.values)
        )
        title = f"{metric_label(study)}{f' at {where}' if where else ''}, median"
        heads = (parameter_label(study, curve.key), *(answer.variant for answer in with_curves))
        made.append(Grid(title, heads, rows))
    return made


def _cell(spread: Spread) -> str:
    """A median, and how many runs it leaves out."""
    left_out = f" ({spread.failed} of {spread.runs} failed)" if spread.failed else ""
    return f"{_digits(spread.median)}{left_out}"


def compared(answer: Answer) -> tuple[str, ...]:
    """One row of the table of variants."""
    whole = answer.whole
    low, high = whole.chance
    few = whole.runs < ENOUGH
    return (
        answer.variant,
        _digits(whole.median),
        *("-" if few else _digits(value) for value in (whole.low, whole.high)),
        str(whole.runs),
        str(whole.failed),
        "too few runs" if few else f"{100 * low:.1f} to {100 * high:.1f} %",
    )


def _indices(answer: Answer) -> list[tuple[Any, ...]]:
    rows = []
    for index in answer.indices:
        value = _digits(index.value) if abs(index.value) >= NEGLIGIBLE else f"< {NEGLIGIBLE:g}"
        verdict = "matters" if abs(index.value) >= NEGLIGIBLE else "negligible"
        first = f"< {NEGLIGIBLE:g}" if index.first < NEGLIGIBLE else _digits(index.first)
        if not index.decided:
            value, first = "-", "-"
            verdict = "undecided: the interval holds zero"
        rows.append((index.key, answer.variant, value, _digits(index.half), first, verdict))
    return rows


def _digits(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.3g}"
