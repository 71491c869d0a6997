"""What the command reproduce does with chapter 9: fit, predict, test hypotheses, document."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from twin.cli.output import console, print_json, progress

if TYPE_CHECKING:
    from twin.thesis.experiments.predict import Prediction


def predict(tables: Sequence[str]) -> list[Prediction]:
    """Predict the tables of these numbers."""
    from twin.thesis.experiments.predict import rows

    with progress("predicting", 1.0) as advance:
        return rows(tables, advance)


def document(path: Path) -> int:
    """Fit, predict, try all hypotheses and write the document with its figure."""
    from twin.thesis.experiments import fit as fitting
    from twin.thesis.experiments.hypotheses import evaluated
    from twin.thesis.experiments.predict import rows
    from twin.thesis.experiments.report import write_doc

    with progress("fitting, predicting, trying hypotheses", 3.0) as advance:
        found = fitting.fits(advance)
        predicted = rows((), lambda share: advance(1 + share))
        tried = evaluated(lambda share: advance(2 + share))
    write_doc(path, predicted, found, tried)
    console.print(f"written to {path}")
    return 0


def fit(out: Path | None, *, as_json: bool) -> int:
    """Choose the reading, fit the friction to Table 9.3, print the result and write it if asked."""
    from twin.thesis.experiments import fit as fitting

    with progress("fitting", 1.0) as advance:
        result = fitting.fit(advance)
    if out is not None:
        fitting.write(result, out)
    if as_json:
        print_json(asdict(result))
    else:
        console.print(
            f"rolling friction {1000 * result.rolling:.4f} mm "
            f"({1000 * result.low:.4f} to {1000 * result.high:.4f}, 95 %), e_tt read as reference "
            f"minus {result.reading} from {result.start:g} s on; residuals "
            + " ".join(f"{r:+.2f}" for r in result.residual)
            + " points"
        )
    return 0


def show(predicted: list[Prediction], *, whole: bool) -> None:
    """Print the cells, thesis beside twin, and for the whole chapter the goals."""
    from rich.table import Table

    from twin.page import digits
    from twin.thesis.experiments.judge import UNITS
    from twin.thesis.experiments.predict import goals

    out = Table("table", "row", "quantity", "thesis", "predicted", "frictionless", "")
    for row in predicted:
        values = (digits(row[key]) for key in ("thesis", "predicted", "frictionless"))
        name = f"{row['column']} [{UNITS[row['column']]}]"
        mark = "fitted" if row["calibration"] else ""
        out.add_row(row["table"], row["row"], name.replace("[", r"\["), *values, mark)
    console.print(out)
    if whole:
        for goal in goals(predicted):
            verdict = "reached" if goal.reached else "not reached"
            console.print(f"{verdict}: {goal.sentence}: {goal.found}", markup=False)
