"""A lab and its results for others: course systems, JUnit, pages of a student and a class."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import quote

import pandas as pd
from markupsafe import Markup, escape

from twin.errors import ScenarioError, shortened
from twin.lab.judge import Judge
from twin.lab.schema import NAMED, PRIVATE, Lab, starter
from twin.page import Block, Picture, Table, Text, Verdict, digits, filled, html
from twin.report.html import overview
from twin.shipped import folder as shipped
from twin.writing import write_folder, write_whole

TEMPLATES = Path(__file__).with_name("templates")
Result = Mapping[str, Any]
WORDS = {True: "passed", False: "failed", None: "skipped"}


def reason(check: Result) -> str:
    """Why a check gave what it gave, and where to look, in one text; empty if it passed."""
    cause = check["cause"]
    if cause is None:
        return ""
    look = f" Look: {cause['help']}" if cause.get("help") and check["passed"] is not None else ""
    return f"{cause['rationale']}{look}"


def table(result: Result) -> Table:
    """A result for people: one check a line."""
    rows = [
        (
            *(each["name"], WORDS[each["passed"]], f"{each['score']:g} of {each['max_score']:g}"),
            "\n".join([reason(each), *(f"printed: {line}" for line in each["log"])]).strip(),
        )
        for each in result["results"]
    ]
    total = f"{result['score']:g} of {result['max_score']:g}"
    title = f"{result['title']}: {result['student']}, {total} points"
    return Table(title, ("check", "", "points", "why"), rows, words=(0, 1, 3))


def written(result: Result, form: str) -> str:
    """A result as a file of others has it.

    Args:
        result: The result.
        form: ``json``, the whole of it, whose ``results`` have the fields of check50;
            ``gradescope``, ``classroom50``, which takes what its runner says from the environment,
            or ``junit``: the templates beside this file.
    """
    if form == "json":
        return json.dumps(result, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    text = filled(
        TEMPLATES / "results" / f"{form}.j2",
        **result,
        reason=reason,
        printable=printable,
        hundredths=lambda checks, key: sum(round(100 * each[key]) for each in checks),
        environ=os.environ,
        now=datetime.now(UTC).isoformat(timespec="seconds"),
    )
    return text if form == "junit" else written(json.loads(text), "json")


def printable(text: str) -> str:
    """A text as XML can have it: without control characters, and its own signs escaped."""
    return escape("".join(letter if letter.isprintable() else " " for letter in text))


def begin(name: str, folder: Path) -> None:
    """Write a small lab that passes its own selftest, to be changed into another.

    Args:
        name: What it is called.
        folder: Where to; must not exist.

    Raises:
        TwinError: If no lab can be called so, or it cannot be written.
    """
    if not re.fullmatch(NAMED, name):
        allowed = "small letters, digits, - and _, as in friction2"
        raise ScenarioError(f"NAME '{shortened(name)}': must be {allowed}")
    words, start = name.replace("_", " ").capitalize(), shipped() / "starts" / "lab"

    def fill(inner: Path) -> None:
        for file in filter(Path.is_file, start.rglob("*.*")):
            text = file.read_text(encoding="utf-8").replace("NAME", name)
            write_whole(inner / file.relative_to(start), text.replace("TITLE", words))
        write_whole(inner / "answer.py", starter((inner / "solution.py").read_text("utf-8")))

    write_folder(folder, fill)


def pack(lab: Lab, system: str, out: Path, key: str | None, wheel: Path | None) -> None:
    """Write a lab as a course system takes it.

    Args:
        lab: The lab.
        system: ``folder``, all that students may have; ``gradescope``, a zip file; ``classroom50``,
            a folder for the autograder.
        out: File or folder; must not exist.
        key: The course's.
        wheel: Of this program, where it is not to come from a package index.

    Raises:
        TwinError: If something of the lab is missing, or it cannot be written.
    """
    if wheel is not None and not wheel.is_file():
        raise ScenarioError(f"--wheel {wheel}: not found")
    if out.exists():
        raise ScenarioError(f"--out {out}: exists; name a new one")
    if system != "gradescope":
        write_folder(out, lambda inner: _fill(lab, system, inner, key, wheel))
        return
    with TemporaryDirectory(prefix="ballplate-pack-") as name:
        inner = Path(name) / "zip"
        _fill(lab, system, inner, key, wheel)
        made = Path(shutil.make_archive(str(Path(name) / "made"), "zip", inner))
        write_whole(out, made.read_bytes())


def _fill(lab: Lab, system: str, inner: Path, key: str | None, wheel: Path | None) -> None:
    """Put what a system wants into a folder: the lab, and what its templates give."""
    graded = system != "folder"
    wanted = f"/autograder/source/{wheel.name}" if wheel else f"ballplate=={version('ballplate')}"
    closed = {*PRIVATE, "__pycache__"} - ({"hidden.toml", "truth.py"} if graded else set())
    place = inner / "lab" if graded else inner
    shutil.copytree(lab.folder, place, dirs_exist_ok=True, ignore=shutil.ignore_patterns(*closed))
    for template in (TEMPLATES / system).iterdir():
        text = filled(template, lab=lab, key=key, requirement=wanted)
        if template.stem.endswith(".ipynb"):
            text = json.dumps(json.loads(text), indent=1, ensure_ascii=False) + "\n"
        made = inner / template.stem.replace("notebook", lab.name)
        write_whole(made, text)
        made.chmod(0o755 if graded else 0o644)
    if graded and key:
        write_whole(inner / "key.txt", key)
    if graded and wheel:
        shutil.copy(wheel, inner)


ENDS = ("all points", "some", "none", "skipped")
"""What became of a check."""


def of_student(judge: Judge, result: Result, *, everything: bool) -> str:
    """The page of a student.

    Args:
        judge: Judges the answer.
        result: What it gave.
        everything: Whether hidden checks are on it, too.
    """
    results = result["results"]
    shown = [each for each in results if everything or each["visible"] != "hidden"]
    told = "".join(f"; {key} = {value:.6g}" for key, value in judge.dealt.told.items())
    lines = [
        f"{result['score']:g} of {result['max_score']:g} points",
        f"lab {judge.lab.name}, version {judge.lab.version}; rig {judge.dealt.code}{told}",
    ]
    if rest := [each for each in results if each not in shown]:
        got, most = (sum(each[key] for each in rest) for key in ("score", "max_score"))
        lines.append(f"{got:g} of {most:g} of them by checks that are not shown")
    blocks = [
        Verdict(lines, result["score"] >= result["max_score"]),
        replace(table({**result, "results": shown}), title="Checks"),
        *pictured(judge, {each["name"]: each for each in shown}),
    ]
    return html(f"{judge.lab.title}: {result['student']}", blocks)


def pictured(judge: Judge, shown: Mapping[str, Result]) -> list[Block]:
    """The run of the check that lost most points; where none did, of the one with most."""
    runs = [
        each
        for each in judge.lab.checks(hidden=True)
        if each.name in shown and each.scenario and not each.number
    ]
    if not runs:
        return []
    lost = {each.name: each.points - shown[each.name]["score"] for each in runs}
    check = max(runs, key=lambda each: (lost[each.name], each.points))
    try:
        run = judge.picture(check)
        drawing = overview([replace(run, name="your answer")])
    except Exception as error:  # noqa: BLE001 - what cannot be drawn costs nobody a mark
        return [Text([f"No picture of '{check.name}': {error}"])]
    note = f"The first run of this check. {check.look}" if lost[check.name] else ""
    return [Picture(f"Check: {check.name}", drawing, note)]


def of_class(lab: Lab, found: Sequence[Result], folder: Path) -> str:
    """The page of a class.

    Args:
        lab: The lab.
        found: The results of its students.
        folder: Where their pages lie, beside this one.
    """
    judged, checks = [each for each in found if each["results"]], lab.checks(hidden=True)
    scores = [[its["score"] for its in each["results"]] for each in judged]
    points, rows = pd.DataFrame(scores, columns=range(len(checks))), []
    for at, check in enumerate(checks):
        its = [each["results"][at] for each in judged]
        ends = [ending(each) for each in its]
        values = pd.Series([each["data"]["value"] for each in its], dtype=float)
        spread = (values.median(), values.min(), values.max())
        rows.append(
            (
                f"{at + 1} {check.name}",
                *(str(ends.count(end)) for end in ENDS),
                f"{digits(points[at].mean(), places=2)} of {check.points:g}",
                *(digits(each, places=3) for each in spread),
            )
        )
    heads = ("check", *ENDS, "mean points", "median", "from", "to")
    note = "median, from, to: the number that is judged, over the class."
    marks = [
        (
            link(each["student"], folder),
            f"{each['score']:g}" if each["score"] is not None else "-",
            *(f"{its['score']:g}" for its in each["results"] or [{"score": 0.0}] * len(checks)),
        )
        for each in sorted(found, key=lambda each: -(each["score"] or 0.0))
    ]
    problems = [(each["student"], each["problem"]) for each in found if "problem" in each]
    blocks: list[Block] = [Text([summary(found)])]
    if problems:
        blocks.append(Table("Not judged", ("student", "why"), problems, words=(0, 1)))
    numbers = map(str, range(1, len(checks) + 1))
    blocks.append(Table("Checks", heads, rows, note=note))
    blocks.append(Table("Marks, check by check", ("student", "points", *numbers), marks, words=()))
    return html(f"{lab.title}: {len(found)} students", blocks)


def summary(found: Sequence[Result]) -> str:
    """How a class did, in a sentence."""
    scores = pd.Series([each["score"] for each in found if each["results"]], dtype=float)
    problems = sum("problem" in each for each in found)
    ends = f"{digits(scores.min())} to {digits(scores.max())}, median {digits(scores.median())}"
    return f"{len(found)} students, {problems} not judged; points of the others {ends}"


def ending(check: Mapping[str, Any]) -> str:
    """What became of a check: one of ``ENDS``."""
    if check["passed"] is None:
        return "skipped"
    return "all points" if check["passed"] else "some" if check["score"] else "none"


def link(student: str, folder: Path) -> str:
    """A student, with the page of theirs behind it where there is one."""
    if not (folder / f"{student}.html").is_file():
        return student
    where = quote(f"{folder.name}/{student}.html")
    return Markup('<a href="{}">{}</a>').format(where, student)
