"""The commands describe and new: what may be set, and a working start of one's own."""

from __future__ import annotations

import keyword
import re
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from twin.cli import options
from twin.cli.output import Shown, bold, console, show
from twin.data_file import read_toml
from twin.errors import ScenarioError
from twin.shipped import folder

if TYPE_CHECKING:
    from twin.scenario.describe import Key


WORDS = {"laws": "controller", "observers": "observer", "references": "reference"}
"""What lists all of a kind, and the table of a scenario that names one."""


@options.command(example="describe plant.friction")
@click.argument(
    "name", metavar="[KEY|TABLE|KIND]", required=False, default="", shell_complete=options.names
)
@options.LAW
@options.JSON
def describe(name: str) -> int:
    """Describe what a scenario may set: a key, a table, or a law, observer or reference.

    A word is looked for in the names, then in what they mean. `laws`, `observers` and `references`
    list those there are, with one sentence each.
    """
    from twin.scenario.describe import about, described

    if name in WORDS:
        return _kinds(WORDS[name])
    found = described(name)
    sentence = about(name)
    shown: list[Shown] = [bold(sentence)] if sentence else []
    shown += [line for key in found for line in _lines(key)] or ["It has no settings."]
    if not name:
        shown.append("Settings of a law, observer or reference: ballplate describe NAME")
    show([key.as_dict() for key in found], shown)
    return 0


def _kinds(table: str) -> int:
    """List the laws, observers or references with one sentence each."""
    from twin.scenario.describe import about
    from twin.scenario.schema import choices

    sentences = {kind: about(f"{table}.{kind}") for kind in choices(table)}
    told = [f"{kind}: {sentence}" for kind, sentence in sentences.items()]
    told.append(f"Settings of each: ballplate describe NAME; {table}.kind=NAME takes it")
    show(sentences, told)
    return 0


def _lines(key: Key) -> Iterator[Shown]:
    unit = f" {key.unit}" if key.unit and not key.required and key.default is not None else ""
    of = f" ({key.unit})" if key.unit and not unit else ""
    only = "; plant.kind=mujoco only" if key.plants else ""
    yield bold(f"{key.key} = {key.value}{unit}")
    whose = f"{key.kind}: " if key.kind else ""
    facts = f"{whose}{key.type}{of}{f', {key.allowed}' if key.allowed else ''}{only}"
    for text in (key.meaning, f"[{facts}]"):
        yield from (f"    {line}" for line in textwrap.wrap(text, max(console.width - 4, 40)))


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
_TABLES = read_toml(STARTS_IN / "starts.toml")
LIKE: dict[str, dict[str, Any]] = _TABLES["like"]
"""What a law may begin as: what its start has otherwise."""
STARTS = {kind: Start(**about) for kind, about in _TABLES["starts"].items()}
NAME = re.compile(r"[a-z][a-z0-9_]{0,39}")


@options.command(example="new law mine --like pid")
@click.argument("kind", type=click.Choice(list(STARTS)))
@click.argument("name")
@click.option(
    "--like",
    type=click.Choice(list(LIKE)),
    help="What a law begins as: pid has a memory, lqr designs on the model  [cascade]",
)
def new(kind: str, name: str, like: str | None) -> int:
    """Write a commented start: a law, observer or reference into laws/, or a scenario or study."""
    if not NAME.fullmatch(name) or keyword.iskeyword(name):
        allowed = "small letters, digits and _, no word of Python, as in my_law"
        raise ScenarioError(f"NAME '{name[:60]}': must be {allowed}")
    start = STARTS[kind]
    if like is not None:
        if kind != "law":
            raise ScenarioError("--like: for a law only, as in: ballplate new law mine --like pid")
        start = start._replace(**LIKE[like])
    file = Path("laws") / f"{name}.py" if start.called[0] else Path(f"{name}.toml")
    if file.exists():
        raise ScenarioError(f"{file}: exists; nothing was written")
    if start.called[0]:
        _require_free(kind, name)
    text = (STARTS_IN / start.source).read_text(encoding="utf-8")
    words = name.replace("_", " ").capitalize()
    class_name = "".join(part.capitalize() for part in name.split("_"))
    if start.called[0]:
        text = re.sub(rf"\b{start.called[0]}\b", class_name, text)
        text = text.replace(f'"{start.called[1]}"', f'"{name}"')
    else:
        text = text.replace('"TITLE"', f'"{words}"').replace("FILE", str(file), 1)
    try:
        file.parent.mkdir(exist_ok=True)
        file.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ScenarioError(f"{file}: cannot be written: {error.strerror}") from error
    console.print(f"written to {file}; try: ballplate {start.then.format(name=name, file=file)}")
    return 0


def _require_free(kind: str, name: str) -> None:
    """Make sure that no other class has the name.

    Raises:
        ScenarioError: If one has.
    """
    from twin.scenario.schema import KINDS, choices

    for table in KINDS:
        taken = choices(table).get(name)
        if taken is not None:
            raise ScenarioError(f"{kind} '{name}': the name is taken by {taken.__module__}")
