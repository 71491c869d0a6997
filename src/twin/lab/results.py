"""One result in the words of others: Gradescope, Classroom 50, JUnit; and for people."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any
from xml.etree import ElementTree

from twin.page import Table

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


def own(result: Result) -> str:
    """The whole result as JSON, whose ``results`` have the fields of check50."""
    return json.dumps(result, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def gradescope(result: Result) -> str:
    """Gradescope's ``results.json``.

    Students see a check as its ``visible`` says; what it says of them is a text.
    """
    tests = [
        {
            "name": each["name"],
            "score": each["score"],
            "max_score": each["max_score"],
            "status": "passed" if each["passed"] else "failed",
            "output": f"{each['description']}\n{reason(each)}".strip(),
            "visibility": each["visible"],
        }
        for each in result["results"]
    ]
    found = {
        "score": result["score"],
        "execution_time": round(result["seconds"]),
        "stdout_visibility": "hidden",
        "tests": tests,
        "extra_data": {
            key: result[key] for key in ("lab", "version", "code", "answer", "versions")
        },
    }
    return json.dumps(found, indent=2, ensure_ascii=False) + "\n"


def classroom50(result: Result) -> str:
    """Classroom 50's ``result.json``, with what its runner says in the environment.

    Scores are whole there: hundredths of a point would be lost, so all are times 100.
    """
    said = {
        "classroom": "CLASSROOM",
        "assignment": "ASSIGNMENT",
        "owner": "USERNAME",
        "submission": "SUBMISSION_TAG",
        "commit": "COMMIT_URL",
        "release": "RELEASE_URL",
    }
    shown = [each for each in result["results"] if each["visible"] == "visible"]
    tests = [
        {
            "test-name": each["name"],
            "passed": bool(each["passed"]),
            "score": round(100 * each["score"]),
            "max-score": round(100 * each["max_score"]),
            "output": reason(each),
        }
        for each in shown
    ]
    found = {
        "schema": "classroom50/result/v1",
        **{key: os.environ.get(name, "") for key, name in said.items()},
        "review": "",
        "datetime": datetime.now(UTC).isoformat(timespec="seconds"),
        "score": sum(each["score"] for each in tests),
        "max-score": sum(each["max-score"] for each in tests),
        "tests": tests,
    }
    return json.dumps(found, indent=2, ensure_ascii=False) + "\n"


def junit(result: Result) -> str:
    """JUnit's XML: a suite of the lab, a case a check."""
    suite = ElementTree.Element("testsuite", name=result["lab"], tests=str(len(result["results"])))
    for key, passed in (("failures", False), ("skipped", None)):
        count = sum(each["passed"] is passed for each in result["results"])
        suite.set(key, str(count))
    for each in result["results"]:
        case = ElementTree.SubElement(suite, "testcase", name=each["name"], classname=result["lab"])
        if not each["passed"]:
            tag = "skipped" if each["passed"] is None else "failure"
            ElementTree.SubElement(case, tag, message=printable(reason(each)))
    return (
        '<?xml version="1.0" encoding="utf-8"?>\n' + ElementTree.tostring(suite, "unicode") + "\n"
    )


def printable(text: str) -> str:
    """A text without the control characters that no XML can have."""
    return "".join(letter if letter.isprintable() else " " for letter in text)


FORMS: dict[str, Callable[[Result], str]] = {
    "json": own,
    "gradescope": gradescope,
    "classroom50": classroom50,
    "junit": junit,
}
"""What a result may be written as."""
