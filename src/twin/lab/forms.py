"""A lab and its results in the forms of others: course systems, notebooks, JUnit."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from markupsafe import escape

from twin.errors import ScenarioError, shortened
from twin.lab.schema import NAMED, PRIVATE, Lab
from twin.lab.variants import starter
from twin.page import Table, filled
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
