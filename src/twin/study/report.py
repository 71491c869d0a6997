"""What is written of a study: page, pictures, rows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

from twin.page import inline, render
from twin.record import write_whole
from twin.study.answers import Answer
from twin.study.design import points
from twin.study.figures import figures
from twin.study.schema import Study
from twin.study.work import Row, Task

HEADINGS = {
    "spread": "What comes of it",
    "indices": "Which parameters matter",
    "curves": "Over each parameter",
}
NAMES = {
    "sobol": ("total index", "first-order index"),
    "morris": ("mu*", "sigma"),
    "lhs": ("rank correlation", ""),
    "montecarlo": ("rank correlation", ""),
}


def write(
    study: Study, tasks: Sequence[Task], rows: dict[str, Row], found: Sequence[Answer], folder: Path
) -> None:
    """Write report.html, figures/*.svg, rows.parquet and rows.csv.

    Raises:
        RecordError: If a file cannot be written.
    """
    drawn = figures(study, found)
    for name, figure in drawn.items():
        text = str(inline(figure))
        write_whole(
            folder / "figures" / f"{name}.svg",
            lambda path, text=text: path.write_text(text, encoding="utf-8"),  # type: ignore[misc]
        )
    table = data(study, tasks, rows)
    write_whole(folder / "rows.parquet", lambda path: pq.write_table(table, path))
    write_whole(folder / "rows.csv", lambda path: pa_csv.write_csv(table, path))
    two = NAMES.get(study.method, ("", ""))
    page = render(
        "study/report.html.j2",
        title=study.title,
        good=any(answer.whole.failed < answer.whole.runs for answer in found),
        sentences=sentences(study, found),
        figures={name: inline(figure) for name, figure in drawn.items()},
        headings=HEADINGS,
        compared=[compared(answer) for answer in found],
        indices=[row for answer in found for row in _indices(answer)],
        index_name=two[0],
        second_name=two[1],
        needed=needed(study, found),
        about=(
            f"{study.scenario}, method {study.method}, {len(points(study))} points, "
            f"{study.seeds} seeds, {len(found)} variants: {len(tasks)} runs. Every variant had the "
            "same points and the same noise."
        ),
    )
    write_whole(folder / "report.html", lambda path: path.write_text(page, encoding="utf-8"))


def data(study: Study, tasks: Sequence[Task], rows: dict[str, Row]) -> pa.Table:
    """One row a run: variant, point, seed, parameters, outcome, metrics."""
    design = points(study)
    return pa.Table.from_pylist(
        [
            {
                "variant": task.variant,
                "point": task.point,
                "seed": task.seed,
                **{key: design[task.point].get(key) for key in study.parameters},
                **{name: value for name, value in rows[task.key].items() if name != "key"},
            }
            for task in tasks
        ]
    )


def sentences(study: Study, found: Sequence[Answer]) -> list[str]:
    """The answer in words."""
    metric, words = study.metrics[0], []
    ranked = sorted(
        (a for a in found if not math.isnan(a.whole.median)), key=lambda a: a.whole.median
    )
    if len(found) > 1 and ranked:
        order = ", ".join(f"{a.variant} ({a.whole.median:.3g})" for a in ranked)
        words.append(f"By median {metric}, best first: {order}.")
    for answer in found:
        strong = [i for i in answer.indices if i.decided]
        weak = [i.key for i in answer.indices if not i.decided]
        if answer.indices:
            of = f" for {answer.variant}" if len(found) > 1 else ""
            first = sorted(strong, key=lambda i: -abs(i.value))
            text = ", ".join(f"{i.key} ({i.value:.2g})" for i in first) or "none for certain"
            words.append(f"What matters to {metric}{of}: {text}.")
            if weak:
                words.append(f"Undecided with this sample{of}: {', '.join(weak)}.")
        failed = answer.whole.failed
        if failed:
            words.append(
                f"{answer.variant}: {failed} of {answer.whole.runs} runs did not end well; they "
                "are kept out of the averages."
            )
        words += [f"{answer.variant}: {note}." for note in answer.notes]
    words += needed(study, found)[:3]
    return words or ["All runs finished; see the curves."]


def needed(study: Study, found: Sequence[Answer]) -> list[str]:
    """How well each parameter must be known."""
    out = []
    for answer in found:
        for curve in answer.curves:
            if curve.needed is not None:
                unit = study.parameters[curve.key].unit
                out.append(
                    f"{answer.variant}: to predict {study.metrics[0]} within 1, "
                    f"{curve.key} must be known within {curve.needed:.2g} {unit}".strip()
                    + "."
                )
    return out


def compared(answer: Answer) -> tuple[str, ...]:
    """One row of the table of variants."""
    whole = answer.whole
    low, high = whole.chance
    return (
        answer.variant,
        *(_shown(value) for value in (whole.median, whole.low, whole.high)),
        str(whole.runs),
        str(whole.failed),
        f"{100 * low:.1f} to {100 * high:.1f} %",
    )


def _indices(answer: Answer) -> list[tuple[Any, ...]]:
    rows = []
    for index in answer.indices:
        value = _shown(index.value) if index.decided else "about 0"
        verdict = "matters" if index.decided else "undecided: the interval holds zero"
        first = _shown(index.first) if index.decided else "-"
        rows.append((index.key, answer.variant, value, _shown(index.half), first, verdict))
    return rows


def _shown(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.3g}"
