"""The page of a fit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from twin import page
from twin.fit.fit import FitResult, FittedParameter
from twin.page import Block, Picture, Table, Verdict, digits
from twin.run.picture import drawn
from twin.writing import write_json

HEADS = (
    "parameter",
    "value",
    "95 %, bootstrap over groups",
    "range without one group",
    "unit",
    "verdict",
)
CELLS = ("experiment", "indicator", "unit", "measured", "computed", "held out", "residual")
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


def row(each: FittedParameter) -> tuple[str, ...]:
    """A parameter as a row of the table: value, interval, range of the folds, verdict."""
    folds = "-" if each.fold_low is None else f"{digits(each.fold_low)} to {digits(each.fold_high)}"
    interval = f"{digits(each.low)} to {digits(each.high)}"
    return each.name, digits(each.value), interval, folds, each.unit, each.verdict


def write(found: FitResult, folder: Path) -> None:
    """Write report.html and fit.json.

    Raises:
        RecordError: If a file cannot be written.
    """
    numbers = found.as_dict()
    values = ("experiment", "indicator", "unit", "measured", "computed", "held_out")
    cells = [
        (*(digits(cell[key]) for key in values), f"{cell['residual']:+.2f}")
        for cell in numbers["cells"]
    ]
    names = list(found.table.parameters)
    related = [
        (name, *(f"{value:+.2f}" for value in line))
        for name, line in zip(names, found.correlation.tolist(), strict=True)
    ]
    good = any(each.verdict == "seen" for each in found.estimates)
    title = "Residuals: fitted to all, and fitted without the group that a number belongs to"
    note = (
        "As data: fit.json beside this page. A residual is computed less measured in standard "
        "uncertainties; of an indicator that a run does not have it is 10."
    )
    blocks: list[Block] = [
        Verdict(sentences(found), good),
        Table("Parameters", HEADS, [row(each) for each in found.estimates], words=(0, 4, 5)),
        Table("Correlation", ("", *names), related),
        Picture(title, _figure(found)),
        Table("Every measured number", CELLS, cells, words=(0, 1, 2), note=note),
    ]
    page.write(folder / "report.html", found.table.title, blocks)
    write_json(folder / "fit.json", numbers)


def _figure(found: FitResult) -> Figure:
    """Residuals of every indicator, fitted and held out."""
    with drawn(10, 3.6) as figure:
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
