"""The command identify: fit the twin to a recorded run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from twin.cli import completion as tab
from twin.cli.options import JSON
from twin.cli.output import console, print_json, print_table, progress, say
from twin.identify.parameters import CHOICES, DEFAULT, SHARE, chosen
from twin.writing import check_writable

if TYPE_CHECKING:
    from twin.identify.identify import Identification


ALL = f"Some of {', '.join(CHOICES)} [{','.join(DEFAULT)}]."


@click.command()
@click.argument("log", type=click.Path(path_type=Path), shell_complete=tab.runs)
@click.option("--parameters", "names", metavar="NAME,...", help=ALL)
@click.option(
    "--hold-out",
    type=click.FloatRange(0, 0.8),
    default=round(1 - SHARE, 2),
    show_default=True,
    help="Share of the log held out from the fit.",
)
@click.option("--out", type=click.Path(path_type=Path), help="Folder [runs/identify-LOG].")
@JSON
def identify(
    log: Path, names: str | None, hold_out: float, out: Path | None, *, as_json: bool
) -> int:
    """Fit friction, dead time, drives and level to a recorded run.

    LOG is a run folder, a run.parquet, or a CSV file with named columns, preferably recorded with
    the scenario `excite`. Writes report.html and parameters.toml; exit code 1 if no parameter can
    be identified.
    """
    from twin.run.files import ROOT, log_file, run_name

    wanted = chosen(names)
    log = log_file(log)  # a wrong name is told before anything heavy is imported
    folder = out or ROOT / f"identify-{run_name(log)}"
    from twin.identify.identify import identify as identify_log
    from twin.identify.log import read
    from twin.identify.report import write
    from twin.identify.verdict import IDENTIFIED

    recorded = read(log)
    check_writable(folder)
    with progress(f"identifying from {recorded.source}", 1.0) as advance:
        found = identify_log(recorded, wanted, 1 - hold_out, advance)
    write(found, folder)
    if as_json:
        print_json(found.as_dict())
    else:
        _show(found)
        console.print(f"written to {folder}/")
    return int(all(each.word != IDENTIFIED for each in found.verdicts))


def _show(found: Identification) -> None:
    from twin.identify.report import HEADS, rows, sentences

    print_table(HEADS, rows(found), right=slice(1, 3))
    say(*(f"{each.about.name}: {each.why}" for each in found.verdicts if each.why))
    say(*sentences(found), *(f"note: {note}" for note in found.notes))
