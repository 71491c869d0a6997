"""The command whatif: other futures from a moment of a run."""

from __future__ import annotations

from pathlib import Path

import click

from twin.cli.options import JSON
from twin.cli.output import console, print_json, print_metrics, say, warn
from twin.writing import check_writable

FURTHER = "A further future, 'KEY=VALUE; KEY=VALUE' over what --set changes; repeatable."


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--at", type=float, required=True, help="Moment from which it goes on, s.")
@click.option("--set", "settings", multiple=True, metavar="KEY=VALUE", help="Change a key.")
@click.option("--branch", "branches", multiple=True, metavar="'KEY=VALUE; ...'", help=FURTHER)
@click.option(
    "--for",
    "lasting",
    type=click.FloatRange(0.01, 3600),
    default=10.0,
    show_default=True,
    help="How long it goes on, s.",
)
@click.option("--scenario", help="What ran, for a log that does not say: a name or a TOML file.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder [runs/whatif-RUN].")
@JSON
def whatif(
    run: Path,
    at: float,
    settings: tuple[str, ...],
    branches: tuple[str, ...],
    lasting: float,
    scenario: str | None,
    out: Path | None,
    *,
    as_json: bool,
) -> int:
    """Simulate other futures from a moment of a run: what would have happened.

    RUN is a run folder or a CSV log. A simulated run is gone on with exactly, a real one from its
    estimated state. Without --set and --branch nothing is changed.
    """
    from twin.run.files import ROOT, log_file, run_name

    run = log_file(run)  # a wrong name is told before anything heavy is imported
    folder = out or ROOT / f"whatif-{run_name(run)}"
    from twin.jobs import SecondProcess, cores
    from twin.run.finished import load_drawing
    from twin.whatif.futures import agreement, branches_of, futures, moment_of, summary, write

    with SecondProcess(wanted=cores() > 1) as beside:
        beside.begin(load_drawing)
        moment = moment_of(run, at, scenario)
        found = futures(moment, lasting, branches_of(settings, branches))
        if any(each.run.interrupted for each in found):
            raise KeyboardInterrupt  # a future cut short is none
        check_writable(folder)
        write(moment, found, folder, beside)
    for note in moment.notes:
        warn(note)
    if as_json:
        print_json(summary(moment, found))
        return 0
    say(agreement(moment))
    print_metrics({each.label: each.run.metrics for each in found})
    for each in found:
        if each.max_difference is not None:
            apart = f"{1000 * each.max_difference:.3g} mm from the record at most"
            say(f"{each.label}: {apart}")
    console.print(
        f"written to {folder}/: picture.png, report.html and a run folder per branch for "
        f"`ballplate view {folder}` and `ballplate report {folder}`"
    )
    return 0
