"""Makes the site: every page of this folder, the commands and the Python interface, searchable.

uv run python docs/build.py            # into site/; ballplate docs opens it
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


def source(folder: Path) -> None:
    """Lay out what Sphinx reads: the pages, and those that are made of the program."""

    def no_part(_: str, names: list[str]) -> list[str]:
        return [name for name in names if Path(name).suffix not in KEPT or ".template" in name]

    shutil.copytree(HERE, folder, ignore=no_part)
    for page in folder.rglob("*.md"):
        page.write_text(within(HERE / page.relative_to(folder)), encoding="utf-8")
    for name, (_, text) in MADE.items():
        (folder / name).write_text(text, encoding="utf-8")
    index = folder / "index.md"
    index.write_text(index.read_text(encoding="utf-8") + contents(folder), encoding="utf-8")


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


def contents(folder: Path) -> str:
    """The table of contents, in the order and under the headings of the index."""
    index = (folder / "index.md").read_text(encoding="utf-8")
    listed: set[str] = {"index.md"}
    parts = [f"- [{title}]({name})\n" for name, (title, _) in MADE.items()]
    for heading, *below in (part.split("\n") for part in index.split("\n## ")[1:]):
        pages = [match[2] for match in LINK.finditer("\n".join(below)) if match[2].endswith(".md")]
        pages = [page for page in dict.fromkeys(pages) if page not in listed]
        listed |= set(pages)
        pages += [*MADE] if heading == "Reference" else []
        lines = "\n".join(page.removesuffix(".md") for page in pages)
        parts.append(f"\n```{{toctree}}\n:hidden:\n:caption: {heading}\n\n{lines}\n```\n")
    return "".join(parts)


def main() -> None:
    """Make the site; a warning of any page is an error."""
    with TemporaryDirectory() as temporary:
        folder = Path(temporary) / "pages"
        source(folder)
        out = HERE.parent / "site"
        shutil.rmtree(out, ignore_errors=True)
        options = ["-q", "-W", "--keep-going", "-c", str(HERE), "-d", f"{temporary}/trees"]
        sys.exit(sphinx([*options, "-b", "html", str(folder), str(out)]))


if __name__ == "__main__":
    main()
