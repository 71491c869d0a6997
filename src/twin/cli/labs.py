"""The commands of ``ballplate lab``: what is asked of a class, and how its answers are judged."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from twin.cli.options import JSON, PATH, PROCESSES, Command, Group
from twin.cli.output import progress, say, show, show_titles
from twin.errors import ScenarioError
from twin.jobs import cores
from twin.page import Table
from twin.shipped import shipped_labs, titles

if TYPE_CHECKING:
    from twin.lab.grade import Finding
    from twin.lab.schema import Lab


def _lab(_: click.Context, __: click.Parameter, name: str) -> Lab:
    """The lab of a name or a folder."""
    from twin.lab.schema import read

    return read(name)


def _text(key: Path | None) -> str | None:
    """The course's key out of its file."""
    if key is None:
        return None
    from twin.lab.schema import text_of

    text = text_of(key, f"--key {key}").strip()
    if len(text) < 8:
        raise ScenarioError(f"--key {key}: a key has at least 8 characters")
    return text


LAB = click.argument("lab", callback=_lab)
KEY = click.option("--key", type=PATH, help="File with the course's key.")


@click.group(cls=Group, example="lab check signs answer.py")
def lab() -> None:
    """Labs that mark themselves, each student on a rig of their own."""


@lab.command("list", cls=Command, example="lab list")
@JSON
def list_labs() -> int:
    """List the shipped labs."""
    files = {name: place / "lab.toml" for name, place in shipped_labs().items()}
    show_titles(titles(files))
    return 0


@lab.command(cls=Command, example="lab new friction2")
@click.argument("name")
@click.option("--out", type=PATH, help="New folder [NAME].")
def new(name: str, out: Path | None) -> int:
    """Write a small lab of your own that passes its selftest, to be changed piece by piece."""
    from twin.lab.grade import begin

    folder = out or Path(name)
    begin(name, folder)
    say(f"{folder}/: begin with lab.toml and solution.py; then: ballplate lab selftest {folder}")
    return 0


@lab.command(cls=Command, example="lab start signs --student ann")
@LAB
@click.option("--student", required=True, help="Your name or number.")
@click.option("--out", type=PATH, help="New folder [LAB-STUDENT].")
@KEY
def start(lab: Lab, student: str, out: Path | None, key: Path | None) -> int:
    """Begin a lab: the sheet, a starter that runs, the rig of your own.

    Without the course's key the rig is one to practise on; your lecturer hands out yours.
    """
    from twin.lab.schema import hand_out

    folder = out or Path(f"{lab.name}-{student}")
    hand_out(lab, {student: "."}, _text(key), folder)
    files = f"task.md, {lab.answer.file}, rig.toml"
    say(f"{folder}/: {files}; then: ballplate lab check {lab.called}")
    return 0


@lab.command(cls=Command, example="lab check signs answer.py")
@click.argument("lab")
@click.argument("answer", required=False, type=PATH)
@click.option("--student", help="Whose rig, where no rig.toml beside the answer says so.")
@KEY
@click.option("--hidden", is_flag=True, help="Judge hidden checks, too, where they are.")
@click.option("--as", "form", type=click.Choice(["json", "gradescope", "classroom50", "junit"]))
@click.option("--out", type=PATH, help="File to write the result to.")
@click.option("--page", type=PATH, help="HTML page to write, with a picture of the run.")
@JSON
def check(key: Path | None, form: str | None, out: Path | None, **how: Any) -> int:
    """Judge an answer: what passed, why not, where to look; exit code 1 if a check did not pass.

    The answer is a file, or a folder with it; by default that of this folder.
    """
    from ballplate.lab import check as judge
    from twin.lab.grade import table, written
    from twin.writing import write_whole

    result = judge(**how, key=_text(key))
    if out is not None:
        write_whole(out, written(result, form or "json"))
    show(result, [table(result)], out and out.parent, out.name if out else "")
    return 0 if all(each["passed"] for each in result["results"]) else 1


@lab.command(cls=Command, example="lab variants signs class.csv --key key.txt")
@LAB
@click.argument("students", type=PATH)
@KEY
@click.option("--out", type=PATH, help="New folder with one a student [variants-LAB].")
def variants(lab: Lab, students: Path, key: Path | None, out: Path | None) -> int:
    """Deal every student of a class a rig of their own, and write what each begins with.

    The class is a CSV file whose first column names the students, below a heading.
    """
    from twin.lab.schema import hand_out
    from twin.lab.schema import students as named

    people, folder = named(students), out or Path(f"variants-{lab.name}")
    hand_out(lab, {student: student for student in people}, _text(key), folder)
    say(f"{folder}/: {len(people)} rigs")
    return 0


@lab.command(cls=Command, example="lab grade signs submissions --key key.txt --out marks.csv")
@LAB
@click.argument("folder", metavar="SUBMISSIONS", type=PATH)
@KEY
@click.option("--class", "people", type=PATH, help="CSV file of the class: who may hand in.")
@click.option("--out", type=PATH, default=Path("marks.csv"), help="File of the marks [marks.csv].")
@PROCESSES
@JSON
def grade(lab: Lab, folder: Path, people: Path | None, out: Path, **given: Any) -> int:
    """Judge the answers of a class, a folder or a file a student, on the rigs the key deals.

    Every result and its page are kept when they are finished, in a folder beside the marks: a
    killed command goes on where it was, an unchanged answer is not judged again. A page beside the
    marks has the class.
    """
    from twin.lab import grade as grades
    from twin.lab.schema import students
    from twin.writing import write_whole, written_alone

    names = students(people) if people else None
    processes, key = given["processes"] or cores(), _text(given["key"])
    handed_in, kept = grades.submissions(lab, folder), out.with_suffix(".results")
    with written_alone(kept), progress("grade", len(handed_in), "answers") as advance:
        found = grades.grade(lab, key, names, handed_in, kept, processes, advance)
    write_whole(out, grades.marks(lab, found))
    page = out.with_suffix(".html")
    write_whole(page, grades.of_class(lab, found, kept))
    files = f"{out.name}, {page.name}; of each student {kept.name}/"
    show(found, [grades.summary(found)], out.parent, files)
    return 1 if any("problem" in each for each in found) else 0


def _tried(lab: Lab, found: Iterable[Finding]) -> int:
    """Show what was found of a lab; the exit code."""
    every = list(found)
    rows = [(each.what, "yes" if each.good else "NO", each.found) for each in every]
    shown = Table(f"Lab {lab.called}", ("what", "", "found"), rows, words=(0, 1, 2))
    show([each._asdict() for each in every], [shown])
    return 0 if all(each.good for each in every) else 1


@lab.command(cls=Command, example="lab selftest signs")
@LAB
@click.option("--starter", is_flag=True, help="Make the starter from the solution first.")
@PROCESSES
@JSON
def selftest(lab: Lab, starter: bool, processes: int | None) -> int:
    """Try a lab before a class does: the solution has all points, every mutant fails its check."""
    from twin.lab import grade
    from twin.lab.schema import starter as made
    from twin.writing import write_whole

    if starter and not lab.answer.data:
        write_whole(lab.folder / lab.answer.file, made(lab.text("solution.py")))
    return _tried(lab, grade.selftest(lab, processes or cores()))


@lab.command(cls=Command, example="lab calibrate signs --rigs 30")
@LAB
@click.option("--rigs", type=click.IntRange(min=3), default=30, help="Rigs a candidate [30].")
@PROCESSES
@JSON
def calibrate(lab: Lab, rigs: int, processes: int | None) -> int:
    """Propose the limits of every check from what solution, starter and mutants reach.

    Each is judged on so many rigs; exit code 1 where a mutant cannot be told from the solution.
    """
    from twin.lab import grade

    with progress("calibrate", rigs * len(grade.candidates(lab)), "answers") as advance:
        found = list(grade.calibrate(lab, rigs, processes or cores(), advance))
    return _tried(lab, found)


@lab.command(cls=Command, example="lab pack signs --for gradescope --key key.txt --out signs.zip")
@LAB
@click.option(
    "--for",
    "system",
    type=click.Choice(["folder", "gradescope", "classroom50"]),
    default="folder",
)
@KEY
@click.option("--wheel", type=PATH, help="Wheel of ballplate that the image installs [the index].")
@click.option("--out", type=PATH, required=True, help="New file (gradescope) or folder.")
def pack(out: Path, key: Path | None, **given: Any) -> int:
    """Pack a lab for students (folder, with a notebook) or for the grader of a course system."""
    from twin.lab.grade import pack as packed

    packed(out=out, key=_text(key), **given)
    say(f"{out} written")
    return 0
