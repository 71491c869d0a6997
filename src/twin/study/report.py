"""The report of a study: its answers in sentences and figures."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from twin.base import page
from twin.base.data_file import read_toml
from twin.base.errors import plural
from twin.base.page import Block, Picture, Table, Text, Verdict, digits, inline
from twin.base.writing import write_whole
from twin.run.finished import versions
from twin.run.indicators import INDICATOR_UNITS
from twin.run.picture import literal, style, styled_figure
from twin.run.tables import INDICATOR_LABELS
from twin.study.answers import NEGLIGIBLE_INDEX, Answer, Curve, SensitivityIndex, Spread
from twin.study.experiments import label_rows
from twin.study.paired import PairedDifference, paired_differences
from twin.study.schema import Point, Study
from twin.study.work import Work

REPORT_WORDS = read_toml(Path(__file__).with_name("words.toml"))
"""Words for figures and indices."""
FAILED_COLOUR = "#B00000"
MAX_SCATTER_PANELS = 12
"""Parameters over each of which the metric is drawn."""
MIN_QUANTILE_RUNS = 20
"""Number of runs needed for a 5 % quantile and for a rate of failure."""


def drawn_figures(study: Study, found: Sequence[Answer]) -> list[str]:
    """Names of the figures that a study has by its method."""
    there = {
        "scatter": study.method in ("montecarlo", "lhs") and bool(_numeric_inputs(found)),
        "curves": any(answer.curves for answer in found),
        "indices": any(answer.indices for answer in found),
    }
    return [name for name, is_there in there.items() if is_there]


def figures(study: Study, found: Sequence[Answer]) -> dict[str, Figure]:
    """Figures by name: indices, curves, the metric over each parameter."""
    draw = {"scatter": _draw_scatter, "curves": _draw_curves, "indices": _draw_indices}
    return {name: draw[name](study, found) for name in drawn_figures(study, found)}


def metric_label(study: Study) -> str:
    """The first metric in words, with its unit."""
    words, unit = INDICATOR_LABELS[study.metrics[0]]
    unit = "m" if unit == "mm" else unit
    return f"{words} [{unit}]" if unit else words


def parameter_label(study: Study, key: str) -> str:
    """A parameter's key with its unit."""
    about = study.parameters[key]
    unit = "× nominal" if about.relative else about.unit
    return f"{key} [{unit}]" if unit else key


def where_label(study: Study, where: Point) -> str:
    """Values of some parameters in words."""
    return ", ".join(
        f"{key} = {value:g} {study.parameters[key].unit}".strip()
        if isinstance(value, float)
        else f"{key} = {value}"
        for key, value in where.items()
    )


def rank_parameters(study: Study, found: Sequence[Answer]) -> list[str]:
    """The parameters, the most influential first."""
    sizes = dict.fromkeys(study.parameters, 0.0)
    for answer in found:
        for index in answer.indices:
            sizes[index.key] += abs(index.value) if np.isfinite(index.value) else 0.0
    return sorted(sizes, key=lambda key: -sizes[key])


def _draw_indices(study: Study, found: Sequence[Answer]) -> Figure:
    keys = rank_parameters(study, found)
    height = 0.8 / len(found)
    with styled_figure(9, 1.3 + len(keys) * max(0.42, 0.17 * len(found))) as figure:
        panel = figure.subplots()
        for k, answer in enumerate(found):
            for index in answer.indices:
                at = keys.index(index.key) + (k - (len(found) - 1) / 2) * height
                _bar(panel, index, at, height * 0.9, style(k)["color"])
            panel.barh(0, 0, color=style(k)["color"], label=literal(answer.variant))
        panel.axvline(0, color="0.3", lw=0.8)
        panel.set(
            xlabel=f"{REPORT_WORDS['axis'][study.method]}; hollow: undecided",
            title=f"What the {INDICATOR_LABELS[study.metrics[0]][0]} depends on",
            yticks=range(len(keys)),
            yticklabels=keys,
        )
        panel.invert_yaxis()
        panel.grid(visible=False, axis="y")
        if len(found) > 1:
            figure.legend(loc="outside lower center", ncols=3, fontsize=8)
        return figure


def _bar(panel: Axes, index: SensitivityIndex, at: float, height: float, colour: str) -> None:
    reach = (index.value - index.half, index.value + index.half)
    panel.plot(reach, (at, at), color="0.2" if index.decided else colour, lw=1.2, zorder=3)
    if not (index.decided or index.negligible):  # no bar: its sign is unknown
        panel.plot(0, at, "o", mec=colour, mfc="white", ms=4)
        return
    panel.barh(at, index.value, height, color=colour, alpha=0.85)
    if 0 < index.first <= 1:
        panel.plot(2 * (index.first,), (at - height / 2, at + height / 2), color="black", lw=2)


def _draw_curves(study: Study, found: Sequence[Answer]) -> Figure:
    shown = found[0].curves
    with styled_figure(max(6.5, 3.9 * len(shown)), 5.0) as figure:
        panels = np.atleast_1d(figure.subplots(1, len(shown), sharey=True))
        for number, (panel, curve) in enumerate(zip(panels, shown, strict=True)):
            for k, answer in enumerate(found):
                if answer.curves:
                    label = literal(answer.variant) if number == 0 else None
                    _draw_curve(panel, answer.curves[number], label, k)
            panel.set(xlabel=literal(parameter_label(study, curve.key)))
            if curve.where:
                panel.set_title(literal(where_label(study, curve.where)), fontsize=9)
        # from 0 on, unless the metric can be negative
        least = min(0.0, *(float(np.nan_to_num(answer.values).min()) for answer in found))
        panels[0].set(ylabel=metric_label(study), ylim=(least, None))
        if any(s.failed for answer in found for curve in answer.curves for s in curve.spreads):
            panels[0].plot([], [], "x", color=FAILED_COLOUR, label="some or all runs failed")
        if len(panels[0].get_legend_handles_labels()[0]) > 1:
            figure.legend(loc="outside lower center", ncols=3, fontsize=8)
        return figure


def _numeric_inputs(found: Sequence[Answer]) -> list[str]:
    """The parameters that a metric can be drawn over, at most ``MAX_SCATTER_PANELS``."""
    keys = [
        key
        for key, values in found[0].inputs.items()
        if all(isinstance(value, int | float) for value in values.tolist())
    ]
    return keys[:MAX_SCATTER_PANELS]


def _draw_scatter(study: Study, found: Sequence[Answer]) -> Figure:
    """Each run of each variant over each parameter; failed runs on the axis."""
    keys = _numeric_inputs(found)
    columns = min(len(keys), 4)
    rows = math.ceil(len(keys) / columns)
    with styled_figure(max(6.5, 3.2 * columns), 0.6 + 2.9 * rows) as figure:
        panels = figure.subplots(rows, columns, sharey=True, squeeze=False)
        for panel in panels.ravel()[len(keys) :]:
            panel.remove()
        for number, (key, panel) in enumerate(zip(keys, panels.ravel(), strict=False)):
            for k, answer in enumerate(found):
                failed = ~np.isfinite(answer.values)
                x = answer.inputs[key].astype(float)
                label = None if number else literal(answer.variant)
                look = {"color": style(k)["color"], "s": 9, "alpha": 0.6, "linewidths": 0}
                panel.scatter(x[~failed], answer.values[~failed], label=label, **look)
                if failed.any():
                    foot = np.zeros(failed.sum())
                    panel.plot(x[failed], foot, "x", color=FAILED_COLOUR, ms=5, clip_on=False)
            panel.set(xlabel=literal(parameter_label(study, key)))
        for panel in panels[:, 0]:
            panel.set(ylabel=metric_label(study))
        if any(answer.whole.failed for answer in found):
            panels[0, 0].plot([], [], "x", color=FAILED_COLOUR, label="run failed")
        if len(panels[0, 0].get_legend_handles_labels()[0]) > 1:
            figure.legend(loc="outside lower center", ncols=4, fontsize=8)
        return figure


def _draw_curve(panel: Axes, curve: Curve, label: str | None, k: int) -> None:
    numeric = all(isinstance(value, int | float) for value in curve.values)
    x = np.array(curve.values if numeric else range(len(curve.values)), float)
    middle, low, high = (
        np.array([getattr(each, name) for each in curve.spreads])
        for name in ("median", "low", "high")
    )
    panel.plot(x, middle, marker="o", ms=3.5, lw=1.4, label=label, **style(k))
    if (high > low).any():
        panel.fill_between(x, low, high, color=style(k)["color"], alpha=0.15, lw=0)
    failed = np.array([each.failed > 0 for each in curve.spreads])
    # a point without finished runs has no median: it is shown on the axis
    if failed.any():
        foot = np.nan_to_num(middle[failed])
        panel.plot(x[failed], foot, "x", color=FAILED_COLOUR, ms=8, clip_on=False, zorder=5)
    if not numeric:
        panel.set_xticks(x, [str(value) for value in curve.values])


MAX_PAIRS = 45
"""Pairs that the report lists: those of the ten best variants or so."""
MAX_NAMED_VARIANTS = 5
"""Variants that a sentence ranks; of more, the table does."""


def sentences(study: Study, found: Sequence[Answer]) -> list[str]:
    """The results of a study in sentences.

    Args:
        study: What was asked.
        found: One answer per variant.
    """
    metric, words = metric_label(study), []
    best = [each for each in in_order(found) if not math.isnan(each.whole.median)]
    if len(found) > 1 and best:
        few = [f"{each.variant} {each.whole.median:.3g}" for each in best]
        few = few if len(few) <= MAX_NAMED_VARIANTS else [*few[:3], f"..., last {few[-1]}"]
        lost = any(each.whole.failed for each in found)
        how = "; a failed run is worse than any other" if lost else ""
        words.append(f"By the median of {metric}, best first{how}: {', '.join(few)}.")
    words += _importance(study, found, metric)
    for answer in found:
        whole = answer.whole
        if whole.failed:
            words.append(
                f"{answer.variant}: {whole.failed} of {plural(whole.runs, 'run')} did not finish; "
                "its median and quantiles leave them out."
            )
        words += [f"{answer.variant}: {note}." for note in answer.notes]
    return words or ["All runs finished; see the curves."]


def in_order(found: Sequence[Answer]) -> list[Answer]:
    """The variants by the median of all runs, failed ones as the worst; the best first."""
    return sorted(found, key=lambda each: np.median(np.nan_to_num(each.values, nan=math.inf)))


def _importance(study: Study, found: Sequence[Answer], metric: str) -> list[str]:
    """The parameters that matter, and to which variants; of one variant, how much."""
    one, names = len(found) == 1, dict[str, list[str]]()
    index_name = REPORT_WORDS["names"].get(study.method, ("",))[0]
    for answer in found:
        for index in sorted(answer.indices, key=lambda each: -abs(each.value)):
            own = names.setdefault(index.key, [])
            if index.matters:
                own.append(f"{index.value:.2g} ± {index.half:.1g}" if one else answer.variant)
    words = []
    for key, who in sorted(names.items(), key=lambda item: -len(item[1])):
        if who:
            variants = "all variants" if 1 < len(who) == len(found) else ", ".join(who)
            words.append(f"{key} affects {metric}{f': {index_name}' if one else ' of'} {variants}.")
    every = [index for answer in found for index in answer.indices if not names[index.key]]
    undecided = list(dict.fromkeys(index.key for index in every if not index.negligible))
    negligible = list(dict.fromkeys(index.key for index in every if index.key not in undecided))
    if negligible:
        words.append(f"Negligible, an index below {NEGLIGIBLE_INDEX:g}: {', '.join(negligible)}.")
    if undecided:
        words.append(f"Undecided with this sample: {', '.join(undecided)}.")
    return words


def with_units(study: Study, table: pa.Table) -> pa.Table:
    """Rows with a ``unit`` as metadata of each field, and the versions as metadata of the table."""

    def unit_of(name: str) -> str:
        if name in study.parameters:
            about = study.parameters[name]
            return "1" if about.relative else about.unit
        return INDICATOR_UNITS.get(name, "")

    fields = [each.with_metadata({"unit": unit_of(each.name)}) for each in table.schema]
    produced = {"ballplate": json.dumps({"versions": versions(), "title": study.title})}
    return pa.Table.from_arrays(table.columns, schema=pa.schema(fields, metadata=produced))


def write(
    work: Work, rows: pa.Table, found: Sequence[Answer], folder: Path, more: Sequence[Block] = ()
) -> None:
    """Write report.html, figures/*.svg, rows.parquet and rows.csv.

    Args:
        work: The runs.
        rows: A row per run.
        found: One answer per variant.
        folder: Where.
        more: Further blocks of the page.

    Raises:
        RecordError: If a file cannot be written.
    """
    study, pictures = work.study, inline_figures(work, found)
    for name, picture in pictures.items():
        write_whole(folder / "figures" / f"{name}.svg", picture)
    table = with_units(study, label_rows(work.labels, rows))
    write_whole(folder / "rows.parquet", lambda path: pq.write_table(table, path))
    write_whole(folder / "rows.csv", lambda path: pa_csv.write_csv(table, path))
    good = any(answer.whole.failed < answer.whole.runs for answer in found)
    blocks: list[Block] = [
        Verdict(sentences(study, found), good),
        compare_variants(study, found),
        *compare_pairs(study, found),
        *grids(study, found),
        *(Picture(REPORT_WORDS["figures"][name], picture) for name, picture in pictures.items()),
    ]
    ended = endings(work, rows)
    blocks += [Text(ended, "Runs that failed")] if ended else []
    ranks = [row for answer in found for row in _index_rows(answer)]
    if ranks:
        first, second = REPORT_WORDS["names"].get(study.method, ("", ""))
        heads = ("parameter", "variant", first, "± 95 %", second, "verdict")
        blocks.append(Table("Indices", heads, ranks, words=(0, 1, -1)))
    blocks += more
    drawn = ", figures/" if pictures else ""
    note = f"In the folder of this page, as data: rows.parquet, rows.csv{drawn}."
    blocks.append(Text([what_ran(work)], "The study", note))
    page.write(folder / "report.html", study.title, blocks)


def inline_figures(work: Work, found: Sequence[Answer]) -> dict[str, Markup]:
    """The figures of a study by name, to stand within a page."""
    return {name: inline(figure) for name, figure in figures(work.study, found).items()}


ENGINE_SENTENCES = {
    "python": "",
    "c": " Rigs and controllers were simulated in compiled C (engine = c).",
}
"""What a report adds on the engine of a study."""


def what_ran(work: Work) -> str:
    """Description of the runs."""
    study = work.study
    steps = " and ".join(f"{1000 * step:g}" for step in sorted(work.steps))
    seeds, variants = study.seeds, len(study.compared)
    alike = "Every variant had the same points and the same noise. " if variants > 1 else ""
    return (
        f"Scenario {study.scenario} ({', '.join(study.set) or 'as it is'}), method {study.method}: "
        f"{plural(len(work.design), 'point')}, {plural(seeds, 'seed')}, "
        f"{plural(variants, 'variant')}, {plural(len(work.tasks), 'run')}. "
        f"{alike}Physics step {steps} ms; docs/performance.md has the error of 2 ms."
        f"{ENGINE_SENTENCES[study.engine]}"
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


def grids(study: Study, found: Sequence[Answer]) -> list[Table]:
    """The medians of a study with curves: a row per variant, a column per value of a parameter."""
    with_curves = [answer for answer in found if answer.curves]
    made = []
    for number, curve in enumerate(with_curves[0].curves if with_curves else ()):
        where = where_label(study, curve.where)
        rows = [
            (answer.variant, *map(_cell, answer.curves[number].spreads)) for answer in with_curves
        ]
        over = f"median over {parameter_label(study, curve.key)}"
        title = f"{metric_label(study)}, {over}{f', at {where}' if where else ''}"
        made.append(Table(title, ("variant", *map(digits, curve.values)), rows))
    return made


def _cell(spread: Spread) -> str:
    """A median, and how many runs it leaves out."""
    left_out = f" ({spread.failed} of {spread.runs} failed)" if spread.failed else ""
    return f"{digits(spread.median, places=3)}{left_out}"


def compare_variants(study: Study, found: Sequence[Answer]) -> Table:
    """A row per variant, the best first."""
    rows = []
    for whole, variant in ((answer.whole, answer.variant) for answer in in_order(found)):
        few = whole.runs < MIN_QUANTILE_RUNS
        low, high = whole.chance
        chance = "too few runs" if few else f"{100 * low:.1f} to {100 * high:.1f} %"
        most = (None, None) if few else (whole.low, whole.high)
        numbers = (digits(each, places=3) for each in (whole.median, *most))
        rows.append((variant, *numbers, str(whole.runs), str(whole.failed), chance))
    metric = metric_label(study)
    heads = (
        "variant",
        f"median {metric}",
        "5 %",
        "95 %",
        "runs",
        "failed",
        "probability to fail, 95 %",
    )
    return Table("Compared, best first" if len(found) > 1 else "In all", heads, rows)


def pairs_of(study: Study, found: Sequence[Answer]) -> list[PairedDifference]:
    """The difference of the metric between every two variants, the best first."""
    values = [(each.variant, each.values) for each in in_order(found)]
    if len(values) < 2:
        return []
    return list(
        paired_differences(values, found[0].points, study.method, len(study.parameters) + 2)
    )


def compare_pairs(study: Study, found: Sequence[Answer]) -> list[Table]:
    """A row per pair of variants that met the same points and noises; no table of one variant."""
    rows = []
    for pair in pairs_of(study, found)[:MAX_PAIRS]:
        runs = pair.better + pair.worse
        half = "-" if math.isnan(pair.half) else digits(pair.half, places=2)
        rows.append(
            (
                f"{pair.first} minus {pair.second}",
                digits(pair.mean, places=3),
                half,
                f"{pair.better} of {runs}",
                str(pair.both_failed),
            )
        )
    heads = ("pair", f"{metric_label(study)}, mean", "± 95 %", "better on", "both failed")
    return [Table("Pair by pair, the same points and noises", heads, rows)] if rows else []


def _index_rows(answer: Answer) -> list[tuple[Any, ...]]:
    rows = []
    for index in answer.indices:
        value = (
            digits(index.value, places=3)
            if abs(index.value) >= NEGLIGIBLE_INDEX
            else f"< {NEGLIGIBLE_INDEX:g}"
        )
        first = (
            f"< {NEGLIGIBLE_INDEX:g}"
            if index.first < NEGLIGIBLE_INDEX
            else digits(index.first, places=3)
        )
        verdict = "matters" if index.matters else "negligible"
        if not (index.matters or index.negligible):
            value, first = "-", "-"
            verdict = "undecided: the interval holds values that are negligible and others"
        rows.append(
            (index.key, answer.variant, value, digits(index.half, places=3), first, verdict)
        )
    return rows
