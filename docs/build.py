"""Makes the site: every page of this folder, the commands and the Python interface, searchable.

uv run python docs/build.py            # into site/; ballplate docs opens it
uv run python docs/build.py FOLDER     # into an empty folder
"""

from __future__ import annotations

import re
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import click
from sphinx.cmd.build import main as sphinx

import ballplate

HERE = Path(__file__).parent
KEPT = ("", ".md", ".png", ".svg", ".webp", ".gif")
LINK = re.compile(r"(?<!!)\[([^\]]*)\]\(([^)#\s]+)(#[^)\s]*)?\)")
COMMANDS = """# Commands

What `--help` says, of every command.

```{eval-rst}
.. click:: twin.cli:ballplate
   :prog: ballplate
   :nested: full
```
"""
PYTHON = """# Python interface

```{eval-rst}
.. automodule:: ballplate
```
"""


def members() -> Iterator[str]:
    """Everything public, each documented from its docstring."""
    for name in ballplate.__all__:
        found = getattr(ballplate, name)
        kind = "class" if isinstance(found, type) else "function" if callable(found) else "data"
        # a module's value is where it lies on this machine
        more = {"class": "\n   :members:", "data": "\n   :no-value:"}.get(kind, "")
        yield f"\n```{{eval-rst}}\n.. auto{kind}:: ballplate.{name}{more}\n```\n"


MADE = {
    "reference-commands.md": ("Every command", COMMANDS),
    "reference-python.md": ("The Python interface", PYTHON + "".join(members())),
}
"""Pages made of the program: file, title, text."""
MENU = "\n```{{toctree}}\n:hidden:\n\n{}\n```\n"


def source(folder: Path) -> None:
    """Lay out what Sphinx reads: the pages, and those that are made of the program."""

    def no_part(_: str, names: list[str]) -> list[str]:
        return [name for name in names if Path(name).suffix not in KEPT or ".template" in name]

    shutil.copytree(HERE, folder, ignore=no_part)
    for page in folder.rglob("*.md"):
        page.write_text(within(HERE / page.relative_to(folder)), encoding="utf-8")
    for name, (_, text) in MADE.items():
        (folder / name).write_text(text, encoding="utf-8")
    for name, text in sections((folder / "index.md").read_text(encoding="utf-8")).items():
        (folder / name).write_text(text, encoding="utf-8")


def within(page: Path) -> str:
    """A page whose links to what is no part of the site are its words alone.

    Raises:
        click.ClickException: A link leads to nothing.
    """

    def kept(match: re.Match[str]) -> str:
        text, target = match[1], match[2]
        if target.startswith(("http:", "https:", "mailto:")):
            return match[0]
        to = (page.parent / target).resolve()
        if not to.exists():
            raise click.ClickException(f"{page.relative_to(HERE.parent)}: no {target}")
        return match[0] if HERE in to.parents and to.suffix in KEPT else text

    return LINK.sub(kept, page.read_text(encoding="utf-8"))


def sections(index: str) -> dict[str, str]:
    """The start page with a menu of the index's headings, and a page for each of its lists."""
    start, *parts = index.split("\n## ")
    made = dict[str, str]()
    menu = list[str]()
    for part in parts:
        heading, _, text = part.partition("\n")
        pages = [each[2] for each in LINK.finditer(text) if each[2].endswith(".md")]
        if heading == "Reference":
            pages += MADE
            text += "".join(f"- [{title}]({name})\n" for name, (title, _) in MADE.items())
        name = pages[0]
        if len(pages) > 1:
            name = re.sub(r"\W+", "-", heading.lower()) + ".md"
            made[name] = f"# {heading}\n{text}" + MENU.format("\n".join(pages))
        menu.append(f"{heading} <{name}>")
    return made | {"index.md": start + "\n" + MENU.format("\n".join(menu))}


def main(out: Path | None = None) -> None:
    """Make the site, again in ``site`` or in an empty folder; a warning of any page is an error."""
    with TemporaryDirectory() as temporary:
        folder = Path(temporary) / "pages"
        source(folder)
        if out is None:
            out = HERE.parent / "site"
            shutil.rmtree(out, ignore_errors=True)
        options = ["-q", "-W", "--keep-going", "-c", str(HERE), "-d", f"{temporary}/trees"]
        sys.exit(sphinx([*options, "-b", "html", str(folder), str(out)]))


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
