"""The commands of ``ballplate lab``: what is asked of a class, and how its answers are judged."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from twin.cli.options import JSON, Command, Group
from twin.cli.output import say, show, show_titles
from twin.errors import ScenarioError
from twin.shipped import titles

OUT = click.Path(path_type=Path)
KEY = click.option(
    "--key",
    "key",
    type=OUT,
    callback=lambda _, __, file: _key(file),
    help="File of the course's key.",
)
LAB = click.argument("lab")


def _key(file: Path | None) -> str | None:
    if file is None:
        return None
    try:
        text = file.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise ScenarioError(f"--key {file}: cannot be read: {error}") from None
    if len(text) < 8:
        raise ScenarioError(f"--key {file}: a key has at least 8 characters, of one line")
    return text


@click.group(cls=Group, example="lab check friction answer.py")
def lab() -> None:
    """Labs that mark themselves, each student on a rig of their own."""


@lab.command("list", cls=Command, example="lab list")
@JSON
def list_labs(*, as_json: bool) -> int:
    """List the shipped labs."""
    from twin.lab.schema import shipped_labs

    files = {name: place / "lab.toml" for name, place in shipped_labs().items()}
    show_titles(titles(files), as_json=as_json)
    return 0


@lab.command(cls=Command, example="lab start signs --student ann")
@LAB
@click.option("--student", required=True, help="Your name or number.")
@click.option("--out", type=OUT, help="New folder [LAB-STUDENT].")
@KEY
def start(lab: str, student: str, out: Path | None, key: str | None) -> int:
    """Begin a lab: the sheet, a starter that runs, the rig of your own.

    Without the course's key the rig is one to practise on; your lecturer hands out yours.
    """
    from twin.lab.schema import read
    from twin.lab.variants import check_name, deal, hand_out
    from twin.writing import write_folder

    about = read(lab)
    check_name(student)
    folder = out or Path(f"{about.about.name}-{student}")
    dealt = deal(about, student, key)
    write_folder(folder, lambda inner: hand_out(about, dealt, inner, practice=key is None))
    say(f"{folder}/: task.md, {about.about.answer.file}, rig.toml; then: ballplate lab check {lab}")
    return 0


@lab.command(cls=Command, example="lab check signs answer.py")
@LAB
@click.argument("answer", required=False, type=OUT)
@click.option("--student", help="Whose rig, where no rig.toml beside the answer says so.")
@KEY
@click.option("--hidden", is_flag=True, help="Judge hidden checks, too, where they are.")
@click.option("--user", help="Whom the answer's process shall belong to.")
@click.option("--as", "form", type=click.Choice(["gradescope", "classroom50", "junit"]))
@click.option("--out", type=OUT, help="File to write the result to.")
@JSON
def check(
    lab: str,
    answer: Path | None,
    form: str | None,
    out: Path | None,
    *,
    as_json: bool,
    **how: Any,
) -> int:
    """Judge an answer: what passed, why not, where to look; exit code 1 if a check did not pass.

    The answer is a file, by default that of the lab in this folder, or a folder with it.
    """
    from ballplate.lab import check as judge
    from twin.lab.results import FORMS, table
    from twin.lab.schema import read
    from twin.writing import write_whole

    if answer is not None and answer.is_dir():
        answer = answer / read(lab).about.answer.file
    result = judge(lab, answer, **how)
    if out is not None:
        write_whole(out, FORMS[form or "json"](result))
    show(result, as_json, [table(result)], out)
    return 0 if all(each["passed"] for each in result["results"]) else 1


@lab.command(cls=Command, example="lab variants signs class.csv --key key.txt")
@LAB
@click.argument("students", type=OUT)
@KEY
@click.option("--out", type=OUT, help="New folder with one a student [variants-LAB].")
@JSON
def variants(lab: str, students: Path, key: str | None, out: Path | None, *, as_json: bool) -> int:
    """Deal every student of a class a rig of their own, and write what each begins with.

    The class is a CSV file whose first column names the students, below a heading.
    """
    from twin.cli.output import progress
    from twin.lab import variants as deals
    from twin.lab.schema import read
    from twin.page import Table
    from twin.writing import write_folder

    about, names = read(lab), deals.students(students)
    folder = out or Path(f"variants-{about.about.name}")
    dealt = [deals.deal(about, name, key) for name in names]

    def fill(inner: Path) -> None:
        with progress("variants", len(dealt), "students") as advance:
            for number, each in enumerate(dealt, 1):
                deals.hand_out(about, each, inner / each.student, practice=key is None)
                advance(number)

    write_folder(folder, fill)
    keys = list(dealt[0].point)
    rows = [
        (each.student, each.code, *(f"{each.point[key]:.4g}" for key in keys)) for each in dealt
    ]
    show(
        [each._asdict() for each in dealt],
        as_json,
        [Table(f"{about.about.title}: {len(dealt)} rigs", ("student", "code", *keys), rows)],
        folder,
    )
    return 0
