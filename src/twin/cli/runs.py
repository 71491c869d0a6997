"""The commands list, run, compare and sweep."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ballplate.changes import scenarios
from ballplate.running import CLEAN
from ballplate.running import run as run_scenario
from twin.cli import options
from twin.cli.output import TERMINAL, Shown, bold, dim, indicators, reasons, show, show_titles
from twin.errors import LogError
from twin.page import Table, digits
from twin.report.numbers import FIRST, LABELS, own_settings, ranking
from twin.run.files import former, free, run_folder

if TYPE_CHECKING:
    from ballplate.studies import Sweep
    from twin.shadow.follow import Shadow


@options.command("list", example="list")
@options.JSON
def list_scenarios() -> None:
    """List the scenarios that can be run by name."""
    show_titles(scenarios())


@options.command(example="run circle --beside cure")
@options.SCENARIO()
@options.LAW
@options.SETTING
@options.PLANT
@click.option("--out", type=options.PATH, help="Run folder [runs/SCENARIO-CHANGES].")
@click.option(
    "--beside",
    multiple=True,
    metavar="SCENARIO",
    help="Run this one as well, simulated, for table and picture; may be repeated.",
)
@options.RIG
@options.RESET
@click.option(
    "--trace",
    type=options.PATH,
    help="Of a rig: keep what is said on its CAN bus there; .log, .asc, .blf, .trc, .csv, also .gz "
    "[trace.log in the run folder].",
)
@options.VIEWING
@options.ALL
@options.JSON
def run(
    scenario: str,
    overrides: tuple[str, ...],
    out: Path | None,
    beside: tuple[str, ...],
    rig: str | None,
    trace: Path | None,
    *,
    reset: bool,
    everything: bool,
    **watched: Any,
) -> int:
    """Run a scenario: a name shown by `ballplate list`, or a TOML file."""
    viewing = options.Viewing(**watched)
    from twin.run.finished import of_other_class
    from twin.scenario import load

    named = run_folder(scenario, (*overrides, *([] if rig is None else [f"rig={Path(rig).stem}"])))
    own = out is None and rig is None
    other = own and of_other_class(named, lambda: load(scenario, overrides))
    folder = out or (free(named) if other or rig is not None else named)
    replaced, named_out = former(folder), folder
    replaced += f" (the law of the run in {named}/ was another: it stays)" if other else ""
    done = run_scenario(
        scenario,
        overrides,
        beside=beside,
        out=folder,
        on=rig,
        reset=reset,
        trace=trace,
        watch=lambda chosen: viewing.of(chosen, folder),
        reporter=TERMINAL,
    )
    if done.folder != folder and done.folder is not None:
        folder = done.folder
        replaced = f" ({named_out}/ keeps its finished run)"
    examined = _examined(folder) if viewing.shadow else None
    model = done.baseline
    numbers = {**done.summary(), "verdict": done.verdict}
    numbers["baseline"] = None if model is None else model.summary()
    shown: list[Shown] = [bold(done.title)]
    shown += indicators(
        {n: each.summary() for n, each in done.shown.items()}, everything=everything
    )
    if model is not None:
        shown += reasons({CLEAN: numbers["baseline"]})
        shown.append(
            f"{CLEAN}: the same controller on the frictionless exact equations it was designed on, "
            "without dead time, noise or mechanism"
        )
    shown.append(bold(done.verdict))
    files = "picture.png, metrics.json, run.parquet"
    spoken = folder / "trace.log" if trace is None else trace
    if rig is not None and spoken.is_file():  # own hardware has no CAN bus
        shown.append(dim(f"what was said on the CAN bus: ballplate trace {spoken}"))
    if examined is not None:
        from twin.shadow.report import advice

        numbers["shadow"] = examined.as_dict()
        shown += advice(examined)
        files += ", shadow.html, shadow.json, shadow.parquet"
    shown.append(
        dim(f"more: --all for every indicator; ballplate report, view, explain {scenario}")
    )
    show(numbers, shown, folder, files, replaced)
    viewing.keep(folder)
    return int(not done.finished)


def _examined(folder: Path) -> Shadow | None:
    """What the twin says of the run as a whole: the same as `ballplate shadow RUN`."""
    from twin.shadow.report import examine

    try:
        with TERMINAL.progress("the twin beside the whole run", 1.0) as advance:
            return examine(folder, folder, progress=advance)
    except LogError as error:
        TERMINAL.warn(f"{error}; the run itself is in {folder}/")
        return None


@options.command(example='compare circle --vary \'controller.kind=["afl", "lqr"]\'')
@click.argument("sources", nargs=-1, required=True, shell_complete=options.sources)
@options.LAW
@options.SETTING
@options.PLANT
@options.VARY
@click.option("--out", type=options.PATH, help="Folder [runs/compare-SOURCES-CHANGES].")
@options.PROCESSES
@options.ALL
@options.JSON
def compare(
    sources: tuple[str, ...],
    overrides: tuple[str, ...],
    vary: tuple[str, ...],
    out: Path | None,
    processes: int | None,
    *,
    everything: bool,
) -> int:
    """Run several scenarios, or variants of one, side by side: one table, one picture.

    SOURCES are scenarios, finished runs (run folders, or `last`), and CSV logs, which are laid over
    what the twin predicts for the scenario beside them.
    """
    from ballplate.comparing import compare as compare_sources

    def folder_of(names: Sequence[str]) -> Path:
        from twin.scenario.load import parsed, varied

        stems = (Path(name).stem if name.endswith(".toml") else Path(name).name for name in names)
        return run_folder(f"compare-{'-'.join(stems)}", (*varied(parsed(vary)), *overrides))

    found = compare_sources(
        *sources,
        vary=vary,
        settings=overrides,
        out=out or folder_of,
        processes=processes,
        reporter=TERMINAL,
    )
    from twin.run.logs import distances

    summaries = found.summaries()
    by_heading = {found.headings[label]: each for label, each in summaries.items()}
    finished = [label for label in found if label not in found.folders]
    measured = {label: found[label] for label in found.logs}
    shown = (
        bold(found.title),
        *indicators(by_heading, everything=everything),
        *reasons(by_heading),
        *own_settings({found.headings[each]: found[each] for each in finished}),
        *map(bold, (*distances(measured, found.motions), ranking(by_heading))),
    )
    files = f"compare.png, compare.json{' and one folder per run' if found.folders else ''}"
    show(summaries, shown, found.folder, files, found.replaced)
    early = (not found[label].finished for label in found.folders)
    return int(found.interrupted or any(early))


@options.command(example="sweep circle plant.friction.rolling_mm=0:0.5:6")
@options.SCENARIO()
@click.argument("values", metavar="KEY=FIRST:LAST:NUMBER", shell_complete=options.settings)
@options.LAW
@options.SETTING
@options.PLANT
@options.VARY
@click.option("--out", type=options.PATH, help="Folder [runs/sweep-...].")
@options.PROCESSES
@options.JSON
def sweep(
    scenario: str,
    values: str,
    overrides: tuple[str, ...],
    vary: tuple[str, ...],
    out: Path | None,
    processes: int | None,
) -> int:
    """Run a scenario over the values of a key: a table and a curve.

    KEY=0:0.5:6 takes 6 values from 0 to 0.5, KEY=[1, 2, 5] those of the list. --vary gives a curve
    for each value of another key, as in controller.kind=[afl,lqr]. Of the runs the indicators are
    kept, in sweep.csv.
    """
    from ballplate.studies import sweep as run_sweep
    from twin.scenario.load import parsed, swept, varied

    (key, points), curves = swept(values), parsed(vary)
    named = (values.replace(":", ".."), *varied(curves), *overrides)
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
    show(numbers, _table(done), folder, "sweep.png, sweep.csv")
    return int(not done.finished)


def _table(done: Sweep) -> Iterator[Shown]:
    """The first indicator that applies of every curve, or all of the only one.

    For whom it is printed, why runs failed is told beside it, each reason once.
    """
    from ballplate.studies import named

    keys = [key for key in FIRST if any(each.get(key) is not None for each in done.rows)]
    curves = done.curves
    several = len(curves) > 1

    def cell(run: Mapping[str, Any], key: str) -> str:
        if run["outcome"] == "finished":
            return digits(run.get(key), LABELS[key][1])
        when = f" at {run['outcome_time']:.3g} s" if run["outcome_time"] else ""
        return f"{run['outcome']}{when}"

    chosen = keys[:1] if several else keys
    heads = curves if several else [f"{LABELS[key][0]} [{LABELS[key][1]}]" for key in keys]
    rows = [
        [named(value), *(cell(runs[at], key) for runs in curves.values() for key in chosen)]
        for at, value in enumerate(done.values)
    ]
    yield bold(done.title)
    yield Table("", (done.keys[0], *(heads if keys else ())), rows, words=())
    if several and keys:
        label, unit = LABELS[keys[0]]
        yield dim(f"{label} in {unit}")
    for reason in dict.fromkeys(row["reason"] for row in done.rows if row["outcome"] == "failed"):
        TERMINAL.warn(reason)
    if any(row["outcome"] == "not run" for row in done.rows):
        TERMINAL.warn("interrupted: what had not ended is not in the table")
