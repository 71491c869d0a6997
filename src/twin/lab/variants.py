"""The rig of every student: drawn from the course's key and their name, the same at each asking."""

from __future__ import annotations

import csv
import hashlib
import hmac
import json
import re
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import Field

from controllers.arrays import Array
from twin.errors import ScenarioError, shortened
from twin.lab.schema import Lab, trusted
from twin.run.files import export
from twin.run.finished import run
from twin.scenario import Scenario
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
    name = f"{lab.name} {lab.version} {student}"
    secret = (PRACTICE if key is None else key).encode()
    digests = [
        hmac.new(secret, f"{name} {part}".encode(), hashlib.sha256).hexdigest()[:16]
        for part in ("told", "hidden")
    ]
    if key is None and code is not None:
        digests = [code, hashlib.sha256(code.encode()).hexdigest()[:16]]
    own, hidden = digests
    if lab.family is None or lab.variant is None:
        return Deal(student, own, {}, {}, int(hidden, 16) % 2**31)
    open_, closed = (drawn(lab.family, int(each, 16), 1)[0] for each in digests)
    told = {key: open_.point[key] for key in lab.variant.told}
    return Deal(student, own, closed.point | told, told, closed.seed)


def had_again(lab: Lab, folder: Path, key: str | None, student: str | None = None) -> Deal:
    """The rig that a folder's answer is for: by its ``rig.toml``, or by the student's name.

    Raises:
        ScenarioError: If the file is of another lab, version, student or key.
    """
    if not (folder / RIG).is_file():
        return deal(lab, student or "nobody", key)
    said = read_model(RigFile, folder / RIG)
    wanted = {"lab": lab.name, "version": lab.version, "student": student or said.student}
    for what, must in wanted.items():
        if (has := getattr(said, what)) != must:
            raise ScenarioError(f"{folder.name}/{RIG}: {what}: is {has!r}, must be {must!r}")
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


def hand_out(lab: Lab, places: Mapping[str, str], key: str | None, folder: Path) -> None:
    """Write what students begin with: sheet, starter, rig, log.

    Args:
        lab: The lab.
        places: Who, and in which folder of the new one, ``.`` for itself.
        key: The course's; without one their rigs are to practise on.
        folder: Where to; must not exist.

    Raises:
        TwinError: If a file of the lab cannot be read, its log not be run, or one not be written.
    """
    answer = lab.answer.file
    sheet, begun = lab.text("task.md").rstrip(), lab.text(answer)

    def fill(inner: Path) -> None:
        for student, place in places.items():
            dealt, own = deal(lab, student, key), inner / place
            rig = {"lab": lab.name, "version": lab.version, "student": student}
            rig |= {"code": dealt.code, "practice": key is None}
            told = toml({json.dumps(each): value for each, value in dealt.told.items()})
            write_whole(own / RIG, f"{toml(rig)}[told]\n{told}")
            told = "".join(f"- `{each}` = {value}\n" for each, value in dealt.told.items())
            about = f"## Your rig\n\n{student}, code {dealt.code}\n\n{told}"
            write_whole(own / "task.md", f"{sheet}\n\n{about}")
            write_whole(own / answer, filled(begun, dealt.told))
            record(lab, dealt, own / LOG)

    for student in places:
        check_name(student)
    write_folder(folder, fill)


def toml(values: Mapping[str, Any]) -> str:
    """Numbers, texts and lists of them by key, dotted or not, as TOML."""
    return "".join(f"{key} = {json.dumps(value)}\n" for key, value in values.items())


def starter(solution: str) -> str:
    """What a student begins with, out of a solution.

    Lines between ``# BEGIN SOLUTION`` and ``# END SOLUTION`` go; of those between
    ``# BEGIN STARTER`` and ``# END STARTER`` the comment signs do.
    """
    given = re.sub(MARKED.format("SOLUTION"), "", solution)
    return re.sub(MARKED.format("STARTER"), lambda found: uncommented(found[1]), given)


MARKED = r"(?ms)^ *# BEGIN {0}$\n(.*?)^ *# END {0}$\n"
"""Lines between two marks."""


def uncommented(lines: str) -> str:
    """Lines without the signs that make them comments."""
    return re.sub(r"(?m)^( *)# ?", r"\1", lines)


def filled(text: str, told: Mapping[str, Any]) -> str:
    """An answer's text with what the student's sheet tells in its lines marked ``# told: KEY``."""

    def line(found: re.Match[str]) -> str:
        begin, _, mark, key = found.groups()
        return f"{begin}{told[key]!r}{mark}{key}" if key in told else found.group()

    return _TOLD.sub(line, text)


def record(lab: Lab, dealt: Deal, path: Path) -> None:
    """Write the log of a student's rig, where there is to be one: all but the truth.

    Raises:
        TwinError: If its scenario cannot be run.
    """
    variant = lab.variant
    file, _, function = (variant.log if variant else "").partition(":")
    if function:
        trusted(lab.folder / file, function)(dealt.point, path.parent)
    elif variant is not None and file and lab.family is not None:
        fixed = (*variant.set, f"seed={dealt.seed}")
        relative = [key for key, each in lab.family.parameters.items() if each.relative]
        scenario = Builder(lab.path(variant.log))(fixed, dealt.point, relative)
        export(path, *seen(scenario.model_dump_json()))


@lru_cache(maxsize=4)
def seen(scenario: str) -> tuple[dict[str, Array], Mapping[str, str]]:
    """What a rig's own computer sees of a run, before any observer: columns by name, units.

    Args:
        scenario: What is run, in JSON.
    """
    done = run(Scenario.model_validate_json(scenario))
    rows = {name: values for name, values in done.rows.items() if name.startswith(SEEN)}
    return rows, done.units


SEEN = ("time", "measured_", "requested_", "applied_", "age", "touched")
"""Beginnings of the columns that a rig's own computer has, before any observer."""
