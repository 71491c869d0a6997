"""The command report: recorded runs as a page, pictures or a table."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from twin.cli import completion as tab
from twin.cli.options import SETTING
from twin.cli.output import console
from twin.cli.viewing import AGAINST
from twin.cli.viewing import opened as open_all
from twin.errors import RecordError
from twin.run.files import run_folder

if TYPE_CHECKING:
    from twin.run.finished import Run

ENDINGS = {"html": ".html", "png": ".png", "pdf": ".pdf", "csv": ".csv", "latex": ".tex"}
"""Format to the ending of its file."""


def _contents(kind: str, runs: list[Run]) -> dict[str, bytes]:
    """What is added to the stem of each file of a format, and the file's content."""
    from twin.report.numbers import as_csv, as_latex

    match kind:
        case "png" | "pdf":
            from twin.report.html import details, encoded, overview

            return {
                "": encoded(overview(runs), kind),
                "-details": encoded(details(runs), kind),
            }
        case "csv":
            return {"": as_csv(runs).encode()}
        case "latex":
            return {"": as_latex(runs).encode()}
    from twin.report.html import html

    return {"": html(runs).encode()}


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
        wrong = [name for name in names if name not in ENDINGS]
        if wrong:
            self.fail(f"no format '{wrong[0]}' (known: {', '.join(ENDINGS)})", param, ctx)
        return names


@click.command()
@click.argument("runs", nargs=-1, type=click.Path(path_type=Path), shell_complete=tab.runs)
@AGAINST
@SETTING
@click.option(
    "--format", "formats", type=Formats(), default="html", metavar="html,png,pdf,csv,latex"
)
@click.option("--out", type=click.Path(path_type=Path), help="File without ending [RUN/report].")
def report(
    runs: tuple[Path, ...],
    against: str | None,
    overrides: tuple[str, ...],
    formats: tuple[str, ...],
    out: Path | None,
) -> int:
    """Report on one run folder, or compare several: a page, pictures, a table.

    RUNS are run folders, folders of such, CSV logs with --against, or `last`; the newest run if
    there is none.
    """
    opened = open_all(runs, against, overrides)
    folder = opened[0].folder
    if folder is None:
        stem = out or run_folder(f"{opened[0].name}-against-{against}", overrides) / "report"
    else:
        stem = out or (folder if len(opened) == 1 else folder.parent) / "report"
    if stem.suffix in ENDINGS.values():
        stem = stem.with_suffix("")
    if stem.is_dir():
        raise RecordError(f"--out {stem}: is a folder; give a file name without ending")
    for name in formats:
        for more, content in _contents(name, opened).items():
            path = stem.with_name(f"{stem.name}{more}{ENDINGS[name]}")
            _write(path, content)
            console.print(f"written to {path}")
    return 0


def _write(path: Path, content: bytes) -> None:
    from twin.writing import write_whole

    write_whole(path, lambda target: target.write_bytes(content))
