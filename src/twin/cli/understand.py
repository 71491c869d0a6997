"""The commands explain, identify, fit, shadow, whatif and analyse: what a run shows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ballplate.changes import changes_of, scenario_of, warn_of_replaced
from twin.base.errors import LogError, ScenarioError, naming, plural
from twin.base.page import Table
from twin.base.parts import left_out
from twin.base.shipped import chosen, shipped_in
from twin.base.writing import check_writable, write_json
from twin.cli import options, planning
from twin.cli.output import (
    TERMINAL,
    Shown,
    bold,
    indicators,
    list_written,
    print_shipped,
    progress,
    show,
    warn,
)
from twin.identify.parameters import (
    DEFAULT_PARAMETERS,
    FITTED_SHARE,
    PARAMETER_CHOICES,
    PLAIN_PARAMETERS,
    choose_parameters,
)
from twin.run.files import RUNS_FOLDER, is_record, log_file, run_folder, run_name

if TYPE_CHECKING:
    from twin.identify.survey import Survey
    from twin.scenario import Scenario
    from twin.whatif.attribution import EffectCase, Explanation


@options.command(example="explain circle")
@options.SCENARIO()
@options.LAW_OPTION
@options.SETTING
@click.option("--out", type=options.PATH_TYPE, help="Folder [runs/explain-SCENARIO].")
@options.PROCESSES_OPTION
@options.JSON_OPTION
def explain(
    scenario: str, overrides: tuple[str, ...], out: Path | None, processes: int | None
) -> int:
    """Attribute the tracking error to effects: run with all, without each, and with each alone."""
    from twin.whatif.attribution import describe_short_run, draw, plan, summary
    from twin.whatif.attribution import explain as explain_scenario

    chosen = scenario_of(scenario, changed := changes_of(overrides, {}))
    warn_of_replaced([scenario], changed, TERMINAL)
    if short := describe_short_run(chosen):
        warn(short)
    named = run_folder(scenario, overrides)
    folder = check_writable(out or named.with_name(f"explain-{named.name}"))
    runs = len({case.model_dump_json() for case in plan(chosen).values()})
    with progress(f"{plural(runs, 'run')} of {chosen.title}", runs) as advance:
        found = explain_scenario(chosen, advance, processes)
    numbers = summary(found)
    write_json(folder / "explain.json", numbers)
    with left_out(file := folder / "picture.png"):
        draw(file, found)
    show(numbers, _effects(found), folder, list_written(folder, "picture.png", "explain.json"))
    return 0 if found.whole.rms is not None else 1


def _effects(found: Explanation) -> Iterator[Shown]:
    from twin.whatif.attribution import EFFECTS, describe_short_run, effects_present

    what = "tracking error e_tt [%]" if found.in_percent else "RMS distance [mm]"
    yield bold(f"{found.scenario.title}: {what}")

    def size_text(case: EffectCase) -> str:
        value = found.size(case)
        return case.outcome.split(" at ", maxsplit=1)[0] if isnan(value) else f"{value:.2f}"

    def percentage(share: float | None) -> str:
        return "-" if share is None else f"{100 * share:z.1f} %"

    rows = [
        (part.effect.label, size_text(part.without), size_text(part.alone), percentage(part.share))
        for part in found.contributions
    ]
    for label, share in (("effects on each other", found.rest), ("left with none", found.base)):
        if share is not None:
            rows.append((label, "", "", percentage(share)))
    if short := describe_short_run(found.scenario):
        yield bold(short)
    yield Table("", ("effect", "all but this", "this alone", "share"), rows)
    yield f"all effects: {size_text(found.whole)}"
    yield f"none of them: {size_text(found.none)}: the law itself, on a clean model"
    has = effects_present(found.scenario)
    lacking = [effect.label for effect in EFFECTS if effect not in has]
    if lacking:
        yield f"not in this scenario: {', '.join(lacking)}"


PARAMETERS_HELP = (
    f"Some of {', '.join(PARAMETER_CHOICES)} [{','.join(DEFAULT_PARAMETERS)}]; "
    f"with --columns {', '.join(PLAIN_PARAMETERS)}."
)


@options.command(example="identify runs/excite")
@click.argument("logs", type=options.PATH_TYPE, nargs=-1, shell_complete=options.runs)
@click.option("--parameters", "names", metavar="NAME,...", help=PARAMETERS_HELP)
@click.option(
    "--hold-out",
    "held",
    multiple=True,
    metavar="SHARE|LOG",
    help=f"Share of the log held out from the fit [{1 - FITTED_SHARE:.2f}]; "
    "with --columns also a log.",
)
@options.COLUMNS
@options.BALL_OPTION
@click.option(
    "--on",
    metavar="RIG",
    callback=options.check_rig_name,
    help="With --columns: the rig, or file of parameters, that the results are laid over; "
    "with --plan the rig.",
    shell_complete=options.rigs,
)
@click.option(
    "--ball-height", metavar="M", help="Height of the ball's centre above the plate's axis, m."
)
@planning.PLAN
@click.option("--out", type=options.PATH_TYPE, help="Folder [runs/identify-LOG].")
@options.JSON_OPTION
def identify(
    logs: tuple[Path, ...], names: str | None, held: tuple[str, ...], out: Path | None, **how: Any
) -> int:
    """Fit friction, dead time, drives and level to a recorded run, or to logs of any rig.

    LOG is a run folder, a run.parquet, or a log with named columns, preferably recorded with
    the scenario `excite`; with --columns one or more logs of any rig, with commands in place of
    plate angles. Of a log with other columns it shows without --columns what the log holds,
    guesses roles, and prints the command line that would use it (exit code 1). Writes
    report.html and parameters.toml; exit code 1 if no parameter can be identified. With --plan
    and no LOG it forecasts the results of scenarios before anything is recorded.
    """
    plan = planning.take_plan(logs, held, out, how)
    if how["columns"] is None:
        choose_parameters(names)  # a wrong name is reported before anything heavy is imported
    if plan is not None:
        return planning.show_plan(plan, names, how["on"])
    files = [log_file(log) for log in logs]
    if how["columns"] is None and (surveyed := _survey_unknown(files[0], how["separator"])):
        show(surveyed.as_dict(), _describe_survey(surveyed))
        return 1
    for name in ("on", "ball_height"):
        if how["columns"] is None and how[name] is not None:
            option = f"--{name.replace('_', '-')}"
            raise ScenarioError(f"{option}: needs --columns; a run states its rig")
    hold_out = _held_out(held)
    folder = check_writable(out or RUNS_FOLDER / f"identify-{run_name(files[0])}")
    from ballplate.identifying import identify as identify_log

    done = identify_log(files, names or (), hold_out=hold_out, reporter=TERMINAL, **how)
    from twin.identify.report import TABLE_HEADINGS, further_notes, reasons, rows
    from twin.identify.verdicts import IDENTIFIED_VERDICT, PLAIN_VERDICT

    done.save(folder)
    found = done.found
    notes = (f"note: {note}" for note in further_notes(found) if note not in found.warned)
    table = Table("", TABLE_HEADINGS, rows(found), words=(0, *range(3, len(TABLE_HEADINGS))))
    shown = (table, *reasons(found), *done.sentences, *notes)
    words = {each.word for each in found.verdicts}
    files_written = "report.html, parameters.toml" if IDENTIFIED_VERDICT in words else "report.html"
    show(found.as_dict(), shown, folder, files_written)
    return int(not words & {IDENTIFIED_VERDICT, PLAIN_VERDICT})


def _survey_unknown(file: Path, separator: str | None) -> Survey | None:
    """A look at a log without columns of the known names; None of any other."""
    if is_record(file):
        return None
    from twin.identify.log_tables import has_known_columns, open_content
    from twin.identify.survey import survey

    content = open_content(file)
    if has_known_columns(file.name, content):
        return None
    return survey(file, separator, content, options.typed_line())


def _describe_survey(found: Survey) -> Iterator[Shown]:
    """The content of a log, and the command line that would use it."""
    rows = [
        (each.name, each.unit, str(len(each.values)), str(each.missing), each.range)
        for each in found.columns
    ]
    yield Table("", ("column", "unit", "rows", "empty", "range"), rows, words=(0, 1, 4))
    yield from found.notes
    guesses = [(each.role, each.column, each.unit, each.why) for each in found.guesses]
    if guesses:
        yield Table("", ("role", "column", "unit", "guessed by"), guesses, words=range(4))
    yield f"{UNKNOWN_COLUMNS_TEXT}; try: {found.command}"


UNKNOWN_COLUMNS_TEXT = "This log has no columns of the names that this program knows"


def _held_out(held: tuple[str, ...]) -> float | list[Path]:
    """The share that is held out, or the logs that are.

    Raises:
        LogError: If it is neither a number nor a log.
    """
    try:
        (share,) = map(float, held or (round(1 - FITTED_SHARE, 2),))
    except ValueError:
        pass
    else:
        return share
    try:
        return [log_file(Path(each)) for each in held]
    except LogError as error:
        raise LogError(f"--hold-out: {error}; a share is a number, as 0.3") from None


@options.command(example="fit friction_of_two_series")
@click.argument("table", required=False)
@click.option("--no-leave-out", is_flag=True, help="Do not fit again without each group.")
@options.PROCESSES_OPTION
@options.SCHEDULER_OPTION
@click.option("--out", type=options.PATH_TYPE, help="Folder [runs/fit-NAME].")
@options.JSON_OPTION
def fit(table: str | None, out: Path | None, *, no_leave_out: bool, **how: Any) -> int:
    """Fit parameters to measured indicators of many experiments, where no logs were kept.

    TABLE is a shipped name, without one those are listed, or a TOML file: scenarios with what was
    measured and how certain that is, and the parameters to find, with their ranges. Finished runs
    are kept: an interrupted fit continues where it stopped. Writes report.html and fit.json; exit
    code 1 if no parameter is seen.
    """
    if table is None:
        return print_shipped("fits")
    chosen("table", table, shipped_in("fits"))  # reported before anything heavy is imported
    from twin.study.experiments import Store, executors
    from twin.tune.cells import Runs, read
    from twin.tune.fit import PARAMETER_HEADINGS, row, sentences, write
    from twin.tune.fit import fit as fit_table

    about = read(table)
    folder = check_writable(out or Path("runs") / f"fit-{Path(table).stem}")
    store = Store(folder)
    with executors(**how) as (executor, count):
        runs = Runs(about, store, executor=executor, processes=count)
        with progress(about.title, 1.0) as advance:
            found = fit_table(about, runs, leave_out=not no_leave_out, advance=advance)
    write(found, folder)
    rows = list(map(row, found.estimates))
    shown = (
        Table("", PARAMETER_HEADINGS, rows, words=range(len(PARAMETER_HEADINGS))),
        *sentences(found),
    )
    show(found.as_dict(), shown, folder, "report.html, fit.json")
    return int(all(each.verdict != "seen" for each in found.estimates))


@options.command(example="shadow runs/circle")
@click.argument("logs", metavar="LOG...", type=options.PATH_TYPE, nargs=-1, required=True)
@click.option(
    "--reference",
    type=options.PATH_TYPE,
    metavar="LOG0",
    help="Identify the rig from this log of its healthy state; the others are evaluated by it.",
)
@options.SETTING
@options.LEARN_OPTION
@options.COLUMNS
@options.BALL_OPTION
@click.option("--out", type=options.PATH_TYPE, help="Folder [RUN, or runs/shadow-LOG].")
@options.JSON_OPTION
def shadow(
    logs: tuple[Path, ...],
    reference: Path | None,
    overrides: tuple[str, ...],
    out: Path | None,
    *,
    learn: bool,
    **how: Any,
) -> int:
    """Compare a recorded run with the twin: is it still right, since when not, and why.

    LOG is a run folder, a run.parquet, or a CSV file with named columns and the commands; with
    --columns a log of any rig, its ball by --on or --ball, or learned from the reference. --ball
    states the ball of a CSV file with named columns, too; a run states its own.
    The twin is what the run was simulated with, or believed, changed by --set (parameters=FILE for
    identified ones: it learns then as with --learn). With --reference it is identified from LOG0,
    and several logs are compared, each in a folder of its own. Writes shadow.html and shadow.json.
    Exit code 1 after an alarm, or if a log differs from the reference from its start.
    """
    files = [log_file(log) for log in logs]  # a wrong name is reported before heavy imports
    names = [run_name(file) for file in files]
    if reference is None and len(files) > 1:
        raise ScenarioError(f"{logs[1]}: several logs need --reference LOG0")
    if reference is not None and learn:
        raise ScenarioError("--learn: not allowed with --reference; its twin always learns")
    if len(set(names)) < len(names):
        same = next(log for n, log in enumerate(logs) if names[n] in names[:n])
        raise ScenarioError(f"{same}: two logs have the same name; rename one")
    with naming("--reference"):
        first = None if reference is None else log_file(reference)
    _check_columns([*([first] if first else ()), *files], how)

    def folder_of(file: Path, name: str) -> Path:
        if out is not None:
            return check_writable(out / name if reference is not None else out)
        return check_writable(file.parent if is_record(file) else RUNS_FOLDER / f"shadow-{name}")

    folders = [folder_of(*each) for each in zip(files, names, strict=True)]
    from twin.shadow.reference import examine_by_reference
    from twin.shadow.report import WRITTEN_FILES, examine, sentences

    if first is None:
        with progress(f"the twin of {names[0]}", 1.0):
            one = examine(files[0], folders[0], overrides, learning=learn, **how)
        show(one.as_dict(), sentences(one), folders[0], WRITTEN_FILES)
        return int(bool(one.alarms))
    learned, found = examine_by_reference(
        first,
        check_writable((out or RUNS_FOLDER) / f"identify-{run_name(first)}"),
        dict(zip(files, folders, strict=True)),
        overrides,
        stage=lambda what: progress(what, 1.0),
        **how,
    )
    numbers = {"reference": learned.as_dict(), "logs": {n: f.as_dict() for n, f in found.items()}}
    shown: list[Shown] = [learned.describe()]
    for (name, each), folder in zip(found.items(), folders, strict=True):
        shown += [bold(name), *sentences(each), f"written to {folder}/: {WRITTEN_FILES}"]
    show(numbers, shown)
    return int(any(each.verdict in {"alarm", "differs"} for each in found.values()))


def _check_columns(files: Sequence[Path], how: dict[str, Any]) -> None:
    """Make sure that the columns of logs are described, and can be meant.

    Raises:
        LogError: If there is no such ball, role or unit, or a log has other columns than those
            that this program knows, or a ball is given for a run.
        ScenarioError: If a separator is given for a run.
    """
    from twin.identify.balls import ball_factor
    from twin.identify.log_columns import wanted_columns

    if how.get("ball") is not None:
        ball_factor(how["ball"])
        for file in filter(is_record, files):
            raise LogError(f"{run_name(file)}: --ball: not allowed; a run states its ball")
    if how["columns"] is not None:
        wanted_columns(how["columns"])
        return
    for file in files:
        if surveyed := _survey_unknown(file, how["separator"]):
            has = ", ".join(each.name for each in surveyed.columns[:12])
            raise LogError(
                f"{file.name}: has no columns of the names that this program knows (it has "
                f"{has}); try: {surveyed.command}"
            )
    if how["separator"] is not None:
        raise ScenarioError("--separator: with --columns only")


FURTHER_HELP = "A further future, with these changes in addition to --set; repeatable."


@options.command(example="whatif runs/circle --at 12.4 --set controller.kind=lqr")
@click.argument("run", type=options.PATH_TYPE)
@click.option("--at", type=float, required=True, help="Time at which the future begins, s.")
@click.option("--set", "settings", multiple=True, metavar="KEY=VALUE", help="Change a key.")
@click.option("--branch", "branches", multiple=True, metavar="'KEY=VALUE; ...'", help=FURTHER_HELP)
@click.option(
    "--for",
    "lasting",
    type=options.Finite(0.01, 3600),
    default=10.0,
    show_default=True,
    help="Duration of the future, s.",
)
@click.option(
    "--scenario",
    callback=options.check_scenario_name,
    help="Scenario of a log that does not state it: a name or a TOML file.",
)
@click.option(
    "--on",
    metavar="RIG",
    callback=options.check_rig_name,
    help="Rig of the log: a name, or a file of identified parameters.",
)
@options.COLUMNS
@click.option("--out", type=options.PATH_TYPE, help="Folder [runs/whatif-RUN].")
@options.JSON_OPTION
def whatif(
    run: Path,
    at: float,
    settings: tuple[str, ...],
    branches: tuple[str, ...],
    lasting: float,
    on: str | None,
    out: Path | None,
    **log: Any,
) -> int:
    """Simulate other futures from a moment of a run: what would have happened.

    RUN is a run folder or a CSV log. A simulated run is continued exactly, a real one from its
    estimated state. Without --set and --branch nothing is changed.
    """
    run = log_file(run)  # a wrong name is reported before anything heavy is imported
    options.check_settings(settings, "--set")
    if branches:
        from twin.scenario.merging import split_settings

        for branch in branches:
            options.check_settings(split_settings(branch), "--branch")
    if log["columns"] is not None:
        _check_columns([run], log)
    from twin.base.jobs import SecondProcess, cores
    from twin.run.finished import load_drawing
    from twin.whatif.futures import agreement, branches_of, futures, moment_of, summary, write

    with SecondProcess(wanted=cores() > 1) as drawing:
        drawing.begin(load_drawing)
        rig = () if on is None else (f"parameters={on}",)
        changes = branches_of(settings, branches)
        folder = check_writable(out or RUNS_FOLDER / f"whatif-{run_name(run)}")
        moment = moment_of(run, at, settings=rig, branches=changes, **log)
        found = futures(moment, lasting, changes)
        if any(each.run.interrupted for each in found):
            raise KeyboardInterrupt  # a future cut short is none
        write(moment, found, folder, drawing)
    for note in moment.notes:
        warn(note)
    apart = (
        f"{each.label}: {1000 * each.max_difference:.3g} mm from the record at most"
        for each in found
        if each.max_difference is not None
    )
    tables = indicators({each.label: each.run.metrics for each in found})
    files = f"picture.png and a run folder per branch: ballplate report {folder}"
    shown = (agreement(moment), *tables, *apart)
    show(summary(moment, found), shown, folder, files)
    return 0


Numbers = dict[str, Any]
"""A part of what ``--json`` prints."""


@options.command(example="analyse circle --set controller.kind=lqr")
@options.SCENARIO(default="sine")
@options.LAW_OPTION
@options.SETTING
@options.JSON_OPTION
def analyse(scenario: str, overrides: tuple[str, ...]) -> None:
    """Analyse the loop of a scenario: poles and margins of law, observer and predictor.

    SCENARIO [sine] gives the controller, the dead time of its screen or camera with half a frame,
    and the lag of its drives.
    """
    chosen = scenario_of(scenario, changed := changes_of(overrides, {}))
    warn_of_replaced([scenario], changed, TERMINAL)
    loop = _loop(chosen)
    show({"scenario": chosen.title, "loop": loop}, _describe_loop(loop))


def _loop(scenario: Scenario) -> Numbers:
    """The scenario's own controller, observer and predictor as a sampled loop."""
    from controllers.analysis import instability, loop_row
    from twin.run.controller_building import build_controller

    controller = build_controller(scenario)
    late = dict(zip(("dead_time", "lag"), scenario.lateness, strict=True))
    row = loop_row(controller.law, controller.observer, **late)
    if scenario.plant.axes == 1 and "margins" in row:
        row["margins"] = {cut: row["margins"][cut] for cut in ("u1", "x") if cut in row["margins"]}
    return {
        "controller": scenario.controller.kind,
        "observer": scenario.observer.kind,
        "predictor": None if scenario.predictor is None else scenario.predictor.delay,
        **late,
        **row,
        "danger": instability(controller.law, controller.observer, **late),
    }


def _describe_loop(found: Numbers) -> Iterator[Shown]:
    """The scenario's own loop in words and a table."""
    parts = [found["controller"], found["observer"]]
    if found["predictor"] is not None:
        parts.append(f"predictor {1000 * found['predictor']:g} ms")
    parts.append(f"dead time {1000 * found['dead_time']:.3g} ms")
    if found["lag"]:
        parts.append(f"drives' lag {1000 * found['lag']:.3g} ms")
    title = f"The scenario's sampled loop: {', '.join(parts)}"
    if found["reason"]:
        yield f"{title}: {found['reason']}"
        return
    lines = [(cut, *_margins(row)) for cut, row in found["margins"].items()]
    yield Table(title, ("cut at", *MARGIN_HEADINGS), lines)
    yield f"poles in 1/s, slowest first: {_poles(found['poles'])}"
    if found["danger"]:
        yield bold(found["danger"])
    if found["hold_left_out"]:
        yield "controller: the law's hold and how late its command comes are not in this loop"


MARGIN_HEADINGS = ("gain", "phase deg", "disk", "delay ms", "crossover rad/s")


def _margins(row: Numbers | None) -> list[str]:
    if row is None:
        return ["unstable"]
    gain = f"{_format_margin(row['gain_down'] or 0.0)} to {_format_margin(row['gain_up'])}"
    rest = (("phase", 1), ("disk", 1), ("delay", 1000), ("crossover", 1))
    return [gain, *(_format_margin(row[key], scale) for key, scale in rest)]


MAX_PRINTED_POLES = 10
"""Poles that are printed."""


def _poles(pairs: Sequence[Sequence[float]]) -> str:
    """Poles for people: conjugate ones as a±bj."""
    upper = [(real, imag) for real, imag in pairs if imag > -1e-6]
    shown = [
        f"{re:.3g}±{im:.3g}j" if im > 1e-4 else f"{re:.3g}" for re, im in upper[:MAX_PRINTED_POLES]
    ]
    return ", ".join(shown) + (", ..." if len(upper) > MAX_PRINTED_POLES else "")


def _format_margin(value: float | None, scale: float = 1.0) -> str:
    return "∞" if value is None else f"{scale * value:.3g}"
