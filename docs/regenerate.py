"""Makes the generated pages and pictures of this folder again, each by one command.

uv run python docs/regenerate.py --list
uv run python docs/regenerate.py safety circle
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import click

HERE = Path(__file__).parent


class Page(NamedTuple):
    """Something generated; see regenerate.toml."""

    files: list[str]
    command: list[str]
    kept: dict[str, str] = {}  # noqa: RUF012  never changed


PAGES = {
    name: Page(**about)
    for name, about in tomllib.loads((HERE / "regenerate.toml").read_text("utf-8")).items()
}


def program(page: Page, folder: str) -> list[str]:
    """What is called to make a page, with an empty folder for what is not kept."""
    first, *others = [folder if part == "TEMPORARY" else part for part in page.command]
    if first.endswith(".py"):
        return [sys.executable, str(HERE / first), *others]
    if first == "-m":
        return [sys.executable, first, *others]
    return [sys.executable, "-m", "twin", first, *others]


def make(page: Page) -> int:
    """Make a page; the exit code of its command."""
    with TemporaryDirectory() as folder:
        code = subprocess.call(program(page, folder), cwd=folder if page.kept else HERE.parent)
        for made, name in page.kept.items() if code == 0 else ():
            shutil.copyfile(Path(folder) / made, HERE / name)
    return code


@click.command(epilog=f"NAME is one of {', '.join(PAGES)}.")
@click.argument("names", nargs=-1, metavar="[NAME]...", type=click.Choice(list(PAGES)))
@click.option("--list", "only_list", is_flag=True, help="Only say what is made by what.")
def main(names: tuple[str, ...], *, only_list: bool) -> None:
    """Make the generated pages of docs/ again; exit code 1 if a command failed."""
    codes = []
    for name in names or PAGES:
        page = PAGES[name]
        if only_list:
            click.echo(f"{name:<18} {' '.join(page.files)}: {' '.join(page.command)}")
            continue
        begin = time.monotonic()
        codes.append(make(page))
        click.echo(f"{name}: {time.monotonic() - begin:.0f} s, exit code {codes[-1]}")
    sys.exit(int(any(codes)))


if __name__ == "__main__":
    main()
