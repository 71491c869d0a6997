"""The commands list, run, compare, sweep, describe and new, and those that show runs."""

from __future__ import annotations

import keyword
import re
import shlex
import tempfile
import webbrowser
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from ballplate.changes import scenarios
from ballplate.running import CLEAN_LABEL
from ballplate.running import run as run_scenario
from twin.base.data_file import read_toml
from twin.base.errors import (
    LogError,
    RecordError,
    ScenarioError,
    TwinError,
    ViewError,
    naming,
    nearest,
    plural,
)
from twin.base.shipped import find, folder, model_path, shipped_scenarios
from twin.base.writing import check_writable, check_writable_beside, write_whole
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
from twin.run.files import (
    FILM_SUFFIXES,
    NEWEST_RUN,
    check_ending,
    check_no_scenario,
    free,
    is_last,
    is_log,
    last,
    run_folder,
)

if TYPE_CHECKING:
    from twin.run.finished import Run
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


class Start(NamedTuple):
    """A start.

    Attributes:
        source: Its file in ``scenarios/starts``.
        called: What the class in it is called, and its name; empty for tables.
        then: What to do with it.
    """

    source: str
    called: tuple[str, str]
    then: str


STARTS_IN = folder() / "starts"
_START_TABLES = read_toml(STARTS_IN / "starts.toml")
LAW_STARTS: dict[str, dict[str, Any]] = _START_TABLES["like"]
"""What a law may begin as: what its start has otherwise."""
START_FILES = {kind: Start(**about) for kind, about in _START_TABLES["starts"].items()}
LAW_NAME_PATTERN = re.compile(r"[a-z][a-z0-9_]{0,39}")


@options.command(example="new law mine --like pid")
@click.argument("kind", type=click.Choice(list(START_FILES)))
@click.argument("name")
@click.option(
    "--like",
    metavar="NAME",
    shell_complete=lambda *_: [*LAW_STARTS, *shipped_scenarios()],
    help="What a law begins as: cascade, pid (has a memory), lqr (designs on the model) or blank "
    "[cascade]; the scenario to copy.",
)
def new(kind: str, name: str, like: str | None) -> int:
    """Write a commented start: a law, observer or reference into laws/, or a scenario or study."""
    if not LAW_NAME_PATTERN.fullmatch(name) or keyword.iskeyword(name):
        allowed = "small letters, digits and _, no word of Python, as in my_law"
        raise ScenarioError(f"NAME '{name[:60]}': must be {allowed}")
    from twin.scenario.schema import CATALOG_TABLES, choices

    start = START_FILES[kind]
    if like is not None:
        start = _begin_like(kind, like)
    file = Path("laws") / f"{name}.py" if start.called[0] else Path(f"{name}.toml")
    if file.exists():
        raise ScenarioError(f"{file}: exists; nothing was written, choose another NAME")
    for table in CATALOG_TABLES if start.called[0] else ():
        if taken := choices(table).get(name):
            raise ScenarioError(f"{kind} '{name}': the name is taken by {taken.__module__}")
    text = (STARTS_IN / start.source).read_text(encoding="utf-8")
    words = name.replace("_", " ").capitalize()
    class_name = "".join(part.capitalize() for part in name.split("_"))
    if start.called[0]:
        text = re.sub(rf"\b{start.called[0]}\b", class_name, text)
        text = text.replace(f'"{start.called[1]}"', f'"{name}"')
    elif like is None:
        text = text.replace('"TITLE"', f'"{words}"').replace("FILE", str(file), 1)
    write_whole(file, text)
    say(f"written to {file}; try: ballplate {start.then.format(name=name, file=file)}")
    return 0


def _begin_like(kind: str, like: str) -> Start:
    """The start of a law of a kind that is known, or of a scenario that is a copy.

    Raises:
        ScenarioError: If there is none of this name, or the kind has only one start.
    """
    start = START_FILES[kind]
    if kind == "scenario":
        with naming("--like"):
            return start._replace(source=str(find(like).resolve()))
    if kind != "law":
        raise ScenarioError(
            "--like: for a law or a scenario, as in: ballplate new law mine --like pid"
        )
    if like not in LAW_STARTS:
        raise ScenarioError(f"--like: no '{like[:60]}'{nearest(like, LAW_STARTS)}")
    return start._replace(**LAW_STARTS[like])


def _open_runs(paths: tuple[Path, ...]) -> list[Run]:
    """The runs that paths lead to; the newest one if there is none.

    Raises:
        RecordError: If one is a log, or none can be opened.
    """
    paths = paths or (Path(NEWEST_RUN),)
    for path in paths:
        check_no_scenario(path)
        if len(paths) > 1 and _is_trace(path) and path.suffix != ".parquet":
            raise RecordError(f"{path}: not a run; show a CAN trace without runs")
        if is_log(path):
            raise RecordError(
                f"{path}: a log, not a run; ballplate compare {path} SCENARIO, with --columns "
                f"where its columns have other names; a CAN trace: ballplate trace {path}"
            )
    from twin.run.opened import open_runs

    return open_runs(paths, TERMINAL.warn)


@options.command(example="view runs/circle", reads=True)
@click.argument("runs", nargs=-1, type=options.PATH_TYPE, shell_complete=options.runs)
@click.option(
    "--rrd",
    type=options.WRITABLE_FILE,
    help="Write a recording, open no viewer.",
)
@options.SERVE_OPTION
def view(runs: tuple[Path, ...], rrd: Path | None, serve: int | None) -> int:
    """Open run folders in the Rerun viewer, several side by side on one time line.

    RUNS are run folders, folders of such, or `last`; the newest run if there is none. A trace of a
    CAN bus, as trace.log, is shown by its states, signals and events.
    """
    write = _writer_of_trace(runs[0]) if len(runs) == 1 and _is_trace(runs[0]) else None
    if write is None:
        opened = _open_runs(runs)
        from twin.view.recording import write as write_runs  # heavy: wrong names come first

        def write(path: Path) -> None:
            write_runs(path, opened)

    if rrd is not None:
        write(rrd)
        say(f"written to {rrd}")
        return 0
    with tempfile.TemporaryDirectory(prefix="ballplate-") as folder:
        recording = Path(folder) / "view.rrd"
        write(recording)
        return _show(recording, serve)


def _is_trace(path: Path) -> bool:
    """Whether a path is a file that may be a trace of a CAN bus: neither a record nor a table."""
    from twin.run.files import is_record

    return path.is_file() and not is_record(path) and path.suffix not in {".csv", ".toml"}


def _writer_of_trace(path: Path) -> Callable[[Path], None]:
    """Writes a recording of a trace of a CAN bus.

    Raises:
        LogError: If nothing in it can be read.
    """
    from twin.devices.akd.decoding import Conversation
    from twin.devices.akd.traces import read_trace

    found = read_trace(path, None)
    for remark in found.remarks:
        TERMINAL.warn(remark)
    conversation = Conversation(found.frames, timed=found.timed)
    from twin.view.bus import write_bus

    return lambda target: write_bus(target, conversation, path.name)


def _show(recording: Path, serve: int | None) -> int:
    """Keep a viewer open until it is closed."""
    from twin.view import viewer

    opened = viewer.window(recording) if serve is None else viewer.page(serve, recording)
    if opened.page:
        say(f"open {opened.page} in a browser; Ctrl-C ends it")
    if opened.wait():
        raise ViewError("the viewer ended with an error; use --rrd FILE or --serve")
    return 0


REPORT_FORMATS = ("html", "png", "pdf", "svg")


def _formats(_: click.Context, __: click.Parameter, listed: str | None) -> list[str] | None:
    """The formats in a list with commas between; None where there is no list."""
    if listed is None:
        return None
    names = [name.strip() for name in listed.split(",")]
    if wrong := [name for name in names if name not in REPORT_FORMATS]:
        raise click.BadParameter(f"no format '{wrong[0]}' (known: {', '.join(REPORT_FORMATS)})")
    return names


def _report_folder(asked: tuple[Path, ...], opened: Sequence[Run]) -> Path:
    """Folder of a report: of its run, of its comparison, or the folder above its runs."""
    folder = opened[0].folder
    assert folder is not None
    if len(opened) == 1:
        return folder
    if len(asked) > 1:
        return folder.parent
    (comparison,) = asked or (Path(NEWEST_RUN),)
    return last() if is_last(comparison) else comparison


@options.command(example="report runs/circle --format html,png", reads=True)
@click.argument("runs", nargs=-1, type=options.PATH_TYPE, shell_complete=options.runs)
@click.option(
    "--format",
    "formats",
    callback=_formats,
    metavar="html,png,pdf,svg",
    help="What to write [by the ending of --out, else html].",
)
@click.option(
    "--out",
    type=options.WRITABLE_FILE,
    help="File, its ending optional [RUN/report].",
)
def report(runs: tuple[Path, ...], formats: list[str] | None, out: Path | None) -> int:
    """Report on one run folder, or compare several: a page, pictures.

    RUNS are run folders, folders of such, or `last`; the newest run if there is none.
    """
    opened = _open_runs(runs)
    stem = out or check_writable(_report_folder(runs, opened), "report:") / "report"
    from twin.base.page import encode_figure  # heavy: a wrong name was reported before
    from twin.devices.akd import TRACE_FILE
    from twin.devices.akd.traces import SEAL_FILE, find_altered_parts
    from twin.view.html import details, html, overview

    for each in opened:
        if each.folder is not None and (each.folder / SEAL_FILE).exists():
            each.incomplete = (*each.incomplete, *find_altered_parts(each.folder / TRACE_FILE))
    if (ending := stem.suffix.removeprefix(".")) in REPORT_FORMATS:
        stem, formats = stem.with_suffix(""), formats or [ending]
    if stem.is_dir():
        raise RecordError(f"--out {stem}: is a folder; give a file name without ending")
    for name in formats or ["html"]:
        figures = {"": overview, "-details": details} if name != "html" else {"": html}
        for more, make in figures.items():
            path, made = stem.with_name(f"{stem.name}{more}.{name}"), make(opened)
            write_whole(path, made if isinstance(made, str) else encode_figure(made, name, dpi=150))
            say(f"written to {path}")
    return 0


@options.command(example="export runs/circle circle.mat", reads=True)
@click.argument("run", type=options.PATH_TYPE, shell_complete=options.runs)
@click.argument("file", type=options.PATH_TYPE)
@click.option(
    "--beside",
    multiple=True,
    type=options.PATH_TYPE,
    metavar="RUN",
    help="Of a moving picture: show this run, too; may be repeated.",
    shell_complete=options.runs,
)
@click.option("--from", "since", type=float, help="Start of the part shown, s [start of the run].")
@click.option("--to", "until", type=float, help="End of the part shown, s [end of the run].")
@click.option("--seconds", type=float, help="Its duration, s [that of the run].")
@click.option("--fps", type=int, help="Its frames a second [20].")
@click.option("--size", type=int, help="Its width in pixels [600].")
@click.option("--fmi", type=click.Choice(["2", "3"]), help="Of an .fmu: version of FMI [2].")
@click.option(
    "--reference",
    "reference_output",
    is_flag=True,
    help="Of an .fmu: the reference is an output of the rig, or inputs of the controller.",
)
@click.option("--controller", is_flag=True, help="Of an .fmu: the controller, not the rig.")
@click.option("--bus", is_flag=True, help="A drive, akd, as a node of a simulated CAN bus.")
@click.option(
    "--real", type=click.Choice(("double", "float")), help="Of a controller in C [double]."
)
@options.LAW_OPTION
@options.SETTING
@click.option(
    "--render",
    type=click.Choice(("plate", "mujoco")),
    help="Picture: the plate from above, or the mechanism in 3D by EGL or OSMesa [plate].",
)
def export(
    run: Path,
    file: Path,
    beside: tuple[Path, ...],
    fmi: str | None,
    reference_output: bool,
    controller: bool,
    bus: bool,
    real: str | None,
    overrides: tuple[str, ...],
    **cut: Any,
) -> int:
    """Export the signals of a run to a .csv, .mat, .parquet or .mcap file, or the run as it moved.

    A picture that moves is a .webp, .gif or, by the extra video, .mp4:
    ballplate export runs/circle circle.webp --beside runs/cure --seconds 8

    In place of a run, a scenario's rig can be exported, for Simulink and other tools, as an .fmu:
    ballplate export circle rig.fmu --fmi 3 --set plant.friction.rolling_mm=0.1

    Or its controller, which drives that rig:
    ballplate export circle controller.fmu --controller

    Or a drive, as a node of a simulated CAN bus (FMI 3.0 with FMI-LS-BUS 1.0):
    ballplate export akd drive.fmu --bus

    Or a scenario's controller, as a folder of C source for a board, here controller/:
    ballplate export circle controller.c --real float
    """
    check_writable_beside(file, "FILE")
    if controller and (bus or file.suffix != ".fmu"):
        raise RecordError(f"{file}: --controller: exports an FMU; the file must end in .fmu")
    if real and file.suffix != ".c" and not controller:
        raise RecordError(
            f"{file}: --real: for a controller in C; the file must end in .c, or with "
            "--controller in .fmu"
        )
    given = {name: value for name, value in cut.items() if value is not None}
    of_picture, of_rig = beside or given, fmi or reference_output
    if bus:
        if of_picture or of_rig or overrides:
            raise RecordError(f"{file}: --bus: a drive is exported without further options")
        from ballplate.rigs import drive_fmu

        say(f"written to {drive_fmu(str(run), file, reporter=TERMINAL)}")
        return 0
    if file.suffix in {".fmu", ".c"}:
        if of_picture:
            raise RecordError(
                f"{file}: of an .fmu there are the options --fmi, --reference, --controller, "
                "--real, --on and --set only, of a .c --real, --on and --set"
            )
        number = int(fmi) if fmi else None
        return _export_scenario(
            run, file, overrides, number, real, reference_output, controller=controller
        )
    if of_rig or overrides:
        raise RecordError(
            f"{file}: --fmi, --reference, --on and --set: need a file that ends in .fmu"
        )
    from ballplate.comparing import label_runs
    from ballplate.results import Result
    from controllers.ballplate import BallPlate

    moving = file.suffix in FILM_SUFFIXES
    if of_picture and not moving:
        raise RecordError(
            f"{file}: --beside, --from, --to, --seconds, --fps, --size, --render are of moving "
            "pictures: .webp, .gif, .mp4"
        )
    check_ending(file, FILM_SUFFIXES)
    opened = _open_runs((run,))
    with naming("--beside"):
        opened += [each for path in beside for each in _open_runs((path,))]
    if not moving:
        if len(opened) > 1:
            raise RecordError(f"{run}: contains {len(opened)} runs; give one of them")
        opened[0].export(file)
        say(
            f"written to {file}: {plural(len(opened[0].time), 'row')} of "
            f"{plural(len(opened[0]), 'column')}"
        )
        if file.suffix == ".csv" and opened[0].scenario.plant.model != BallPlate():
            say("a CSV file does not state the run's ball; .mat, .parquet and .mcap do")
        return 0
    (name, first), *others = label_runs([Result.from_run(each) for each in opened]).items()
    first.label, first.beside = name, dict(others)
    first.export(file, **given, reporter=TERMINAL)
    say(f"written to {file}{'' if file.suffix else '/'}")
    return 0


def _export_scenario(
    name: Path,
    file: Path,
    overrides: tuple[str, ...],
    fmi: int | None,
    real: str | None,
    reference: bool,
    *,
    controller: bool,
) -> int:
    """Export a scenario's rig or controller as an FMU, or its controller as C source."""
    from ballplate.rigs import controller_fmu, controller_source, fmu

    kind: dict[str, Any] = {"fmi": fmi or 2, "reporter": TERMINAL}
    real = real or "double"
    if file.suffix == ".c":
        if fmi or reference:
            raise RecordError(f"{file}: --fmi and --reference need a file that ends in .fmu")
        say(f"written to {controller_source(name, file, overrides, real=real)}/")
    elif controller:
        kind |= {"real": real, "reference_inputs": reference}
        say(f"written to {controller_fmu(name, file, overrides, **kind)}")
    else:
        say(f"written to {fmu(name, file, overrides, wished=reference, **kind)}")
    return 0


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
