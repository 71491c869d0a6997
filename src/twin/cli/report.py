"""The command report: recorded runs as a page, pictures or a table."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import click

from twin.cli.against import AGAINST
from twin.cli.against import opened as open_all
from twin.cli.options import SETTING
from twin.cli.output import console
from twin.errors import RecordError
from twin.report.figures import Format, details, encoded, overview
from twin.report.html import html
from twin.report.numbers import as_csv, as_latex
from twin.run.folders import run_folder
from twin.run.record import write_whole
from twin.run.replay import Replay

Runs = list[Replay]


def _text(make: Callable[[Runs], str]) -> Callable[[Runs], dict[str, bytes]]:
    return lambda runs: {"": make(runs).encode()}


def _pictures(kind: Format) -> Callable[[Runs], dict[str, bytes]]:
    return lambda runs: {
        "": encoded(overview(runs), kind),
        "-details": encoded(details(runs), kind),
    }


FORMATS: dict[str, tuple[str, Callable[[Runs], dict[str, bytes]]]] = {
    "html": (".html", _text(html)),
    "png": (".png", _pictures("png")),
    "pdf": (".pdf", _pictures("pdf")),
    "csv": (".csv", _text(as_csv)),
    "latex": (".tex", _text(as_latex)),
}
"""Format to its file ending and what makes the files: ending of the stem to content."""


class Formats(click.ParamType[tuple[str, ...]]):
    """A list of formats with commas between."""

    name = "formats"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, ...]:
        """The formats named."""
        if isinstance(value, tuple):
            return value
        names = tuple(name.strip() for name in str(value).split(","))
        wrong = [name for name in names if name not in FORMATS]
        if wrong:
            self.fail(f"no format '{wrong[0]}' (known: {', '.join(FORMATS)})", param, ctx)
        return names


@click.command()
@click.argument("runs", nargs=-1, type=click.Path(path_type=Path))
@AGAINST
@SETTING
@click.option(
    "--rig", "rigs", multiple=True, type=int, help="Rig, if the record has several; repeatable."
)
@click.option(
    "--format", "formats", type=Formats(), default="html", metavar="html,png,pdf,csv,latex"
)
@click.option("--out", type=click.Path(path_type=Path), help="File without ending [RUN/report].")
def report(
    runs: tuple[Path, ...],
    against: str | None,
    overrides: tuple[str, ...],
    rigs: tuple[int, ...],
    formats: tuple[str, ...],
    out: Path | None,
) -> int:
    """Report on one run folder, or compare several: a page, pictures, a table.

    RUNS are run folders, folders of such, CSV logs with --against, or `last`; the newest run if
    there is none.
    """
    opened = open_all(runs, rigs, against, overrides)
    folder = opened[0].folder
    if folder is None:
        stem = out or run_folder(f"{opened[0].name}-against-{against}", overrides) / "report"
    else:
        stem = out or (folder if len(opened) == 1 else folder.parent) / "report"
    if stem.suffix in {ending for ending, _ in FORMATS.values()}:
        stem = stem.with_suffix("")
    if stem.is_dir():
        raise RecordError(f"--out {stem}: is a folder; give a file name without ending")
    for name in formats:
        ending, make = FORMATS[name]
        for more, content in make(opened).items():
            path = stem.with_name(f"{stem.name}{more}{ending}")
            _write(path, content)
            console.print(f"written to {path}")
    return 0


def _write(path: Path, content: bytes) -> None:
    write_whole(path, lambda target: target.write_bytes(content))
