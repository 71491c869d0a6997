"""The page of a fit."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from twin.fit.fit import Estimate, FitResult
from twin.html import inline, render
from twin.writing import write_json, write_whole

COLOURS = {"all": "#1f6fb4", "held out": "#e08214"}


def sentences(found: FitResult) -> list[str]:
    """What a fit says, in words."""
    table = found.table
    lines = [
        f"{len(found.cells)} measured numbers of {len(table.experiments)} experiments, "
        f"{len(table.parameters)} parameters: chi-squared {found.chi2:.1f}."
    ]
    lines += [
        f"{each.name}: {each.value:.4g} {each.unit}".rstrip()
        + f" ({each.low:.4g} to {each.high:.4g}), {each.verdict}."
        for each in found.estimates
    ]
    ends = [chi2 for chi2, _ in found.ends]
    if len(ends) > 1:
        lines.append(
            f"{len(ends)} searches with different random numbers ended at chi-squared "
            f"{', '.join(f'{chi2:.1f}' for chi2 in ends)}."
        )
    return lines


def row(each: Estimate) -> tuple[str, ...]:
    """A parameter as a row of the table: value, interval, range of the folds, verdict."""
    folds = "-" if each.fold_low is None else f"{digits(each.fold_low)} to {digits(each.fold_high)}"
    interval = f"{digits(each.low)} to {digits(each.high)}"
    return each.name, digits(each.value), interval, folds, each.unit, each.verdict


def digits(value: float | None) -> str:
    """A number in the digits worth reading."""
    return "-" if value is None or not np.isfinite(value) else f"{value:.4g}"


def write(found: FitResult, folder: Path) -> None:
    """Write report.html and fit.json.

    Raises:
        RecordError: If a file cannot be written.
    """
    cells = [
        (
            cell.label,
            cell.indicator,
            cell.unit,
            digits(cell.measured),
            digits(value),
            digits(held),
            f"{cell.residual(value):+.2f}",
        )
        for cell, value, held in zip(
            found.cells, found.computed.tolist(), found.held_out.tolist(), strict=True
        )
    ]
    names = list(found.table.parameters)
    page = render(
        "fit/report.html.j2",
        title=found.table.title,
        good=any(each.verdict == "seen" for each in found.estimates),
        sentences=sentences(found),
        parameters=[row(each) for each in found.estimates],
        figure=inline(_figure(found)),
        names=names,
        correlation=[
            (name, *(f"{value:+.2f}" for value in line))
            for name, line in zip(names, found.correlation.tolist(), strict=True)
        ],
        cells=cells,
    )
    write_whole(folder / "report.html", lambda path: path.write_text(page, encoding="utf-8"))
    write_json(folder / "fit.json", found.as_dict())


def _figure(found: FitResult) -> Figure:
    """Residuals of every indicator, fitted and held out."""
    with mpl.rc_context({"font.size": 9}):
        figure = Figure(figsize=(10, 3.6), layout="constrained")
        FigureCanvasAgg(figure)
        ax = figure.subplots()
        names = list(dict.fromkeys(cell.indicator for cell in found.cells))
        for offset, (label, values) in zip(
            (-0.12, 0.12), (("all", found.computed), ("held out", found.held_out)), strict=True
        ):
            if not np.isfinite(values).any():
                continue
            r = [c.residual(v) for c, v in zip(found.cells, values.tolist(), strict=True)]
            at = [names.index(cell.indicator) + offset for cell in found.cells]
            ax.plot(at, r, "o", ms=4, alpha=0.6, color=COLOURS[label], label=label)
        ax.axhspan(-2, 2, color="#eeeeee", zorder=0)
        ax.set_xticks(range(len(names)), names)
        ax.set_ylabel("residual [standard uncertainties]")
        ax.legend(frameon=False)
    return figure
