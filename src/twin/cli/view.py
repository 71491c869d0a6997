"""The command view: recorded runs in the viewer."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import click

from twin.cli import completion as tab
from twin.cli.options import SETTING
from twin.cli.output import console
from twin.cli.viewing import AGAINST, SERVE
from twin.cli.viewing import opened as open_all
from twin.errors import TwinError, ViewError

if TYPE_CHECKING:
    from twin.run.finished import Run

LAYOUTS = ("showing", "tuning")


@click.command()
@click.argument("runs", nargs=-1, type=click.Path(path_type=Path), shell_complete=tab.runs)
@AGAINST
@SETTING
@click.option(
    "--layout",
    type=click.Choice(LAYOUTS),
    expose_value=False,
    hidden=True,
    help="Of an earlier version, which had two; now nothing.",
)
@click.option("--rrd", type=click.Path(path_type=Path), help="Write a recording, open no viewer.")
@click.option("--screenshot", "picture", type=click.Path(path_type=Path), help="Save a picture.")
@click.option("--at", type=float, help="Simulated time of the picture in s [the middle].")
@SERVE
@click.option("--connect", metavar="ADDRESS", help="Send to the viewer at HOST:PORT.")
def view(
    runs: tuple[Path, ...],
    against: str | None,
    overrides: tuple[str, ...],
    rrd: Path | None,
    picture: Path | None,
    at: float | None,
    serve: int | None,
    connect: str | None,
) -> int:
    """Open run folders in the Rerun viewer, several side by side on one time line.

    RUNS are run folders, folders of such, CSV logs with --against, or `last`; the newest run if
    there is none.
    """
    opened = open_all(runs, against, overrides)
    from twin.view.live import address, reach  # heavy: after a wrong name was told
    from twin.view.recording import forward, screenshot, write

    if connect is not None:
        forward(reach(address(connect)), opened)
        console.print(f"sent to {connect}")
        return 0
    if rrd is not None:
        write(rrd, opened)
        console.print(f"written to {rrd}")
        if picture is None:
            return 0
    with tempfile.TemporaryDirectory(prefix="ballplate-") as folder:
        recording = rrd or Path(folder) / "view.rrd"
        if rrd is None:
            write(recording, opened)
        if picture is not None:
            screenshot(recording, picture, _instant(opened, at))
            console.print(f"written to {picture}")
            return 0
        return _show(recording, serve)


def _show(recording: Path, serve: int | None) -> int:
    """Keep a viewer open until it is closed."""
    from twin.view import viewer

    opened = viewer.window(recording) if serve is None else viewer.page(serve, recording)
    if opened.page:
        console.print(f"open {opened.page} in a browser; Ctrl-C ends it", soft_wrap=True)
    try:
        code = opened.process.wait()
    except KeyboardInterrupt:
        opened.close()
        return 0
    if code:
        raise ViewError("the viewer ended with an error; use --rrd FILE or --serve")
    return 0


def _instant(opened: list[Run], at: float | None) -> float:
    """The instant to show, within the run."""
    end = max(float(run.rows["time"][-1]) for run in opened)
    if at is not None and not 0 <= at <= end:
        raise TwinError(f"--at {at:g}: the run goes from 0 to {end:g} s")
    return end / 2 if at is None else at
