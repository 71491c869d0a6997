"""The commands of ``ballplate lab``: what is asked of a class, and how its answers are judged."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import click

from twin.cli.options import JSON, PROCESSES, Command, Group
from twin.cli.output import progress, say, show, show_titles
from twin.errors import ScenarioError
from twin.shipped import titles


def _text(key: Path | None) -> str | None:
    """The course's key out of its file."""
    if key is None:
        return None
    try:
        text = key.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise ScenarioError(f"--key {key}: cannot be read: {error}") from None
    if len(text) < 8:
        raise ScenarioError(f"--key {key}: a key has at least 8 characters")
    return text


PATH = click.Path(path_type=Path)
LAB = click.argument("lab")
KEY = click.option("--key", type=PATH, help="File with the course's key.")
USER = click.option("--user", help="Whom the process of an answer shall belong to.")


@click.group(cls=Group, example="lab check signs answer.py")
def lab() -> None:
    """Labs that mark themselves, each student on a rig of their own."""


@lab.command("list", cls=Command, example="lab list")
@JSON
def list_labs(*, as_json: bool) -> int:
    """List the shipped labs."""
    from twin.shipped import shipped_labs

    files = {name: place / "lab.toml" for name, place in shipped_labs().items()}
    show_titles(titles(files), as_json=as_json)
    return 0


@lab.command(cls=Command, example="lab start signs --student ann")
@LAB
@click.option("--student", required=True, help="Your name or number.")
@click.option("--out", type=PATH, help="New folder [LAB-STUDENT].")
@KEY
def start(lab: str, student: str, out: Path | None, key: Path | None) -> int:
    """Begin a lab: the sheet, a starter that runs, the rig of your own.

    Without the course's key the rig is one to practise on; your lecturer hands out yours.
    """
    from twin.lab.schema import read
    from twin.lab.variants import hand_out

    about = read(lab)
    folder = out or Path(f"{about.about.name}-{student}")
    hand_out(about, [student], _text(key), folder)
    say(f"{folder}/: task.md, {about.about.answer.file}, rig.toml; then: ballplate lab check {lab}")
    return 0


@lab.command(cls=Command, example="lab check signs answer.py")
@LAB
@click.argument("answer", required=False, type=PATH)
@click.option("--student", help="Whose rig, where no rig.toml beside the answer says so.")
@KEY
@click.option("--hidden", is_flag=True, help="Judge hidden checks, too, where they are.")
@USER
@click.option("--as", "form", type=click.Choice(["json", "gradescope", "classroom50", "junit"]))
@click.option("--out", type=PATH, help="File to write the result to.")
@JSON
def check(
    lab: str, key: Path | None, form: str | None, out: Path | None, *, as_json: bool, **how: Any
) -> int:
    """Judge an answer: what passed, why not, where to look; exit code 1 if a check did not pass.

    The answer is a file, or a folder with it; by default that of this folder.
    """
    from ballplate.lab import check as judge
    from twin.lab.results import FORMS, table
    from twin.writing import write_whole

    result = judge(lab, **how, key=_text(key))
    if out is not None:
        write_whole(out, FORMS[form or "json"](result))
    show(result, as_json, [table(result)], out and out.parent, out.name if out else "")
    return 0 if all(each["passed"] for each in result["results"]) else 1


@lab.command(cls=Command, example="lab variants signs class.csv --key key.txt")
@LAB
@click.argument("students", type=PATH)
@KEY
@click.option("--out", type=PATH, help="New folder with one a student [variants-LAB].")
def variants(lab: str, students: Path, key: Path | None, out: Path | None) -> int:
    """Deal every student of a class a rig of their own, and write what each begins with.

    The class is a CSV file whose first column names the students, below a heading.
    """
    from twin.lab.schema import read
    from twin.lab.variants import hand_out
    from twin.lab.variants import students as named

    about, people = read(lab), named(students)
    folder = out or Path(f"variants-{about.about.name}")
    hand_out(about, people, _text(key), folder, each_own=True)
    say(f"{folder}/: {len(people)} rigs")
    return 0


@lab.command(cls=Command, example="lab grade signs submissions --key key.txt --out marks.csv")
@LAB
@click.argument("submissions", type=PATH)
@KEY
@click.option("--class", "people", type=PATH, help="CSV file of the class: who may hand in.")
@click.option("--out", type=PATH, default=Path("marks.csv"), help="File of the marks [marks.csv].")
@USER
@PROCESSES
@JSON
def grade(lab: str, people: Path | None, out: Path, *, as_json: bool, **given: Any) -> int:
    """Judge the answers of a class, a folder or a file a student, on the rigs the key deals.

    Every result is kept when it is finished, in a folder beside the marks: a killed command goes
    on where it was, an unchanged answer is not judged again.
    """
    from twin.jobs import cores
    from twin.lab.grade import Grader, mark_of, marks, submissions, summary
    from twin.lab.process import check_user
    from twin.lab.schema import read
    from twin.lab.variants import students
    from twin.writing import write_whole, written_alone

    check_user(given["user"])
    about, kept = read(lab), out.with_suffix(".results")
    names = None if people is None else students(people)
    handed_in = submissions(about, given["submissions"])
    grader = Grader(about, _text(given["key"]), mark_of(about), names, given["user"])
    with written_alone(kept), progress("grade", len(handed_in), "answers") as advance:
        found = grader.grade(handed_in, kept, given["processes"] or cores(), advance)
    write_whole(out, marks(about, found))
    show(found, as_json, [summary(found)], out.parent, out.name)
    return 1 if any("problem" in each for each in found) else 0


def _tried(lab: str, found: Iterable[tuple[str, bool, str]], *, as_json: bool) -> int:
    """Show what was found of a lab; the exit code."""
    from twin.page import Table

    every = list(found)
    rows = [(what, "yes" if good else "NO", text) for what, good, text in every]
    shown = Table(f"Lab {lab}", ("what", "", "found"), rows, words=(0, 1, 2))
    show(
        [dict(zip(("what", "good", "found"), each, strict=True)) for each in every],
        as_json,
        [shown],
    )
    return 0 if all(good for _, good, _ in every) else 1


@lab.command(cls=Command, example="lab selftest signs")
@LAB
@PROCESSES
@JSON
def selftest(lab: str, processes: int | None, *, as_json: bool) -> int:
    """Try a lab before a class does: the solution has all points, every mutant fails its check."""
    from twin.jobs import cores
    from twin.lab import course, schema

    return _tried(lab, course.selftest(schema.read(lab), processes or cores()), as_json=as_json)


@lab.command(cls=Command, example="lab calibrate signs --rigs 30")
@LAB
@click.option("--rigs", type=click.IntRange(min=3), default=30, help="Rigs a candidate [30].")
@PROCESSES
@JSON
def calibrate(lab: str, rigs: int, processes: int | None, *, as_json: bool) -> int:
    """Propose the limits of every check from what solution, starter and mutants reach.

    Each is judged on so many rigs; exit code 1 where a mutant cannot be told from the solution.
    """
    from twin.jobs import cores
    from twin.lab import course, schema

    about = schema.read(lab)
    with progress("calibrate", rigs * len(course.candidates(about)), "answers") as advance:
        found = list(course.calibrate(about, rigs, processes or cores(), advance))
    return _tried(lab, found, as_json=as_json)


@lab.command(cls=Command, example="lab pack signs --for gradescope --key key.txt --out signs.zip")
@LAB
@click.option("--for", "system", type=click.Choice(["folder", "gradescope", "classroom50"]))
@KEY
@click.option("--wheel", type=PATH, help="Wheel of ballplate that the image installs [the index].")
@click.option("--out", type=PATH, required=True, help="New file (gradescope) or folder.")
def pack(lab: str, out: Path, **given: Any) -> int:
    """Pack a lab for students (folder, with a notebook) or for the grader of a course system."""
    from twin.lab.pack import pack as packed
    from twin.lab.schema import read

    packed(read(lab), given["system"] or "folder", out, _text(given["key"]), given["wheel"])
    say(f"{out} written")
    return 0
