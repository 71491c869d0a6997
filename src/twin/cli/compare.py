"""The command compare: several scenarios, or variants of one, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ballplate.changes import changes_of
from twin.cli import completion as tab
from twin.cli.options import (
    ALL,
    JSON,
    LAW,
    PLANT,
    PROCESSES,
    SETTING,
    VARY,
    load_scenario,
    with_plant,
)
from twin.cli.output import console, print_json, print_metrics, print_reasons, warn
from twin.cli.terminal import Terminal
from twin.errors import ScenarioError
from twin.report.numbers import own_settings, ranking
from twin.shipped import find

if TYPE_CHECKING:
    from twin.run.finished import Run


@click.command()
@click.argument("sources", nargs=-1, required=True, shell_complete=tab.sources)
@LAW
@SETTING
@PLANT
@VARY
@click.option(
    "--out", type=click.Path(path_type=Path), help="Folder [runs/compare-SOURCES-CHANGES]."
)
@PROCESSES
@ALL
@JSON
def compare(
    sources: tuple[str, ...],
    overrides: tuple[str, ...],
    plant: str | None,
    vary: tuple[str, ...],
    out: Path | None,
    processes: int | None,
    *,
    everything: bool,
    as_json: bool,
) -> int:
    """Run several scenarios, or variants of one, side by side: one table, one picture.

    SOURCES are scenarios, finished runs (run folders, or `last`), and CSV logs, which are laid over
    what the twin predicts for the scenario beside them.
    """
    from twin.run.sources import sorted_out

    names, kept, logs = sorted_out(sources)
    changed = with_plant(overrides, plant)
    if vary and not names:
        raise ScenarioError("--vary: nothing to run; name a scenario, as in circle")
    for name in names:
        find(name)  # a wrong name is told before anything heavy is imported
    from ballplate.comparing import cases_of, side_by_side, title_of
    from ballplate.results import Result
    from twin.run.folders import run_folder
    from twin.run.log_run import distances
    from twin.run.replay import open_runs
    from twin.scenario.variants import parsed, varied

    opened = open_runs(kept, tell=warn) if kept else []
    measured, fitted = _measured(logs, names, opened, changed)
    finished = {run.name: Result.from_run(run) for run in (*measured, *opened)}
    over = parsed(vary)
    cases = cases_of(names, changes_of((*fitted, *changed), {}), over, alone=not finished)
    stem = f"compare-{'-'.join(map(_stem, (*names, *finished)))}"
    folder = out or run_folder(stem, (*varied(over), *changed))
    title = title_of(names, cases, finished, over, changed)
    found = side_by_side(cases, finished, title, folder, processes, Terminal())
    summaries = found.summaries()
    if as_json:
        print_json(summaries)
    else:
        console.print(title, style="bold", markup=False)
        shown = {found.headings[label]: each for label, each in summaries.items()}
        print_metrics(shown, everything=everything)
        print_reasons(shown)
        for line in own_settings({found.headings[each]: found[each] for each in finished}):
            console.print(line, markup=False)
        for line in (*distances(measured, found.motions), ranking(shown)):
            console.print(line, style="bold", markup=False)
        files = f"compare.png, compare.json{' and one folder per run' if found.folders else ''}"
        written = f"written to {folder}/{found.replaced}: {files}"
        console.print(written, markup=False, soft_wrap=True)
    early = (not found[label].finished for label in found.folders)
    return int(found.interrupted or any(early))


def _measured(
    logs: Sequence[Path], names: Sequence[str], finished: Sequence[Run], changed: Sequence[str]
) -> tuple[list[Run], list[str]]:
    """Logs as runs, and what their prediction is to be changed to."""
    from twin.run.log_run import fitting, log_run, read_log

    runs: list[Run] = []
    fitted: list[str] = []
    for path in logs:
        rows = read_log(path)
        if names:
            scenario = load_scenario(names[0], changed)
            fitted = fitted or fitting(rows, scenario)
            scenario = load_scenario(names[0], (*fitting(rows, scenario), *changed))
        elif finished:
            scenario = finished[0].scenario
        else:
            raise ScenarioError(
                f"{path}: a log has no reference; name the scenario it was recorded with, as in: "
                f"ballplate compare {path} circle"
            )
        taken = sum(run.name.partition("~")[0] == path.stem for run in runs)
        runs.append(log_run(rows, scenario, f"{path.stem}~{taken + 1}" if taken else path.stem))
    return runs, fitted


def _stem(name: str) -> str:
    return Path(name).stem if name.endswith(".toml") else Path(name).name
