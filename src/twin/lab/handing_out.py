"""What students receive: sheet, starter, rig and log, in a folder each; and the class list."""

from __future__ import annotations

import csv
import io
import json
import re
import unicodedata
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from twin.base.errors import ScenarioError, printable, shorten
from twin.base.foreign import decode_text
from twin.base.writing import why, write_folder, write_whole
from twin.lab.deals import LOG_FILE, RIG_FILE, deal, write_log
from twin.lab.schema import Lab
from twin.lab.words import words

MAX_NAME_BYTES = 200
"""Length of a student's name in UTF-8; the files of a result have it and a few more letters."""
_FILLED_LINE_PATTERN = re.compile(
    r"^(\s*\w+[^=#]*=\s*)([^#]*?)(\s*# told: )(\S+)[ \t]*$", re.MULTILINE
)
"""A line ``NAME = 0.18  # told: KEY`` of an answer."""
MARKED_LINES_PATTERN = r"(?ms)^ *# BEGIN {0}$\n(.*?)^ *# END {0}$\n"
"""Lines between two marks, with the word of the marks to be filled in."""


def read_class(path: Path) -> dict[str, str]:
    """The students of a class and their names, which may be empty.

    They are the first and the second column of a CSV file below its heading.

    Spreadsheets write it with commas, semicolons or tabs, in UTF-8, UTF-16 or Windows' encoding.

    Raises:
        ScenarioError: If it cannot be read, names nobody, or somebody twice.
    """
    try:
        text = decode_text(path.read_bytes())
        between = max(",;\t", key=text.partition("\n")[0].count)
        table = csv.reader(io.StringIO(text, newline=""), delimiter=between)
        cells = [[*row, ""][:2] for row in table if row and row[0].strip()][1:]
        rows = [unicodedata.normalize("NFC", cell[0].strip()) for cell in cells]
    except (OSError, csv.Error) as error:
        raise ScenarioError(f"{path}: cannot be read: {why(error)}") from None
    twice = next((name for name in rows if rows.count(name) > 1), None)
    if not rows or twice:
        what = f"two students are called '{twice}'" if twice else "names nobody below its heading"
        raise ScenarioError(f"{path}: {what}")
    for name in rows:
        check_name(name)
    return {row: printable(cell[1].strip()) for row, cell in zip(rows, cells, strict=True)}


def check_name(student: str) -> None:
    """Make sure that a student's name is valid for a folder, and for the files made for it.

    Raises:
        ScenarioError: If not.
    """
    letters = re.fullmatch(r"[\w@+-][\w.@+-]{0,99}", student)
    if not letters or len(student.encode()) > MAX_NAME_BYTES:
        raise ScenarioError(
            f"student '{shorten(printable(student))}': the name has up to 100 letters, digits "
            f"and .@+-_, {MAX_NAME_BYTES} bytes in UTF-8"
        )


def hand_out(
    lab: Lab, places: Mapping[str, str], key: str | None, folder: Path, *, notebook: bool = False
) -> None:
    """Write the files with which students begin: sheet, starter, rig, log.

    Args:
        lab: The lab.
        places: Students, and their folders within the new one, ``.`` for itself.
        key: The key of the course; without one the rigs are for practice.
        folder: The new folder; must not exist.
        notebook: Whether to write a notebook of sheet, starter and check as well.

    Raises:
        TwinError: If a file of the lab cannot be read, or one not be written, or a log not be run.
    """
    answer, say = lab.answer.file, words(lab.language)
    sheet, template = lab.sheet.rstrip(), lab.text(answer)

    def fill(inner: Path) -> None:
        for student, place in places.items():
            dealt, own = deal(lab, student, key), inner / place
            rig = {"lab": lab.name, "version": lab.version, "student": student}
            rig |= {"code": dealt.code, "practice": key is None}
            known = format_toml({json.dumps(each): value for each, value in dealt.known.items()})
            write_whole(own / RIG_FILE, f"{format_toml(rig)}[told]\n{known}")
            listed = "".join(f"- `{each}` = {value}\n" for each, value in dealt.known.items())
            heading = say("your_rig", student=student, code=dealt.code)
            text = f"{sheet}\n\n## {heading}\n\n{listed}"
            filled = fill_answer(template, dealt.known)
            write_whole(own / "task.md", text)
            write_whole(own / answer, filled)
            if notebook:
                write_notebook(lab, own, text, filled)
            write_log(lab, dealt, own / LOG_FILE)

    for student in places:
        check_name(student)
    write_folder(folder, fill)


def write_notebook(lab: Lab, folder: Path, sheet: str, answer: str) -> None:
    """Write a Jupyter notebook of a sheet, a starter and the check of the lab into a folder.

    Raises:
        RecordError: If it cannot be written.
    """
    from twin.base.page import render_template  # noqa: PLC0415  with jinja, for a notebook only

    template = Path(__file__).with_name("templates") / "folder" / "notebook.ipynb.j2"
    text = render_template(template, lab=lab, sheet=sheet, answer=answer)
    text = json.dumps(json.loads(text), indent=1, ensure_ascii=False) + "\n"
    write_whole(folder / f"{lab.name}.ipynb", text)


def format_toml(values: Mapping[str, Any]) -> str:
    """Numbers, texts and lists of them by key, dotted or not, as TOML."""
    return "".join(f"{key} = {json.dumps(value)}\n" for key, value in values.items())


def make_starter(solution: str) -> str:
    """The starter that is made from a solution.

    Lines between ``# BEGIN SOLUTION`` and ``# END SOLUTION`` are removed; of those between
    ``# BEGIN STARTER`` and ``# END STARTER`` the comment signs are.
    """
    given = re.sub(MARKED_LINES_PATTERN.format("SOLUTION"), "", solution)
    sign = r"(?m)^( *)# ?"
    return re.sub(
        MARKED_LINES_PATTERN.format("STARTER"), lambda found: re.sub(sign, r"\1", found[1]), given
    )


def fill_answer(text: str, known: Mapping[str, Any]) -> str:
    """An answer's text with the known values in its lines marked ``# told: KEY``."""

    def line(found: re.Match[str]) -> str:
        begin, _, mark, key = found.groups()
        return f"{begin}{known[key]!r}{mark}{key}" if key in known else found.group()

    return _FILLED_LINE_PATTERN.sub(line, text)
