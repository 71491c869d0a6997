"""The commands list, run, compare, sweep, describe and docs."""

from __future__ import annotations

import shlex
import webbrowser
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ballplate.changes import scenarios
from ballplate.running import CLEAN_LABEL
from ballplate.running import run as run_scenario
from twin.base.errors import LogError, ScenarioError, TwinError
from twin.base.shipped import model_path
from twin.cli import options
from twin.cli.output import (
    TERMINAL,
    Shown,
    bold,
    dim,
    indicators,
    list_written,
    reasons,
    say,
    show,
    show_titles,
)
from twin.run.files import free, run_folder

if TYPE_CHECKING:
    from twin.scenario.describe import Key
    from twin.shadow.follow import Shadow


@options.command("list", example="list")
@options.JSON_OPTION
def list_scenarios() -> None:
    """List the scenarios that can be run by name."""
    show_titles(scenarios())


@options.command(example="run circle --beside cure")
@options.SCENARIO()
@options.LAW_OPTION
@options.SETTING
@options.PLANT_OPTION
@options.BOARD_OPTION
@click.option("--out", type=options.PATH_TYPE, help="Run folder [runs/SCENARIO-CHANGES].")
@click.option(
    "--beside",
    multiple=True,
    metavar="SCENARIO",
    help="Run this one as well, simulated, for table and picture; may be repeated.",
)
@options.RIG_OPTION
@options.RESET_OPTION
@click.option(
    "--fault",
    "faults",
    multiple=True,
    metavar="'SECONDS LINE'",
    help="With --rig emulated: inject a fault at that time, such as '3.0 unplug' or "
    "'2 drop 0x080 0.1'; see ballplate emulate; repeatable.",
)
@click.option(
    "--trace",
    type=options.WRITABLE_FILE,
    help="With --rig: file for the frames of its CAN bus: .blf, or .log, .asc, .trc, .csv, .gz "
    "[trace.log in the run folder].",
)
@options.VIEWING
@options.ALL_OPTION
@options.JSON_OPTION
def run(
    scenario: str,
    overrides: tuple[str, ...],
    out: Path | None,
    beside: tuple[str, ...],
    rig: str | None,
    faults: tuple[str, ...],
    trace: Path | None,
    *,
    reset: bool,
    everything: bool,
    **watched: Any,
) -> int:
    """Run a scenario: a name shown by `ballplate list`, or a TOML file."""
    viewing = options.Viewing(**watched)
    from twin.run.opened import of_other_class
    from twin.scenario import load

    named = run_folder(scenario, (*overrides, *([] if rig is None else [f"rig={Path(rig).stem}"])))
    own = out is None and rig is None
    other = own and of_other_class(named, lambda: load(scenario, overrides))
    folder = out or (free(named) if other else named)
    done = run_scenario(
        scenario,
        overrides,
        beside=beside,
        out=folder,
        on=rig,
        reset=reset,
        faults=faults,
        trace=trace,
        watch=lambda chosen: viewing.of(chosen, folder),
        reporter=TERMINAL,
    )
    folder = done.folder or folder
    for line in options.describe_unused_files(done.scenario):
        TERMINAL.warn(line)
    examined = _examine_run(folder, learning=viewing.learn) if viewing.shadow else None
    model = done.baseline
    numbers = {**done.summary(), "verdict": done.verdict}
    numbers["baseline"] = None if model is None else model.summary()
    shown: list[Shown] = [bold(done.title)]
    shown += indicators(
        {n: each.summary() for n, each in done.shown.items()}, everything=everything
    )
    if other:
        shown.append(f"the law of the run in {named}/ was different: it stays")
    if model is not None:
        shown += reasons({CLEAN_LABEL: numbers["baseline"]})
        shown.append(
            f"{CLEAN_LABEL}: the same controller on the frictionless equations (5.9) it was "
            "designed on, without dead time, noise or mechanism"
        )
    shown.append(bold(done.verdict))
    files = list_written(folder, "picture.png", "metrics.json", "run.parquet")
    spoken = folder / "trace.log" if trace is None else trace
    if rig is not None and spoken.is_file():  # own hardware has no CAN bus
        shown.append(dim(f"the frames of the CAN bus: ballplate trace {spoken}"))
    if examined is not None:
        from twin.shadow.report import sentences

        numbers["shadow"] = examined.as_dict()
        shown += sentences(examined)
        files += ", shadow.html, shadow.json"
    follow = f"more: --all for every indicator; ballplate report {folder}, view {folder}"
    if not done.scenario.fault:
        changed = "".join(f" --set {shlex.quote(each)}" for each in overrides)
        follow += f", explain {scenario}{changed}"
    shown.append(dim(follow))
    show(numbers, shown, folder, files)
    viewing.keep()
    return int(not done.finished)


def _examine_run(folder: Path, *, learning: bool) -> Shadow | None:
    """The twin's verdict on the run as a whole: the same as `ballplate shadow RUN`."""
    from twin.shadow.report import examine

    try:
        with TERMINAL.progress("the twin on the whole run", 1.0):
            return examine(folder, folder, learning=learning)
    except LogError as error:
        TERMINAL.warn(f"{error}; the run itself is in {folder}/")
        return None


@options.command(example='compare circle --vary \'controller.kind=["afl", "lqr"]\'')
@click.argument("sources", nargs=-1, required=True, shell_complete=options.sources)
@options.LAW_OPTION
@options.SETTING
@options.PLANT_OPTION
@options.BOARD_OPTION
@options.WITH_OPTION
@options.VARY_OPTION
@click.option("--out", type=options.PATH_TYPE, help="Folder [runs/compare-SOURCES-CHANGES].")
@options.PROCESSES_OPTION
@options.COLUMNS
@options.ALL_OPTION
@options.JSON_OPTION
def compare(
    sources: tuple[str, ...],
    overrides: tuple[str, ...],
    vary: tuple[str, ...],
    variants: tuple[str, ...],
    out: Path | None,
    *,
    everything: bool,
    **how: Any,
) -> int:
    """Run several scenarios, or variants of one, side by side: one table, one picture.

    SOURCES are scenarios, finished runs (run folders, or `last`), and CSV logs. A log is drawn over
    the twin's prediction for the scenario given with it. --with runs the first scenario once for
    each name, with these changes, in its place: my PID, LQR and the cure are `compare circle cure
    --with PID=controller.kind=pid --with LQR=controller.kind=lqr`.
    """
    from ballplate.comparing import compare as compare_sources

    stems = (Path(name).stem if name.endswith(".toml") else Path(name).name for name in sources)
    named = run_folder(f"compare-{'-'.join(stems)}", (*variants, *vary, *overrides))
    found = compare_sources(
        *sources,
        variants=variants,
        vary=vary,
        settings=overrides,
        out=out or named,
        reporter=TERMINAL,
        **how,
    )
    from twin.run.logs import distances

    summaries = found.summaries()
    by_name = {found.names[label]: each for label, each in summaries.items()}
    measured = {label: found[label] for label in found.logs}
    shown = (
        bold(found.title),
        *indicators(by_name, everything=everything),
        *reasons(by_name),
        *map(bold, distances(measured, found.motions)),
    )
    assert found.folder is not None
    files = list_written(found.folder, "compare.png", "compare.json")
    files += " and one folder per run" if found.folders else ""
    show(summaries, shown, found.folder, files)
    early = (not found[label].finished for label in found.folders)
    return int(found.interrupted or any(early))


@options.command(example="sweep circle plant.friction.rolling_mm=0:0.5:6")
@options.SCENARIO()
@click.argument("values", metavar="KEY=FIRST:LAST:NUMBER", shell_complete=options.settings)
@options.LAW_OPTION
@options.SETTING
@options.PLANT_OPTION
@options.VARY_OPTION
@click.option("--out", type=options.PATH_TYPE, help="Folder [runs/sweep-...].")
@options.PROCESSES_OPTION
@options.JSON_OPTION
def sweep(
    scenario: str,
    values: str,
    overrides: tuple[str, ...],
    vary: tuple[str, ...],
    out: Path | None,
    processes: int | None,
) -> int:
    """Run a scenario over the values of a key: a table and a curve.

    KEY=0:0.5:6 takes 6 values from 0 to 0.5, KEY=[1, 2, 5] those of the list. --vary gives a
    curve for each value of a second key, as in controller.kind=[afl,lqr]. The indicators of the
    runs are written to sweep.csv.
    """
    from ballplate.changes import varied_of
    from ballplate.sweeps import sweep as run_sweep
    from twin.scenario.variations import swept

    name = TERMINAL.name_of("vary")
    (key, points), curves = swept(values), varied_of(vary, name)
    varied_of({key: points}, "sweep")
    if key in curves:
        raise ScenarioError(f"{name} {key}: is what the sweep varies; name another key")
    named = (values.replace(":", ".."), *vary, *overrides)
    folder = out or run_folder(f"sweep-{Path(scenario).stem}", named)
    done = run_sweep(
        scenario,
        {key: points, **curves},
        settings=overrides,
        out=folder,
        processes=processes,
        reporter=TERMINAL,
    )
    numbers = {"title": done.title, "key": key, "values": points, "runs": done.curves}
    for reason in dict.fromkeys(row["reason"] for row in done.rows if row["outcome"] == "failed"):
        TERMINAL.warn(reason)
    if any(row["outcome"] == "not run" for row in done.rows):
        TERMINAL.warn("interrupted: unfinished runs are not in the table")
    show(
        numbers,
        [bold(done.title), done.table()],
        folder,
        list_written(folder, "sweep.png", "sweep.csv"),
    )
    return int(not done.finished)


LISTED_KINDS = {"laws": "controller", "observers": "observer", "references": "reference"}
"""What lists all of a kind, and the table of a scenario that names one."""


@options.command(example="describe plant.friction", reads=True)
@click.argument("name", metavar="[KEY|TABLE|KIND]", required=False, shell_complete=options.names)
@options.LAW_OPTION
@options.JSON_OPTION
def describe(name: str | None) -> int:
    """Describe what a scenario may set: a key, a table, or a law, observer or reference.

    A word is searched in the names, then in the meanings. `laws`, `observers` and `references`
    list those there are, with one sentence each.
    """
    from twin.scenario.describe import about, find_keys
    from twin.scenario.schema import choices

    if name is not None and not name.strip():
        raise ScenarioError(f"nothing called '{name}'; `ballplate describe` lists every key")
    if table := LISTED_KINDS.get(name or ""):
        show_titles({kind: about(f"{table}.{kind}") for kind in choices(table)})
        return 0
    found = find_keys(name or "")
    sentence = about(name or "")
    shown: list[Shown] = [bold(sentence)] if sentence else []
    shown += [line for key in found for line in _lines(key)] or ["It has no settings."]
    if not name:
        shown.append("Settings of a law, observer or reference: ballplate describe NAME")
    show([key.as_dict() for key in found], shown)
    return 0


def _lines(key: Key) -> Iterator[Shown]:
    yield bold(f"{key.key} = {key.value} {key.unit}".rstrip())
    plant = key.plants and f"plant.kind={key.plants} only"
    more = ", ".join(filter(None, (key.kind, key.type, key.allowed, plant)))
    yield f"    {key.meaning.replace('``', '')} [{more}]"


@options.command(example="docs")
def docs() -> int:
    """Open the documentation in a browser, from this machine's disk."""
    index = model_path().parents[1] / "site" / "index.html"
    if not index.exists():
        where = "in a checkout of the project: uv run python docs/build.py"
        raise TwinError(f"docs: the pages have not been built here; {where}")
    webbrowser.open(index.as_uri())
    say(index.as_uri())
    return 0
