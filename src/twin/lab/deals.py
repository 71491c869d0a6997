"""The rig and the log of each student: dealt by the course's key, or by the code of its file."""

from __future__ import annotations

import hashlib
import hmac
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from pydantic import Field

from controllers.arrays import Array
from twin.base.errors import ScenarioError
from twin.base.validation import Checked, read_model
from twin.lab.schema import Lab, load_function
from twin.run.exporters import export
from twin.run.finished import run
from twin.scenario import Scenario
from twin.study.schema import Point, draw_rigs
from twin.study.work import Builder

RIG_FILE = "rig.toml"
"""File of a student's rig."""
LOG_FILE = "log.csv"
"""File of the log of a student's rig."""
PRACTICE_KEY = "practice"
"""Key of a course without one."""
SEEN_COLUMN_PREFIXES = ("time", "measured_", "requested_", "applied_", "age", "touched")
"""Beginnings of the columns that a rig's own computer has, before any observer."""


class HandedRig(Checked):
    """The file ``rig.toml`` that a student receives."""

    lab: str
    version: int
    student: str
    code: str
    practice: bool
    told: Mapping[str, float | str] = Field({})


class Deal(NamedTuple):
    """The rig of one student.

    Attributes:
        student: The student.
        code: Its code, unique in the course; printed on the sheet.
        point: Its values: dotted key to value.
        known: The values that the student knows.
        seed: Seed of its noise.
        true: Whether the hidden values are those of the course, not values for practice.
    """

    student: str
    code: str
    point: Point
    known: Point
    seed: int
    true: bool = True


def deal(lab: Lab, student: str, key: str | None = None, code: str | None = None) -> Deal:
    """The rig of a student.

    HMAC-SHA256 of the course's key over lab, version and student, once for the known values and
    once for the hidden ones. The code without the key gives the known values, and hidden values for
    practice.

    Args:
        lab: The lab.
        student: Their name or number.
        key: The key of the course.
        code: The code of the student's sheet, used without the key.
    """
    name = f"{lab.name} {lab.version} {student}"
    secret = (PRACTICE_KEY if key is None else key).encode()
    digests = [
        hmac.new(secret, f"{name} {part}".encode(), hashlib.sha256).hexdigest()[:16]
        for part in ("told", "hidden")
    ]
    if key is None and code is not None:
        digests = [code, hashlib.sha256(code.encode()).hexdigest()[:16]]
    own, hidden = digests
    if lab.family is None or lab.variant is None:
        return Deal(student, own, {}, {}, int(hidden, 16) % 2**31)
    open_, closed = (draw_rigs(lab.family, int(each, 16), 1)[0] for each in digests)
    known = {key: open_.point[key] for key in lab.variant.told}
    return Deal(student, own, closed.point | known, known, closed.seed)


def reload_deal(lab: Lab, folder: Path, key: str | None, student: str | None = None) -> Deal:
    """The rig of a folder's answer: by its ``rig.toml``, or by the student's name.

    The rig of ``lab start``, to practise on, has the name that the student typed: any will do as
    long as there is no key. With one, it is passed over where a lab hands out neither values nor a
    log of a rig, as the answer then cannot depend on it.

    Raises:
        ScenarioError: If the file has a different lab, version, student or key, or is of a rig to
            practise on where the course's own is needed.
    """
    try:
        (folder / RIG_FILE).lstat()
    except OSError:
        return deal(lab, student or "nobody", key)
    handed = read_model(HandedRig, folder / RIG_FILE, regular=True)
    for what, must in {"lab": lab.name, "version": lab.version}.items():
        if (has := getattr(handed, what)) != must:
            raise ScenarioError(f"{RIG_FILE}: {what}: is {has!r}, must be {must!r}")
    if handed.practice and key is not None:
        if lab.variant is not None and (lab.variant.told or lab.variant.log):
            raise ScenarioError(
                f"{RIG_FILE}: practice: is of the rig that `lab start` makes to practise on; the "
                "answer must be made for the rig that the course hands out"
            )
        return deal(lab, student or handed.student, key)
    if student and handed.student != student and not handed.practice:
        raise ScenarioError(
            f"{RIG_FILE}: student: is {handed.student!r}, must be {student!r}; if they are one, "
            f"the class (--class) must have the name of {handed.student} in its second column"
        )
    own_key = PRACTICE_KEY if handed.practice and key is None else key
    found = deal(lab, handed.student, own_key, handed.code)
    if found.code != handed.code:
        raise ScenarioError(
            f"{RIG_FILE}: code: the course's key draws a different rig for {handed.student}; "
            "is it the key of this course?"
        )
    return found._replace(true=handed.practice or key is not None)


def write_log(lab: Lab, dealt: Deal, path: Path) -> None:
    """Write the log of a student's rig, if the lab has one: all columns but the truth.

    Raises:
        TwinError: If its scenario cannot be run.
    """
    variant = lab.variant
    file, _, function = (variant.log if variant else "").partition(":")
    if function:
        load_function(lab.folder / file, function)(dealt.point, path.parent)
    elif variant is not None and file and lab.family is not None:
        fixed = (*variant.set, f"seed={dealt.seed}")
        relative = [key for key, each in lab.family.parameters.items() if each.relative]
        scenario = Builder(lab.path(variant.log))(fixed, dealt.point, relative)
        export(path, *measured_columns(scenario.model_dump_json()))


@lru_cache(maxsize=4)
def measured_columns(scenario: str) -> tuple[dict[str, Array], Mapping[str, str]]:
    """Columns of a run that a rig's own computer has before any observer: by name, and units.

    Args:
        scenario: The scenario in JSON.
    """
    done = run(Scenario.model_validate_json(scenario))
    rows = {
        name: values for name, values in done.rows.items() if name.startswith(SEEN_COLUMN_PREFIXES)
    }
    return rows, done.units
