"""The rig of every student: drawn from the course's key and their name, the same at each asking."""

from __future__ import annotations

import csv
import hashlib
import hmac
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import Field

from twin.errors import ScenarioError, nearest, shortened
from twin.lab.schema import Lab
from twin.run.finished import run
from twin.study.family import Point, drawn
from twin.study.work import Builder
from twin.validation import Checked, read_model
from twin.writing import write_folder, write_whole

RIG = "rig.toml"
"""What a student is handed of their rig."""
LOG = "log.csv"
"""The log that is made on it."""
PRACTICE = "practice"
"""The key of a course that has none."""
_TOLD = re.compile(r"^(\s*\w+[^=#]*=\s*)([^#]*?)(\s*# told: )(\S+)[ \t]*$", re.MULTILINE)
"""A line ``NAME = 0.18  # told: KEY`` of an answer."""


class RigFile(Checked):
    """The file ``rig.toml`` that a student is handed."""

    lab: str
    version: int
    student: str
    code: str
    practice: bool
    told: Mapping[str, float | str] = Field({})


class Deal(NamedTuple):
    """The rig of one student.

    Attributes:
        student: Whose.
        code: What tells it from others; printed on the sheet.
        point: What it is: dotted key to value.
        told: What of that the student knows.
        seed: Of its noise.
        true: Whether what is hidden is as the course has it, not a value to practise on.
    """

    student: str
    code: str
    point: Point
    told: Point
    seed: int
    true: bool = True


def deal(lab: Lab, student: str, key: str | None = None, code: str | None = None) -> Deal:
    """The rig of a student.

    HMAC-SHA256 of the course's key over lab, version and student, once for what is told and once
    for what is hidden. Who lacks the key but has the code has the first, and, of what is hidden,
    values to practise on.

    Args:
        lab: The lab.
        student: Their name or number.
        key: The course's.
        code: That of the student's sheet, for who lacks the key.
    """
    name = f"{lab.about.name} {lab.about.version} {student}"
    secret = (PRACTICE if key is None else key).encode()
    digests = [
        hmac.new(secret, f"{name} {part}".encode(), hashlib.sha256).hexdigest()[:16]
        for part in ("told", "hidden")
    ]
    if key is None and code is not None:
        digests = [code, hashlib.sha256(code.encode()).hexdigest()[:16]]
    own, hidden = digests
    if lab.family is None or lab.about.variant is None:
        return Deal(student, own, {}, {}, int(hidden, 16) % 2**31)
    open_, closed = (drawn(lab.family, int(digest, 16), 1)[0] for digest in digests)
    told = {each: open_.point[each] for each in lab.about.variant.told}
    return Deal(student, own, closed.point | told, told, closed.seed)


def had_again(lab: Lab, folder: Path, key: str | None, student: str | None = None) -> Deal:
    """The rig that a folder's answer is for: by its ``rig.toml``, or by the student's name.

    Raises:
        ScenarioError: If the file is of another lab, version, student or key.
    """
    if not (folder / RIG).is_file():
        return deal(lab, student or "nobody", key)
    said = read_model(RigFile, folder / RIG)
    for what, has, wanted in (
        ("lab", said.lab, lab.about.name),
        ("version", said.version, lab.about.version),
        ("student", said.student, student or said.student),
    ):
        if has != wanted:
            raise ScenarioError(f"{folder.name}/{RIG}: {what}: is {has!r}, must be {wanted!r}")
    found = deal(lab, said.student, PRACTICE if said.practice and key is None else key, said.code)
    if found.code != said.code:
        raise ScenarioError(
            f"{folder.name}/{RIG}: code: the course's key deals {said.student} another rig; "
            "is it the key of this course?"
        )
    return found._replace(true=said.practice or key is not None)


def students(path: Path) -> list[str]:
    """The students of a class: the first column of a CSV file below its heading.

    Raises:
        ScenarioError: If it cannot be read, names nobody, or somebody twice.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = [row[0].strip() for row in csv.reader(file) if row and row[0].strip()][1:]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ScenarioError(f"{path}: cannot be read: {error}") from None
    twice = next((name for name in rows if rows.count(name) > 1), None)
    if not rows or twice:
        what = f"two students are called '{twice}'" if twice else "names nobody below its heading"
        raise ScenarioError(f"{path}: {what}")
    for name in rows:
        check_name(name)
    return rows


def check_name(student: str) -> None:
    """Make sure that a student's name can be that of a folder.

    Raises:
        ScenarioError: If not.
    """
    if not re.fullmatch(r"[\w@+-][\w.@+-]{0,99}", student):
        raise ScenarioError(
            f"student '{shortened(student)}': is called by up to 100 letters, digits and .@+-_"
        )


def known(student: str, names: list[str]) -> None:
    """Make sure that a student is one of a class.

    Raises:
        ScenarioError: If not.
    """
    if student not in names:
        raise ScenarioError(f"student '{student}': not in the class{nearest(student, names)}")


def hand_out(
    lab: Lab, students: list[str], key: str | None, folder: Path, *, each_own: bool = False
) -> None:
    """Write what students begin with: sheet, starter, rig, log.

    Args:
        lab: The lab.
        students: Who.
        key: The course's; without one their rigs are to practise on.
        folder: Where to; must not exist.
        each_own: Whether each has a folder of their own in it.

    Raises:
        TwinError: If a file of the lab cannot be read, its log not be run, or one not be written.
    """
    about = lab.about
    texts = {name: text_of(lab, name) for name in ("task.md", about.answer.file)}

    def fill(inner: Path) -> None:
        for student in students:
            dealt = deal(lab, student, key)
            _write(lab, dealt, texts, inner / student if each_own else inner, practice=key is None)

    for student in students:
        check_name(student)
    write_folder(folder, fill)


def _write(
    lab: Lab, dealt: Deal, texts: Mapping[str, str], folder: Path, *, practice: bool
) -> None:
    about, own = lab.about, dealt.told.items()
    rig = {"lab": about.name, "version": about.version, "student": dealt.student}
    rig |= {"code": dealt.code, "practice": practice, "told": dealt.told}
    write_whole(folder / RIG, toml(rig))
    sheet = f"{texts['task.md'].rstrip()}\n\n## Your rig\n\n{dealt.student}, code {dealt.code}\n\n"
    write_whole(folder / "task.md", sheet + "".join(f"- `{key}` = {each}\n" for key, each in own))
    write_whole(folder / about.answer.file, filled(texts[about.answer.file], dealt.told))
    record(lab, dealt, folder / LOG)


def toml(tables: Mapping[str, Any], path: str = "") -> str:
    """Tables of numbers, texts and lists as TOML."""
    own = {key: value for key, value in tables.items() if not isinstance(value, dict)}
    text = "".join(f"{json.dumps(key)} = {json.dumps(value)}\n" for key, value in own.items())
    for key in tables.keys() - own.keys():
        text += f"[{path}{json.dumps(key)}]\n{toml(tables[key], f'{path}{json.dumps(key)}.')}"
    return text


def text_of(lab: Lab, name: str) -> str:
    """The text of a file of a lab.

    Raises:
        ScenarioError: If it cannot be read.
    """
    try:
        return (lab.folder / name).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ScenarioError(f"{lab.folder.name}/{name}: cannot be read: {error}") from None


def starter(solution: str) -> str:
    """What a student begins with, out of a solution.

    Lines between ``# BEGIN SOLUTION`` and ``# END SOLUTION`` go; of those between
    ``# BEGIN STARTER`` and ``# END STARTER`` the comment signs do.
    """
    kept, within = [], ""
    for line in solution.splitlines():
        mark = line.strip().removeprefix("# ").split()
        if mark[:1] in (["BEGIN"], ["END"]) and mark[1:] in (["SOLUTION"], ["STARTER"]):
            within = mark[1] if mark[0] == "BEGIN" else ""
        elif within != "SOLUTION":
            kept.append(re.sub(r"^(\s*)# ?", r"\1", line) if within else line)
    return "\n".join(kept) + "\n"


def filled(text: str, told: Mapping[str, Any]) -> str:
    """An answer's text with what the student's sheet tells in its lines marked ``# told: KEY``."""

    def line(match: re.Match[str]) -> str:
        name, old, mark, key = match.groups()
        return f"{name}{told.get(key, old)!r}{mark}{key}" if key in told else match.group()

    return _TOLD.sub(line, text)


def record(lab: Lab, dealt: Deal, path: Path) -> None:
    """Write the log of a student's rig, where there is to be one: all but the truth.

    Raises:
        TwinError: If its scenario cannot be run.
    """
    variant = lab.about.variant
    if variant is None or not variant.log:
        return
    fixed = (*variant.set, f"seed={dealt.seed}")
    done = run(Builder(lab.file(variant.log))(fixed, dealt.point))
    import pandas as pd  # noqa: PLC0415  only here

    seen = {
        f"{name} [{done.units[name]}]": values
        for name, values in done.rows.items()
        if name.startswith(SEEN)
    }
    write_whole(path, lambda file: pd.DataFrame(seen).to_csv(file, index=False))


SEEN = ("time", "measured_", "requested_", "applied_", "age", "touched")
"""Beginnings of the columns that a rig's own computer has, before any observer."""
