"""Makes the generated pages and pictures of this folder again, each by one command.

uv run python docs/regenerate.py --list
uv run python docs/regenerate.py safety circle
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import click

HERE = Path(__file__).parent


class Page(NamedTuple):
    """Something generated.

    Attributes:
        files: What it is made of, as patterns in this folder.
        command: What makes it, after ``ballplate``, or a script of this folder, or a module
            after ``-m``; ``TEMPORARY`` stands for an empty folder that is gone afterwards.
        kept: What is taken from there.
    """

    files: tuple[str, ...]
    command: tuple[str, ...]
    kept: tuple[tuple[str, str], ...] = ()


PAGES = {
    "circle": Page(
        ("circle.png",),
        ("run", "circle", "--beside", "cure", "--out", "TEMPORARY"),
        (("picture.png", "circle.png"),),
    ),
    "view": Page(("view-*.png",), ("screenshots.py",)),
    "play": Page(("play.png",), ("play_picture.py",)),
    "cure": Page(("cure.md", "figures/cure.svg"), ("cure.py",)),
    "tuned": Page(("tuned.md", "figures/tuned.svg"), ("tuned.py",)),
    "cure_attacks": Page(("cure_attacks.md",), ("cure_attacks.py",)),
    "claims": Page(("claims.md",), ("claims.py",)),
    "settings": Page(("settings.md",), ("settings.py",)),
    "performance": Page(
        ("performance.md", "data/performance.toml"),
        ("-m", "benchmarks", "--doc", "docs/performance.md"),
    ),
    "learning": Page(
        ("learning.md", "learning.png"),
        ("../examples/learning.py",),
        (("learning.md", "learning.md"), ("learning.png", "learning.png")),
    ),
    "bring-up": Page(("bring-up.md",), ("bring_up.py",)),
    "shadow": Page(("shadow.md",), ("shadow_trials.py",)),
    "safety": Page(("safety.md",), ("safety", "--doc", "docs/safety.md")),
    "reproduction": Page(
        ("reproduction.md", "figures/table-*.png", "figures/neglected.png"),
        ("chapter8.py",),
    ),
    "experiments": Page(("experiments.md", "figures/experiments.png"), ("chapter9.py",)),
    **{
        f"study-{name}": Page(
            (f"studies/{name}.md", f"studies/{name}-*.svg"),
            ("study_page.py", name),
        )
        for name in ("friction", "gains", "tournament", "what_matters")
    },
}


def make(page: Page) -> int:
    """Make a page; the exit code of its command."""
    with TemporaryDirectory() as folder:
        command = [folder if part == "TEMPORARY" else part for part in page.command]
        if command[0].endswith(".py"):
            program = [sys.executable, str(HERE / command[0])]
        elif command[0] == "-m":
            program = [sys.executable, *command]
        else:
            call = "from twin.cli import main; main()"
            program = [sys.executable, "-c", call, *command]
        code = subprocess.call(program, cwd=folder if page.kept else HERE.parent)
        for made, name in page.kept if code == 0 else ():
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
