"""The command experiments: fit the friction to Table 9.3, predict Tables 9.1 to 9.9, tell why."""

from __future__ import annotations

from dataclasses import asdict
from importlib.resources import files
from pathlib import Path

import click
from rich.table import Table

from twin.cli.output import console, print_json, progress, shown
from twin.cli.scenarios import JSON, check_writable
from twin.experiments import fit as fitting
from twin.experiments.goals import goals
from twin.experiments.hypotheses import effects
from twin.experiments.judge import UNITS
from twin.experiments.predict import Row, rows
from twin.experiments.report import write_doc


@click.command()
@click.argument("tables", nargs=-1, metavar="[TABLE]...")
@click.option("--fit", is_flag=True, help="Choose the reading and fit the friction to Table 9.3.")
@click.option("--keep", is_flag=True, help="With --fit: predict with the result from now on.")
@click.option(
    "--doc",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Fit, predict, try all hypotheses and write this Markdown file with its figure.",
)
@JSON
def experiments(
    tables: tuple[str, ...], doc: Path | None, *, fit: bool, keep: bool, as_json: bool
) -> int:
    """Predict what the thesis measured on the rig, Tables 9.1 to 9.9.

    TABLE is a table's number such as 9.4; without one, all of them are predicted.
    """
    if doc is not None:
        check_writable(doc.parent)
        with progress("fitting, predicting, trying hypotheses", 3.0) as advance:
            found = fitting.fits(advance)
            predicted = rows((), lambda share: advance(1 + share))
            tried = effects(lambda share: advance(2 + share))
        write_doc(doc, predicted, found, tried)
        console.print(f"written to {doc}")
        return 0
    if fit:
        with progress("fitting", 1.0) as advance:
            result = fitting.fit(advance)
        if keep:
            fitting.write(result, Path(str(files(fitting.__package__) / "data/identified.toml")))
        return _tell(result, as_json=as_json)
    with progress("predicting", 1.0) as advance:
        predicted = rows(tables, advance)
    if as_json:
        print_json(predicted)
    else:
        show(predicted)
        if not tables:
            for goal in goals(predicted):
                verdict = "reached" if goal.reached else "not reached"
                console.print(f"{verdict}: {goal.sentence}: {goal.found}", markup=False)
    return 0


def show(predicted: list[Row]) -> None:
    """Print the cells, thesis beside twin."""
    out = Table("table", "row", "quantity", "thesis", "predicted", "frictionless", "")
    for row in predicted:
        values = (shown(row[key], "") for key in ("thesis", "predicted", "frictionless"))
        name = f"{row['column']} [{UNITS[row['column']]}]"
        mark = "fitted" if row["calibration"] else ""
        out.add_row(row["table"], row["row"], name.replace("[", r"\["), *values, mark)
    console.print(out)


def _tell(result: fitting.Fit, *, as_json: bool) -> int:
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
