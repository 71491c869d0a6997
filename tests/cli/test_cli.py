"""`twin.cli.output`.

The command line as a whole: how it begins, what it refuses, what it says meanwhile."""

import io
import json
import re
import shlex
import shutil
import time
from collections import Counter
from pathlib import Path

import click
import pytest
from rich.console import Console

from twin.base.shipped import shipped_in
from twin.cli import COMMAND_GROUPS, COMMANDS, COMMON_COMMANDS, output
from twin.cli import ballplate as program


def test_list_shows_every_scenario_with_its_title(ballplate):
    code, out, _ = ballplate("list")
    assert code == 0
    assert "circle" in out
    assert "Hold on the centre" in out


@pytest.mark.parametrize("command", ["study", "tune", "fit"])
def test_without_a_name_what_is_shipped_is_listed(ballplate, command):
    code, out, _ = ballplate(command, "--json")
    assert code == 0
    assert list(json.loads(out)) == list(
        shipped_in({"study": "studies"}.get(command, f"{command}s"))
    )


def every_command():
    """Each command and each part of one, by what is typed for it."""
    whole = click.Context(program)
    for name in program.list_commands(whole):
        command = program.get_command(whole, name)
        yield name, command
        for part in getattr(command, "commands", {}).values():
            yield f"{name} {part.name}", part


EVERY = dict(every_command())


COMMAND = re.compile(r"^(?:\$ | {4})?(?:uv run )?ballplate ([a-z].*)$", re.MULTILINE)
"""A command that a page shows: in a block, indented or after a prompt."""
ROOT = Path(__file__).parents[2]
PAGES = [
    page
    for page in (*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"))
    if not page.name.endswith(".template.md")
]


def parsed(line):
    """The command of a line without its ``ballplate``, once click has read it all; runs nothing."""
    name, *words = shlex.split(line.split(" > ")[0], comments=True)
    command = program.get_command(click.Context(program), name)
    assert command is not None, f"no command {name}"
    if isinstance(command, click.Group):
        name, *words = words
        command = command.commands[name]
    command.make_context(name, words)
    return command


def test_without_arguments_it_says_what_help_says(ballplate):
    code, out, _ = ballplate()
    assert (code, out) == (0, ballplate("--help")[1])


def test_every_command_is_in_one_group_and_the_most_used_stand_first(ballplate):
    counts = Counter(name for names in COMMAND_GROUPS.values() for name in names)
    assert counts == dict.fromkeys(COMMANDS, 1)
    assert len(set(COMMON_COMMANDS)) == 8
    _, out, _ = ballplate("--help")
    first, rest = out.split("Options:")
    assert [line.split()[1] for line in first.splitlines() if "  ballplate " in line] == [
        *COMMON_COMMANDS
    ]
    titles = [line.removesuffix(":") for line in rest.splitlines() if line[:1].isupper()]
    assert titles == [*COMMAND_GROUPS]
    listed = [line.split()[0] for line in rest.splitlines() if line[:3].strip().isalpha()]
    assert [name for name in listed if name in COMMANDS] == [*COMMANDS]


@pytest.mark.parametrize("name", EVERY)
def test_the_help_of_a_command_begins_with_an_example_that_can_be_typed(ballplate, name):
    command = EVERY[name]
    _, out, _ = ballplate(*name.split(), "--help")
    assert out.splitlines()[0] == f"Example: ballplate {command.example}"
    assert len(out.splitlines()[0]) <= 80
    meant = EVERY[
        {"calibrate": "calibrate cams", "lab": "lab check", "bench": "bench run"}.get(name, name)
    ]
    assert parsed(command.example) is meant


@pytest.mark.parametrize("terminal", [False, True])
def test_progress_says_what_is_done_of_how_much(monkeypatch, terminal):
    said = io.StringIO()
    monkeypatch.setattr(output, "errors", Console(file=said, force_terminal=terminal, width=100))
    monkeypatch.setattr("ballplate.reporter.LINE_EVERY", -1.0)
    monkeypatch.setattr(output.click, "echo", lambda line, err: said.write(f"{line}\n"))
    with output.progress("study", 120, "runs") as advance:
        advance(30, "1 failed")
        time.sleep(0.0 if not terminal else 0.2)
    assert "30 of 120 runs, 1 failed" in said.getvalue()
    with output.progress("fit", 2.0) as advance:
        advance(0.5)
        time.sleep(0.0 if not terminal else 0.2)
    assert "25%" in said.getvalue()


def test_every_command_that_a_page_shows_can_be_typed(ballplate, own_laws, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where the pages' reader has made the law and the lab they name
    assert ballplate("new", "law", "mine")[0] == 0
    assert ballplate("lab", "new", "hold_it")[0] == 0
    shutil.copytree(ROOT / "examples" / "board", tmp_path / "examples" / "board")
    (tmp_path / "controller.elf").touch()
    for rig in ("FILE", "runs/identify-mine/parameters.toml"):
        (tmp_path / rig).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / rig).touch()
    for page in PAGES:
        for line in COMMAND.findall(page.read_text(encoding="utf-8").replace("\\\n", " ")):
            try:
                parsed(line)
            except (click.ClickException, AssertionError) as error:
                pytest.fail(f"{page.name}: {line}: {error}")


def test_a_sentence_that_is_piped_is_one_line(capsys):
    sentence = "word " * 60 + "end"
    output.show({}, shown=[sentence])
    assert capsys.readouterr().out == sentence + "\n"
