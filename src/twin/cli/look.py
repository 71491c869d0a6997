"""The commands view, report and export: recorded runs, seen."""

from __future__ import annotations

import tempfile
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from twin.cli import options as tab
from twin.cli.options import SERVE, SETTING, Command
from twin.cli.output import TERMINAL, say, warn
from twin.errors import RecordError, TwinError, ViewError
from twin.paths import model_path
from twin.run.files import LAST, MOVING, check_no_scenario
from twin.writing import write_whole

if TYPE_CHECKING:
    from twin.run.finished import Run


def _opened(paths: tuple[Path, ...]) -> list[Run]:
    """The runs that paths lead to; the newest one if there is none.

    Raises:
        RecordError: If one is a log, or none can be opened.
    """
    paths = paths or (Path(LAST),)
    for path in paths:
        check_no_scenario(path)
        if path.suffix == ".csv":
            raise RecordError(f"{path}: a log, not a run; ballplate compare {path} SCENARIO")
    from twin.run.finished import open_runs

    return open_runs(paths, warn)


@click.command(cls=Command, example="view runs/circle")
@click.argument("runs", nargs=-1, type=click.Path(path_type=Path), shell_complete=tab.runs)
@click.option("--rrd", type=click.Path(path_type=Path), help="Write a recording, open no viewer.")
@SERVE
def view(runs: tuple[Path, ...], rrd: Path | None, serve: int | None) -> int:
    """Open run folders in the Rerun viewer, several side by side on one time line.

    RUNS are run folders, folders of such, or `last`; the newest run if there is none.
    """
    opened = _opened(runs)
    from twin.view.recording import write  # heavy: a wrong name was told

    if rrd is not None:
        write(rrd, opened)
        say(f"written to {rrd}")
        return 0
    with tempfile.TemporaryDirectory(prefix="ballplate-") as folder:
        recording = Path(folder) / "view.rrd"
        write(recording, opened)
        return _show(recording, serve)


def _show(recording: Path, serve: int | None) -> int:
    """Keep a viewer open until it is closed."""
    from twin.view import viewer

    opened = viewer.window(recording) if serve is None else viewer.page(serve, recording)
    if opened.page:
        say(f"open {opened.page} in a browser; Ctrl-C ends it")
    if opened.wait():
        raise ViewError("the viewer ended with an error; use --rrd FILE or --serve")
    return 0


FORMATS = ("html", "png", "pdf")


def _formats(_: click.Context, __: click.Parameter, listed: str) -> list[str]:
    """The formats in a list with commas between."""
    names = [name.strip() for name in listed.split(",")]
    if wrong := [name for name in names if name not in FORMATS]:
        raise click.BadParameter(f"no format '{wrong[0]}' (known: {', '.join(FORMATS)})")
    return names


@click.command(cls=Command, example="report runs/circle --format html,png")
@click.argument("runs", nargs=-1, type=click.Path(path_type=Path), shell_complete=tab.runs)
@click.option("--format", "formats", callback=_formats, default="html", metavar="html,png,pdf")
@click.option("--out", type=click.Path(path_type=Path), help="File without ending [RUN/report].")
def report(runs: tuple[Path, ...], formats: list[str], out: Path | None) -> int:
    """Report on one run folder, or compare several: a page, pictures.

    RUNS are run folders, folders of such, or `last`; the newest run if there is none.
    """
    opened = _opened(runs)
    from twin.page import encoded  # heavy: a wrong name was told
    from twin.report.html import details, html, overview

    folder = opened[0].folder
    assert folder is not None
    stem = out or (folder if len(opened) == 1 else folder.parent) / "report"
    if stem.suffix.removeprefix(".") in FORMATS:
        stem = stem.with_suffix("")
    if stem.is_dir():
        raise RecordError(f"--out {stem}: is a folder; give a file name without ending")
    for name in formats:
        figures = {"": overview, "-details": details} if name != "html" else {"": html}
        for more, make in figures.items():
            path, made = stem.with_name(f"{stem.name}{more}.{name}"), make(opened)
            write_whole(path, made if isinstance(made, str) else encoded(made, name, dpi=150))
            say(f"written to {path}")
    return 0


@click.command(cls=Command, example="export runs/circle circle.mat")
@click.argument("run", type=click.Path(path_type=Path), shell_complete=tab.runs)
@click.argument("file", type=click.Path(path_type=Path))
@click.option(
    "--beside",
    multiple=True,
    type=click.Path(path_type=Path),
    metavar="RUN",
    help="Of a moving picture: show this one as well; may be repeated.",
    shell_complete=tab.runs,
)
@click.option("--from", "since", type=float, help="The time it begins with, s [the first].")
@click.option("--to", "until", type=float, help="The time it ends with, s [the last].")
@click.option("--seconds", type=float, help="How long it lasts, s [as long as the run did].")
@click.option("--fps", type=int, help="Its frames a second [20].")
@click.option("--size", type=int, help="Its width in pixels [600].")
@click.option("--fmi", type=click.Choice(["2", "3"]), help="Of a rig: version of the standard [2].")
@click.option("--reference", "wished", is_flag=True, help="Of a rig: its reference is an output.")
@SETTING
@click.option(
    "--render",
    type=click.Choice(("plate", "mujoco")),
    help="What it shows: the plate from above, or the mechanism in 3D by EGL or OSMesa [plate].",
)
def export(
    run: Path,
    file: Path,
    beside: tuple[Path, ...],
    fmi: str | None,
    wished: bool,
    overrides: tuple[str, ...],
    **cut: Any,
) -> int:
    """Export the signals of a run to a .csv, .mat, .parquet or .mcap file, or the run as it moved.

    A picture that moves is a .webp, .gif or, by the extra video, .mp4:
    ballplate export runs/circle circle.webp --beside runs/cure --seconds 8

    In place of a run, a scenario's rig can be exported, for Simulink and other tools, as an .fmu:
    ballplate export circle rig.fmu --fmi 3 --set plant.friction.rolling_mm=0.1
    """
    if file.suffix == ".fmu":
        if beside or any(a is not None for a in cut.values()):
            raise RecordError(
                f"{file}: of an .fmu there are the options --fmi, --reference, --on and --set only"
            )
        from ballplate.rigs import fmu

        made = fmu(run, file, overrides, fmi=int(fmi or 2), wished=wished, reporter=TERMINAL)
        say(f"written to {made}")
        return 0
    if fmi or wished or overrides:
        raise RecordError(f"{file}: --fmi, --reference, --on, --set are of a scenario's rig: .fmu")
    from ballplate.comparing import labelled
    from ballplate.results import Result

    given = {name: value for name, value in cut.items() if value is not None}
    moving = file.suffix in MOVING
    if not moving and (given or beside):
        raise RecordError(
            f"{file}: --beside, --from, --to, --seconds, --fps, --size, --render are of moving "
            "pictures: .webp, .gif, .mp4"
        )
    opened = [each for path in (run, *beside) for each in _opened((path,))]
    if not moving:
        if len(opened) > 1:
            raise RecordError(f"{run}: holds {len(opened)} runs; name one of them")
        opened[0].export(file)
        say(f"written to {file}: {len(opened[0].time)} rows of {len(opened[0])} columns")
        return 0
    (name, first), *others = labelled([Result.from_run(each) for each in opened]).items()
    first.label, first.beside = name, dict(others)
    first.export(file, **given, reporter=TERMINAL)
    say(f"written to {file}{'' if file.suffix else '/'}")
    return 0


@click.command(cls=Command, example="docs")
def docs() -> int:
    """Open the pages about all this in a browser, from this machine's disk."""
    index = model_path().parents[1] / "site" / "index.html"
    if not index.exists():
        where = "in a checkout of the project: uv run python docs/build.py"
        raise TwinError(f"docs: the pages have not been made here; {where}")
    webbrowser.open(index.as_uri())
    say(index.as_uri())
    return 0
