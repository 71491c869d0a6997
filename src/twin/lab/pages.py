"""Pages of results: a student's, with the picture of a check, and the class's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote

import numpy as np
from markupsafe import Markup

from twin.base.errors import printable
from twin.base.page import Block, Picture, Table, Text, Verdict, digits, html, inline
from twin.lab.handing_out import MAX_NAME_BYTES
from twin.lab.judge import Judge
from twin.lab.result_texts import (
    CHECK_ENDINGS,
    NOT_HANDED_IN,
    Result,
    ending,
    first_error,
    points_or_reason,
    summary,
    table,
)
from twin.lab.schema import Lab
from twin.lab.words import words

HISTOGRAM_BINS = 10
"""Largest number of bins of the histogram of points."""
LONGEST_BAR = 20
"""Characters of the longest bar of a histogram."""


class Drawing(NamedTuple):
    """The picture of a check on a student's page.

    Attributes:
        check: Name of the check.
        key: Key of its measurement; the picture is drawn again when it changes.
        svg: The picture; empty for none.
        problem: Why there is none.
    """

    check: str
    key: str = ""
    svg: str = ""
    problem: str = ""


def student_page(
    judge: Judge, result: Result, *, everything: bool, drawing: Drawing | None = None
) -> str:
    """The page of a student.

    Args:
        judge: Judges the answer.
        result: Its result.
        everything: Whether hidden checks are on it, too.
        drawing: The picture; by default the one of the check that lost most points.
    """
    results, say = result["results"], words(judge.lab.language)
    shown = [each for each in results if everything or each["visible"] != "hidden"]
    rig = "".join(f"; {key} = {value:.6g}" for key, value in judge.dealt.known.items())
    about = {"lab": judge.lab.name, "version": judge.lab.version, "code": judge.dealt.code}
    lines = [
        say("total", score=result["score"], most=result["max_score"]),
        say("rig", **about) + rig,
    ]
    if rest := [each for each in results if each not in shown]:
        got, most = (sum(each[key] for each in rest) for key in ("score", "max_score"))
        lines.append(say("not_shown", score=got, most=most))
    blocks = [
        Verdict(lines, result["score"] >= result["max_score"]),
        replace(table({**result, "results": shown}), title=say("checks")),
        *show_drawing(judge, result, drawing or draw_worst_check(judge, shown)),
    ]
    title = f"{judge.lab.shown_title}: {result['student']}"
    return html(title, blocks, judge.lab.language)


def draw_worst_check(judge: Judge, shown: Sequence[Result]) -> Drawing | None:
    """The run of the check that lost most points; if none did, of the one with most points."""
    results = {each["name"]: each for each in shown}
    runs = [
        each
        for each in judge.lab.checks(hidden=True)
        if each.name in results and each.scenario and not each.number
    ]
    if not runs:
        return None
    check = max(runs, key=lambda each: (each.points - results[each.name]["score"], each.points))
    key = judge.key(check) if judge.measurements else ""
    name = words(judge.lab.language)("your_answer")
    try:
        from twin.view.html import overview  # noqa: PLC0415  heavy: unchanged nothing is drawn

        drawing = overview([replace(judge.picture(check), name=name)])
    except Exception as error:  # noqa: BLE001 - a missing picture costs no points
        return Drawing(check.name, key, problem=printable(str(error)))
    return Drawing(check.name, key, inline(drawing))


def show_drawing(judge: Judge, result: Result, drawing: Drawing | None) -> list[Block]:
    """The picture of a check, or why there is none."""
    if drawing is None:
        return []
    say, name = words(judge.lab.language), drawing.check
    if drawing.problem:
        return [Text([say("no_picture", check=name, error=drawing.problem)])]
    check = next(each for each in judge.lab.checks(hidden=True) if each.name == name)
    lost = any(each["name"] == name and not each["passed"] for each in result["results"])
    texts = check.texts_in(judge.lab.language)
    note = say("picture_note", look=texts.look.replace("`", "")) if lost else ""
    return [Picture(say("picture", check=texts.name), Markup(drawing.svg), note)]


def class_page(
    lab: Lab,
    found: Sequence[Result],
    folder: Path,
    left_out: Sequence[str] = (),
    *,
    people: Mapping[str, str] | None = None,
    alike: Sequence[str] = (),
) -> str:
    """The page of a class.

    Args:
        lab: The lab.
        found: The results of its students.
        folder: Folder of their pages, next to this page.
        left_out: Entries among the submissions that are none, in words.
        people: The names of students, if known.
        alike: Answers that are alike, in words.
    """
    import pandas as pd  # noqa: PLC0415  of classes only, and not in ballplate-core

    say, names = words(lab.language), people or {}
    graded, checks = [each for each in found if each["results"]], lab.checks(hidden=True)
    scores = [[its["score"] for its in each["results"]] for each in graded]
    points, rows = pd.DataFrame(scores, columns=range(len(checks))), []
    for at, check in enumerate(checks):
        its = [each["results"][at] for each in graded]
        ends = [ending(each) for each in its]
        counts = (str(ends.count(end)) for end in CHECK_ENDINGS)
        mean = digits(points[at].mean(), places=2)
        name = f"{at + 1} {check.texts_in(lab.language).name} ({check.points:g})"
        rows.append((name, *counts, mean))
    marks = []
    for each in sorted(found, key=lambda each: -(each["score"] or 0.0)):
        cells = [points_or_reason(its, lab.language) for its in each["results"]]
        total = "-" if each["score"] is None else f"{each['score']:g}"
        if each.get("problem") == NOT_HANDED_IN:
            total = f"0 {say('not_handed_in')}"
        who = Markup(" ").join([link(each["student"], folder), names.get(each["student"], "")])
        marks.append((who, total, *cells, *[""] * (len(checks) - len(cells))))
    blocks: list[Block] = [Text([summary(found, lab.language)])]
    if alike:
        blocks.append(Verdict(alike, good=False, title=say("alike_heading")))
    if scores:
        blocks.append(histogram(lab, [each["score"] for each in graded]))
    if problems := [
        (each["student"], line) for each in found if (line := first_error(each, lab.language))
    ]:
        heads = (say("student"), say("why"))
        blocks.append(Table(say("not_graded"), heads, problems, words=(0, 1)))
    if left_out:
        blocks.append(Text(left_out, title=say("left_out")))
    columns = (say("check"), *map(say, CHECK_ENDINGS), say("mean_points"))
    blocks.append(Table(say("checks"), columns, rows))
    numbers = map(str, range(1, len(checks) + 1))
    columns = (say("student"), say("points_heading"), *numbers)
    blocks.append(Table(say("marks_heading"), columns, marks))
    title = say("class_title", title=lab.shown_title, students=say.count("students", len(found)))
    return html(title, blocks, lab.language)


def histogram(lab: Lab, scores: Sequence[float]) -> Table:
    """How many students have how many points, as a table with bars."""
    say, most = words(lab.language), sum(each.points for each in lab.checks(hidden=True))
    bins = min(HISTOGRAM_BINS, max(1, round(most)))
    counts, edges = np.histogram(np.clip(scores, 0, most), bins=bins, range=(0, most))
    scale = min(1.0, LONGEST_BAR / max(counts))
    rows = [
        (f"{low:g} - {high:g}", str(count), "\u2588" * round(np.ceil(scale * count)))
        for low, high, count in zip(edges[:-1], edges[1:], counts, strict=True)
    ]
    heads = (say("points_heading"), say("students_heading"), "")
    return Table(say("histogram"), heads, rows, words=(0, 2))


def link(student: str, folder: Path) -> str:
    """A student's name, linked to their page where there is one."""
    page = folder / f"{student}.html"
    if len(page.name.encode()) > MAX_NAME_BYTES + len(".html") or not page.is_file():
        return student
    where = quote(f"{folder.name}/{student}.html")
    return Markup('<a href="{}">{}</a>').format(where, student)
