"""What is written of a study: page, pictures, rows, and a summary for the documentation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq
from markupsafe import Markup

from twin.page import inline, render
from twin.record import write_whole
from twin.study.answers import Answer
from twin.study.design import Point, points
from twin.study.figures import figures, metric_label, where_label
from twin.study.schema import Study
from twin.study.work import Row, Task

HEADINGS = {
    "spread": "How large it is, and how often runs fail",
    "indices": "Which parameters matter",
    "curves": "Over each parameter",
    "map": "Over the two parameters that matter most, and where runs fail",
}
NEGLIGIBLE = 0.01
"""Index below which a parameter is said not to matter."""
ROUGH = 0.2
"""Half-width of an interval from which on the sample is said to be small."""
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
    drawn = _drawn(study, tasks, found)
    for name, picture in drawn.items():
        _write(folder / "figures" / f"{name}.svg", picture)
    table = data(study, tasks, rows)
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
        compared=[compared(answer) for answer in found],
        indices=[row for answer in found for row in _indices(answer)],
        index_name=two[0],
        second_name=two[1],
        needed=needed(study, found),
        endings=endings(tasks, rows),
        about=_about(study, tasks),
    )
    _write(folder / "report.html", page)


def document(study: Study, tasks: Sequence[Task], found: Sequence[Answer], path: Path) -> None:
    """Write the answer as Markdown, and its pictures beside it.

    Raises:
        RecordError: If a file cannot be written.
    """
    lines = [f"# {study.title}", "", _about(study, tasks), ""]
    lines += [f"- {sentence}" for sentence in sentences(study, found)]
    for name, picture in _drawn(study, tasks, found).items():
        file = f"{path.stem}-{name}.svg"
        _write(path.with_name(file), picture)
        lines += ["", f"![{HEADINGS[name]}]({file})"]
    head = ("variant", f"median {metric_label(study)}", "5 %", "95 %", "runs", "failed", "chance")
    lines += ["", "| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    lines += ["| " + " | ".join(compared(answer)) + " |" for answer in found]
    _write(path, "\n".join(lines) + "\n")


def _drawn(study: Study, tasks: Sequence[Task], found: Sequence[Answer]) -> dict[str, Markup]:
    every = points(study)
    design = [every[task.point] for task in tasks if task.variant == tasks[0].variant]
    return {name: inline(figure) for name, figure in figures(study, found, design).items()}


def _about(study: Study, tasks: Sequence[Task]) -> str:
    return (
        f"Scenario {study.scenario} ({', '.join(study.set) or 'as it is'}), method {study.method}: "
        f"{len(points(study))} points, {study.seeds} seeds, {len(study.compared)} variants, "
        f"{len(tasks)} runs. Every variant had the same points and the same noise."
    )


def endings(tasks: Sequence[Task], rows: dict[str, Row]) -> list[str]:
    """How the runs that failed ended, and for an example why."""
    failed = [(task.variant, rows[task.key]) for task in tasks]
    counted: dict[tuple[str, str], list[str]] = {}
    for variant, row in failed:
        if row["outcome"] != "finished":
            counted.setdefault((variant, row["outcome"]), []).append(row["reason"])
    return [
        f"{variant}: {len(reasons)} {outcome}, as '{reasons[0]}'"
        for (variant, outcome), reasons in counted.items()
    ]


def _write(path: Path, text: str) -> None:
    write_whole(path, lambda target: target.write_text(text, encoding="utf-8"))


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
    metric, words = metric_label(study), []
    best = sorted(
        (a for a in found if not math.isnan(a.whole.median)), key=lambda a: a.whole.median
    )
    if len(found) > 1 and best:
        order = ", ".join(f"{a.variant} {a.whole.median:.3g}" for a in best)
        words.append(f"By the median of {metric}, best first: {order}.")
    if len(found) > 1:
        words += _agreed(found, metric)
    for answer in found:
        if len(found) == 1:
            words += _importance(answer, metric)
        if answer.whole.failed:
            words.append(
                f"{answer.variant}: {answer.whole.failed} of {answer.whole.runs} runs did not end "
                "well; they are kept out of the averages."
            )
        words += [f"{answer.variant}: {note}." for note in answer.notes]
    return (words + needed(study, found)[:4]) or ["All runs finished; see the curves."]


def _agreed(found: Sequence[Answer], metric: str) -> list[str]:
    """What the indices of several variants say together."""
    names: dict[str, list[str]] = {}
    for answer in found:
        for index in answer.indices:
            names.setdefault(index.key, [])
            if index.decided and abs(index.value) >= NEGLIGIBLE:
                names[index.key].append(answer.variant)
    words = []
    for key, who in sorted(names.items(), key=lambda item: -len(item[1])):
        if who:
            all_ = "all variants" if len(who) == len(found) else ", ".join(who)
            words.append(f"{key} matters to {metric} for {all_}.")
    open_ = [key for key, who in names.items() if not who]
    if open_:
        words.append(f"Undecided with this sample for all variants: {', '.join(open_)}.")
    return words


def _importance(answer: Answer, metric: str) -> list[str]:
    if not answer.indices:
        return []
    sure = sorted((i for i in answer.indices if i.decided), key=lambda i: -abs(i.value))
    strong = [i for i in sure if abs(i.value) >= NEGLIGIBLE]
    weak = [i.key for i in sure if abs(i.value) < NEGLIGIBLE]
    open_ = [i.key for i in answer.indices if not i.decided]
    text = ", ".join(f"{i.key} ({i.value:.2g} ± {i.half:.1g})" for i in strong)
    words = [f"What matters to {metric}: {text or 'nothing for certain'}."]
    if weak:
        words.append(f"Negligible (below {NEGLIGIBLE:g}): {', '.join(weak)}.")
    if open_:
        words.append(f"Undecided with this sample: {', '.join(open_)}.")
    if any(i.half > ROUGH for i in strong):
        words.append(f"The sample is small: intervals wider than ± {ROUGH:g}; take more samples.")
    return words


def needed(study: Study, found: Sequence[Answer]) -> list[str]:
    """How well each parameter must be known."""
    out = []
    for answer in found:
        known: list[tuple[str, Point, float | None]] = [
            (index.key, {}, index.needed) for index in answer.indices
        ]
        known += [(curve.key, curve.where, curve.needed) for curve in answer.curves]
        for key, where, reach in known:
            if reach is None:
                continue
            unit = "of nominal" if study.parameters[key].relative else study.parameters[key].unit
            at = f" at {where_label(study, where)}" if where else ""
            out.append(
                f"{answer.variant}{at}: to predict {metric_label(study)} within 1, {key} must be "
                f"known within {reach:.2g} {unit}".strip()
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
        value = _shown(index.value) if index.decided else "-"
        verdict = "matters" if abs(index.value) >= NEGLIGIBLE else "negligible"
        if not index.decided:
            verdict = "undecided: the interval holds zero"
        first = _shown(index.first) if index.decided else "-"
        rows.append((index.key, answer.variant, value, _shown(index.half), first, verdict))
    return rows


def _shown(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.3g}"
