"""The command compare: several scenarios, or variants of one, side by side."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import click

from twin.cli.one_run import WORTH_PROCESS, exit_code, warn_of_dangers, watched, with_plant
from twin.cli.options import (
    ALL,
    JSON,
    LAW,
    PLANT,
    PROCESSES,
    SETTING,
    check_writable,
    load_scenario,
)
from twin.cli.output import console, print_json, print_metrics, print_reasons, progress
from twin.errors import ScenarioError
from twin.report.numbers import ranking, summary_of

if TYPE_CHECKING:
    from twin.run.execute import Run
    from twin.run.replay import Replay
    from twin.scenario import Scenario


@click.command()
@click.argument("sources", nargs=-1, required=True)
@LAW
@SETTING
@PLANT
@click.option(
    "--vary",
    multiple=True,
    metavar="KEY=[A,B,...]",
    help="Run once for each value of a key; repeat the option for all combinations.",
)
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
        load_scenario(name, changed)
    from twin.run.folders import MANIFEST, forget, run_folder
    from twin.run.log_run import distances
    from twin.run.overview_plot import draw
    from twin.run.record import write_json
    from twin.run.replay import open_runs
    from twin.scenario.variants import comparison, varied

    finished = {run.name: run for run in (open_runs(kept) if kept else ())}
    measured, fitted = _measured(logs, names, list(finished.values()), changed)
    finished = measured | finished
    cases = _cases(names, (*fitted, *changed), vary, alone=not finished)
    listed = (*names, *finished)
    stem = f"compare-{'-'.join(map(_stem, listed))}"
    folder = out or run_folder(stem, (*varied(vary), *changed))
    check_writable(folder)
    replaced = forget(folder)
    runs, interrupted = _carried_out(cases, processes, folder)
    headings = {label: cases[label].heading for label in runs}
    motions = {label: run.motion for label, run in finished.items()}
    motions |= {headings[label]: done.motion for label, done in runs.items()}
    first, *_ = (*(case.scenario for case in cases.values()), *_scenarios(finished))
    what = ", ".join(listed) if finished or len(names) > 1 else first.title
    title = comparison(what, vary, changed)
    draw(folder / "compare.png", motions, title, first.rig.limits.area)
    summaries = {label: summary_of(run) for label, run in finished.items()}
    summaries |= {label: done.summary() for label, done in runs.items()}
    inner = [cases[label].folder for label in runs]
    write_json(folder / MANIFEST, {"folders": inner, "runs": summaries})
    if as_json:
        print_json(summaries)
    else:
        console.print(title, style="bold", markup=False)
        shown = {headings.get(label, label): each for label, each in summaries.items()}
        print_metrics(shown, everything=everything)
        print_reasons(shown)
        for line in (*distances(measured.values(), motions), ranking(shown)):
            console.print(line, style="bold", markup=False)
        files = f"compare.png, compare.json{' and one folder per run' if runs else ''}"
        console.print(f"written to {folder}/{replaced}: {files}", markup=False, soft_wrap=True)
    return max(interrupted, *(exit_code(done) for done in runs.values()), 0)


class Case(NamedTuple):
    """A run of a comparison: what is run, what the table calls it, where it is kept."""

    scenario: Scenario
    heading: str
    folder: str


def _cases(
    names: Sequence[str], changed: Sequence[str], vary: Sequence[str], *, alone: bool
) -> dict[str, Case]:
    """Label to case of every run."""
    from twin.run.folders import slug
    from twin.scenario.load import check, read, resolved, setting
    from twin.scenario.variants import variants

    cases: dict[str, Case] = {}
    base = [setting(text) for text in changed]
    for name in names:
        named = (name,) if len(names) > 1 or not vary or not alone else ()
        for variant in variants(vary):
            label, heading, folder = (
                " ".join(filter(None, (*named, text)))
                for text in (variant.label, variant.heading, variant.name)
            )
            scenario = check(*resolved(*read(name), [*base, *variant.settings]))
            cases[label] = Case(scenario, heading, slug(folder))
    return cases


def _carried_out(
    cases: Mapping[str, Case], processes: int | None, folder: Path
) -> tuple[dict[str, Run], bool]:
    """The runs, kept as they come, in the order of the cases; and whether Ctrl-C ended them."""
    from twin.run.execute import save

    runs: dict[str, Run] = {}
    interrupted = False
    try:
        scenarios = {label: case.scenario for label, case in cases.items()}
        for label, done in _runs(scenarios, processes):
            runs[label] = done
            save(done, folder / cases[label].folder, {label: done.motion})
    except KeyboardInterrupt:
        interrupted = True
        if not runs:
            raise
    return {label: runs[label] for label in cases if label in runs}, interrupted


def _scenarios(runs: Mapping[str, Replay]) -> list[Scenario]:
    return [run.scenario for run in runs.values()]


def _measured(
    logs: Sequence[Path], names: Sequence[str], finished: Sequence[Replay], changed: Sequence[str]
) -> tuple[dict[str, Replay], list[str]]:
    """Logs as runs, and what their prediction is to be changed to."""
    from twin.run.log_run import fitting, log_run, read_log

    runs: dict[str, Replay] = {}
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
        runs[path.stem] = log_run(rows, scenario, path.stem)
    return runs, fitted


def _stem(name: str) -> str:
    return Path(name).stem if name.endswith(".toml") else Path(name).name


def _runs(cases: dict[str, Scenario], processes: int | None) -> Iterator[tuple[str, Run]]:
    """Label and run of every case as they come, on as many processes as are worth it."""
    from twin.jobs import cores, results
    from twin.run.execute import run as run_scenario

    if not cases:
        return
    if processes is None:
        long = sum(case.duration for case in cases.values()) >= 2 * WORTH_PROCESS
        processes = cores() if long else 1
    if min(processes, len(cases)) == 1:
        for label, case in cases.items():
            done = watched(case, label)
            yield label, done
            if done.outcome.interrupted:
                return
        return
    for case in cases.values():
        warn_of_dangers(case)
    with progress("comparison", len(cases), "runs") as advance:
        found = results(run_scenario, cases.items(), min(processes, len(cases)))
        for number, (label, done) in enumerate(found, 1):
            advance(number)
            yield label, done
