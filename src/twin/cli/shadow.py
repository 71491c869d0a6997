"""The command shadow: the twin beside a recorded run."""

from __future__ import annotations

from pathlib import Path

import click

from twin.cli.options import JSON, SETTING
from twin.cli.output import console, print_json, progress
from twin.writing import check_writable

HORIZON = click.Choice(["0.5", "1", "2"])


@click.command()
@click.argument("log", type=click.Path(path_type=Path))
@SETTING
@click.option("--horizon", type=HORIZON, default="1", show_default=True, help="Seconds ahead.")
@click.option("--no-proposal", is_flag=True, help="Identify nothing, propose nothing.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder [RUN, or runs/shadow-LOG].")
@JSON
def shadow(
    log: Path,
    overrides: tuple[str, ...],
    horizon: str,
    out: Path | None,
    *,
    no_proposal: bool,
    as_json: bool,
) -> int:
    """Let the twin run beside a recorded run: is it still right, since when not, and why.

    LOG is a run folder, a run.parquet, or a CSV file with named columns and what was commanded.
    The twin is what the run was simulated with, or believed, changed by --set (parameters=FILE for
    identified ones). Writes shadow.html, shadow.json and shadow.parquet, and parameters-N.toml if
    another twin proves better. Exit code 1 after an alarm.
    """
    from twin.run.files import ROOT, is_record, log_file, run_name

    log = log_file(log)  # a wrong name is told before anything heavy is imported
    name = run_name(log)
    own = is_record(log)
    folder = out or (log.parent if own else ROOT / f"shadow-{name}")
    from twin.shadow.examine import FILES, examine

    check_writable(folder)
    with progress(f"the twin beside {name}", 1.0) as advance:
        examined = examine(
            log, folder, overrides, float(horizon), proposing=not no_proposal, progress=advance
        )
    if as_json:
        print_json(examined.numbers)
    else:
        for sentence in examined.sentences:
            console.print(sentence, markup=False)
        console.print(f"written to {folder}/: {FILES}")
    return int(bool(examined.found.alarms))
