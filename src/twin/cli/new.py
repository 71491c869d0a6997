"""The command new: commented starts of laws, observers, references, scenarios and studies."""

from __future__ import annotations

import keyword
import re
from pathlib import Path
from typing import Any, NamedTuple

import click

from twin.base.data_file import read_tables, read_toml
from twin.base.errors import ScenarioError, naming, nearest
from twin.base.shipped import find, folder, shipped_scenarios
from twin.base.writing import write_whole
from twin.cli import options
from twin.cli.output import say


class Start(NamedTuple):
    """A start.

    Attributes:
        source: Its file in ``scenarios/starts``.
        called: What the class in it is called, and its name; empty for tables.
        then: What to do with it.
    """

    source: str
    called: tuple[str, str]
    then: str


STARTS_IN = folder() / "starts"
_START_TABLES = read_toml(STARTS_IN / "starts.toml")
LAW_STARTS: dict[str, dict[str, Any]] = _START_TABLES["like"]
"""What a law may begin as: what its start has otherwise."""
START_FILES = {kind: Start(**about) for kind, about in _START_TABLES["starts"].items()}
LAW_NAME_PATTERN = re.compile(r"[a-z][a-z0-9_]{0,39}")


@options.command(example="new law mine --like pid")
@click.argument("kind", type=click.Choice(list(START_FILES)))
@click.argument("name")
@click.option(
    "--like",
    metavar="NAME",
    shell_complete=lambda *_: [*LAW_STARTS, *shipped_scenarios()],
    help="What a law begins as: cascade, pid (has a memory), lqr (designs on the model) or blank "
    "[cascade]; the scenario to copy.",
)
def new(kind: str, name: str, like: str | None) -> int:
    """Write a commented start: a law, observer or reference into laws/, or a scenario or study."""
    if not LAW_NAME_PATTERN.fullmatch(name) or keyword.iskeyword(name):
        allowed = "small letters, digits and _, no word of Python, as in my_law"
        raise ScenarioError(f"NAME '{name[:60]}': must be {allowed}")
    from twin.scenario.schema import CATALOG_TABLES, choices

    start = START_FILES[kind]
    if like is not None:
        start = _begin_like(kind, like)
    is_class = bool(start.called[0])
    file = Path("laws") / f"{name}.py" if is_class else Path(f"{name}.toml")
    if file.exists():
        raise ScenarioError(f"{file}: exists; nothing was written, choose another NAME")
    for table in CATALOG_TABLES:
        taken = choices(table).get(name)
        if is_class and taken:
            raise ScenarioError(f"{kind} '{name}': the name is taken by {taken.__module__}")
    text = (STARTS_IN / start.source).read_text(encoding="utf-8")
    words = name.replace("_", " ").capitalize()
    class_name = "".join(part.capitalize() for part in name.split("_"))
    if is_class:
        text = re.sub(rf"\b{start.called[0]}\b", class_name, text)
        text = text.replace(f'"{start.called[1]}"', f'"{name}"')
    elif like is None:
        text = text.replace('"TITLE"', f'"{words}"').replace("FILE", str(file), 1)
    write_whole(file, text)
    say(f"written to {file}; try: ballplate {start.then.format(name=name, file=file)}")
    return 0


def _begin_like(kind: str, like: str) -> Start:
    """The start of a law of a kind that is known, or of a scenario that is a copy.

    Raises:
        ScenarioError: If there is none of this name, the kind has only one start, or what is to be
            copied cannot be read.
    """
    start = START_FILES[kind]
    if kind == "scenario":
        with naming("--like"):
            file = find(like).resolve()
            read_tables(file)
        return start._replace(source=str(file))
    if kind != "law":
        raise ScenarioError(
            "--like: for a law or a scenario, as in: ballplate new law mine --like pid"
        )
    if like not in LAW_STARTS:
        raise ScenarioError(f"--like: no '{like[:60]}'{nearest(like, LAW_STARTS)}")
    return start._replace(**LAW_STARTS[like])
