"""Results of answers in words and tables: points, reasons, and the result of a class."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from twin.base.page import Table, digits
from twin.lab.words import words

NOT_HANDED_IN = "not handed in"
"""Problem of a student of the class without a submission."""
Result = Mapping[str, Any]
"""Result of an answer, as ``judge_answer`` gives it, or one of its checks."""
CHECK_ENDINGS = {"all": "passed", "some": "partly", "none": "failed", "skipped": "skipped"}
"""How the points of a check may end, and the word of each in a student's table."""


def ending(check: Result) -> str:
    """How the points of a check ended: one of ``CHECK_ENDINGS``."""
    if check["passed"] is None:
        return "skipped"
    return "all" if check["passed"] else "some" if check["score"] else "none"


def reason(check: Result, language: str = "en") -> str:
    """The reason for a check's points and where to look, in one text; empty if it passed."""
    cause = check["cause"]
    if cause is None:
        return ""
    text = cause["rationale"]
    if cause.get("help") and check["passed"] is not None:
        text += words(language)("look", help=cause["help"])
    return text.replace("`", "")  # signs of Markdown, which is plain text here


def table(result: Result) -> Table:
    """A result for people: one check a line."""
    language = result["language"]
    say = words(language)
    rows = [
        (
            each["title"],
            say(CHECK_ENDINGS[ending(each)]),
            say("points", score=each["score"], most=each["max_score"]),
            "\n".join(
                [
                    reason(each, language),
                    each["remark"],
                    *(say("printed", line=line) for line in each["log"]),
                ]
            ).strip(),
        )
        for each in result["results"]
    ]
    total = say("total", score=result["score"], most=result["max_score"])
    title = say("heading", title=result["title"], student=result["student"], total=total)
    heads = (say("check"), "", say("points_heading"), say("why"))
    return Table(title, heads, rows, words=(0, 1, 3))


def points_or_reason(check: Result, language: str) -> str:
    """The points of a check; next to 0 the reason in a word."""
    if check["score"]:
        return f"{check['score']:g}"
    return f"0 {words(language)('zero_' + check['data']['ending'].replace(' ', '_'))}"


def first_error(result: Result, language: str) -> str:
    """Why a submission could not be graded, or its first error; empty for none."""
    if result.get("problem") == NOT_HANDED_IN:
        return words(language)("not_handed_in")
    errors = [
        each["cause"]["rationale"]
        for each in result["results"]
        if each["data"]["ending"] in ("broken", "timed out")
    ]
    return str(result.get("problem", next(iter(errors), "")))


def summary(found: Sequence[Result], language: str = "en") -> str:
    """The results of a class, in a sentence."""
    import pandas as pd  # noqa: PLC0415  of classes only, and not in ballplate-core

    scores = pd.Series([each["score"] for each in found if each["results"]], dtype=float)
    ends = {"low": scores.min(), "high": scores.max(), "median": scores.median()}
    problems = sum("problem" in each for each in found)
    shown = {name: digits(value) for name, value in ends.items()}
    say = words(language)
    students = say.count("students", len(found))
    return say("summary", students=students, problems=problems, **shown)
