"""The command export: the signals of a run for other programs."""

from __future__ import annotations

from pathlib import Path

import click

from twin.cli import completion as tab
from twin.cli.output import console, warn
from twin.errors import RecordError


@click.command()
@click.argument("run", type=click.Path(path_type=Path), shell_complete=tab.runs)
@click.argument("file", type=click.Path(path_type=Path))
@click.option(
    "--every", type=click.IntRange(min=1), default=1, help="Take every N-th row only.", metavar="N"
)
@click.option("--columns", help="Columns to take, with commas between [all]; time comes first.")
def export(run: Path, file: Path, every: int, columns: str | None) -> int:
    """Export the signals of a run to a .csv, .mat or .parquet file."""
    from twin.errors import nearest
    from twin.run.files import check_no_scenario
    from twin.run.files import export as write
    from twin.run.finished import open_run

    check_no_scenario(run)
    (opened,) = open_run(run)
    if opened.lacking:
        warn(opened.lacking)
    names = list(opened.rows)
    if columns is not None:
        wanted = [name.strip() for name in columns.split(",")]
        for name in wanted:
            if name not in names:
                raise RecordError(f"--columns: no column '{name}'{nearest(name, names)}")
        names = list(dict.fromkeys(("time", *wanted)))
    write(file, {name: opened.rows[name][::every] for name in names}, opened.units)
    rows = len(opened.rows["time"][::every])
    console.print(f"written to {file}: {rows} rows of {len(names)} columns")
    return 0
