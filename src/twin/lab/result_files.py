"""Results of answers as files for other programs: formats of course systems, marks as CSV."""

from __future__ import annotations

import json
import os
import re
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from markupsafe import escape

from twin.base.errors import printable
from twin.base.page import render_template as rendered
from twin.lab.result_texts import Result, reason
from twin.lab.schema import Lab

LAB_TEMPLATE_FOLDER = Path(__file__).with_name("templates")
"""Templates of packs, a folder for each course system, and of results."""
FORMULA_START = re.compile(r"(^|[;,|])(\s*)(?=[=+\-@\uff1d\uff0b\uff0d\uff20])")
"""Where a spreadsheet would begin a formula: first in a cell, or after a sign between cells."""


def format_result(result: Result, form: str) -> str:
    """A result in the format of an external program.

    Args:
        result: The result.
        form: ``json``, all of it: its ``results`` have the fields of check50; ``gradescope``,
            ``classroom50``, which reads the environment of its runner, or ``junit``: the templates
            in ``lab/templates``.
    """
    if form == "json":
        return json.dumps(result, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    text = rendered(
        LAB_TEMPLATE_FOLDER / "results" / f"{form}.j2",
        **result,
        reason=partial(reason, language=result.get("language", "en")),
        in_xml=in_xml,
        hundredths=lambda checks, key: sum(round(100 * each[key]) for each in checks),
        environ=os.environ,
        now=datetime.now(UTC).isoformat(timespec="seconds"),
    )
    return text if form == "junit" else format_result(json.loads(text), "json")


def in_xml(text: str) -> str:
    """A text for XML: without control characters, and with the signs of XML escaped."""
    return escape("".join(letter if letter.isprintable() else " " for letter in text))


def marks(lab: Lab, found: list[dict[str, Any]]) -> str:
    """The marks of a class as CSV: a line for each student, a column for each check."""
    import pandas as pd  # noqa: PLC0415  of classes only, and not in ballplate-core

    heads = ("student", "score", "max_score", *(each.name for each in lab.checks(hidden=True)))
    rows = [each | {check["name"]: check["score"] for check in each["results"]} for each in found]
    table = pd.DataFrame(rows, columns=[*heads, "problem"])
    table.columns = pd.Index(map(in_cell, table.columns))
    for name in map(in_cell, ("student", "problem")):
        table[name] = table[name].map(in_cell, na_action="ignore")
    return str(table.to_csv(index=False))


def in_cell(text: str) -> str:
    """A text as a cell of a table that a spreadsheet opens: in one line, and no formula.

    An apostrophe is put before the beginning of one.
    """
    return FORMULA_START.sub(r"\1\2'", printable(text))
