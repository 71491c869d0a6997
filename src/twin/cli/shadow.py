"""The command shadow: the twin beside a recorded run."""

from __future__ import annotations

from pathlib import Path

import click

from twin.cli.options import JSON, PROCESSES, SETTING
from twin.cli.output import console, print_json, progress
from twin.writing import check_writable

FAMILY = "uncertain"
"""The family of rigs from which the healthy ones of the matrix are drawn,"""
DRAWS = (1_801, 1_802)
"""and the draws: to work out the false-alarm rate, and to judge."""
HORIZON = click.Choice(["0.5", "1", "2"])


@click.command()
@click.argument("log", required=False, type=click.Path(path_type=Path))
@SETTING
@click.option("--horizon", type=HORIZON, default="1", show_default=True, help="Seconds ahead.")
@click.option("--no-proposal", is_flag=True, help="Identify nothing, propose nothing.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder [RUN, or runs/shadow-LOG].")
@click.option("--matrix", is_flag=True, help="Try it on simulated rigs, and say how good it is.")
@click.option(
    "--each",
    type=click.IntRange(min=2),
    default=60,
    show_default=True,
    help="With --matrix: rigs of each kind.",
)
@click.option(
    "--hours",
    type=click.FloatRange(min=0.1),
    default=24.0,
    show_default=True,
    help="With --matrix: of healthy running to judge on.",
)
@click.option("--doc", type=click.Path(path_type=Path), help="With --matrix: the page to write.")
@PROCESSES
@JSON
def shadow(
    log: Path | None,
    overrides: tuple[str, ...],
    horizon: str,
    out: Path | None,
    each: int,
    hours: float,
    doc: Path | None,
    processes: int | None,
    *,
    no_proposal: bool,
    matrix: bool,
    as_json: bool,
) -> int:
    """Let the twin run beside a recorded run: is it still right, since when not, and why.

    LOG is a run folder, a run.parquet, or a CSV file with named columns and what was commanded.
    The twin is what the run was simulated with, or believed, changed by --set (parameters=FILE for
    identified ones). Writes shadow.html, shadow.json and shadow.parquet, and parameters-N.toml if
    another twin proves better. Exit code 1 after an alarm.
    """
    if matrix:
        return _matrix(each, hours, doc, processes)
    if log is None:
        raise click.UsageError("give a run folder, a run.parquet or a CSV file, or --matrix")
    from twin.run.folders import ROOT, is_record, run_name
    from twin.run.sources import log_file

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


def _matrix(each: int, hours: float, doc: Path | None, processes: int | None) -> int:
    """Try the shadow on simulated rigs."""
    from twin.jobs import cores
    from twin.shadow.matrix import healthy_rigs, trials
    from twin.shadow.matrix_page import page
    from twin.study.family import drawn, read
    from twin.writing import write_whole

    command = f"ballplate shadow --matrix --each {each} --hours {hours:g}"
    if doc is not None:
        check_writable(doc.parent, "--doc")
        command += f" --doc {doc}"
    family = read(FAMILY)
    healthy = [
        [rig.point for rig in drawn(family, draw, count)]
        for draw, count in zip(DRAWS, healthy_rigs(hours), strict=True)
    ]
    with progress("rigs that something happens to, and healthy ones", 1.0) as advance:
        text = page(trials(each, healthy, processes or cores(), advance), command)
    if doc is None:
        console.print(text, markup=False)
    else:
        write_whole(doc, lambda path: path.write_text(text, encoding="utf-8"))
        console.print(f"written to {doc}")
    return 0
