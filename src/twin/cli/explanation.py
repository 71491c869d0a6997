"""What the command reproduce does with --explained: fit, compute the cells, document."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from twin.cli.experiments import predict
from twin.cli.output import console, print_json, progress

FOLDER = Path("runs") / "explained"
"""Where the runs of the fit are kept: an interrupted one goes on."""


def fit(processes: int | None, out: Path | None, *, as_json: bool) -> int:
    """Fit chapter 9, once whole and once without each table, and print the result."""
    from rich.table import Table

    from twin.fit.fit import fit as fit_table
    from twin.fit.report import row, sentences
    from twin.fit.report import write as write_report
    from twin.fit.runs import Runs
    from twin.study.executors import executors
    from twin.study.store import Store
    from twin.thesis.experiments import explained
    from twin.thesis.experiments.explanation import table

    about = table()
    store = Store(FOLDER)
    with executors(processes) as (executor, count), progress(about.title, 1.0) as advance:
        runs = Runs(about, store, executor=executor, processes=count)
        found = fit_table(about, runs, advance=advance)
    write_report(found, FOLDER)
    if out is not None:
        explained.write(found, out)
    if as_json:
        print_json(found.as_dict())
    else:
        shown_parameters = Table("parameter", "value", "95 %", "without one", "unit", "verdict")
        for each in found.estimates:
            shown_parameters.add_row(*row(each))
        console.print(shown_parameters)
        console.print(sentences(found)[0], markup=False)
        console.print(f"written to {FOLDER}/: report.html, fit.json")
    return 0


def show(tables: Sequence[str], *, as_json: bool, whole: bool) -> int:
    """Predict and explain the tables of these numbers; of the whole chapter, judge the goals."""
    from rich.table import Table

    from twin.page import digits
    from twin.thesis.experiments import explained
    from twin.thesis.experiments.judge import UNITS

    predicted = predict(tables)
    with progress("explaining", 1.0) as advance:
        cells = explained.rows(predicted, tables, advance=advance)
    if as_json:
        print_json(cells)
        return 0
    out = Table("table", "row", "quantity", "thesis", "predicted", "explained", "held out")
    for cell in cells:
        name = f"{cell['column']} [{UNITS[cell['column']]}]".replace("[", r"\[")
        values = (digits(cell[key]) for key in ("thesis", "predicted", "explained", "held_out"))
        out.add_row(cell["table"], cell["row"], name, *values)
    console.print(out)
    for goal in explained.goals(cells) if whole else ():
        verdict = "reached" if goal.reached else "not reached"
        console.print(f"{verdict}: {goal.sentence}: {goal.found}", markup=False)
    return 0


def document(path: Path) -> int:
    """Write the page of the explanation."""
    from twin.thesis.experiments import (
        deciding,
        explained,
        explained_page,
        ingredients,
        joint_friction,
    )

    predicted = predict(())
    with progress("explaining, leaving ingredients out", 3.0) as advance:
        cells = explained.rows(predicted, advance=advance)
        confirmed = explained.rows(
            predicted, mechanism=True, advance=lambda share: advance(1 + share)
        )
        variants = ingredients.evaluated(lambda share: advance(2 + share))
        starts = deciding.own_starts()
        outcomes = deciding.outcomes((("9.3", 0.75), ("9.7", 0.75), ("9.3", 0.5)))
    loops = joint_friction.loops()
    explained_page.write(path, cells, confirmed, variants, outcomes, starts, loops)
    console.print(f"written to {path}")
    return 0
