"""The commands view, report and export: finished runs, shown and handed to other programs."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from twin.base.errors import RecordError, ViewError, naming, plural
from twin.base.writing import check_writable, check_writable_beside, write_whole
from twin.cli import options
from twin.cli.output import TERMINAL, say
from twin.run.exporters import FILM_SUFFIXES, check_ending
from twin.run.files import NEWEST_RUN, check_no_scenario, is_last, is_log, last

if TYPE_CHECKING:
    from twin.run.finished import Run


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
@click.option("--seconds", type=float, help="Its duration, s [the whole run].")
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
        say(f"written to {fmu(name, file, overrides, with_reference=reference, **kind)}")
    return 0
