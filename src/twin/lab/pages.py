"""Pages of what was judged: a student's, with the run that lost most points; a class's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from markupsafe import Markup

from twin.lab.forms import Result, table
from twin.lab.judge import Judge, ramp
from twin.lab.schema import Lab
from twin.page import Block, Picture, Table, Text, Verdict, html
from twin.report.html import overview
from twin.run.picture import drawn

WEAK = 0.2
"""Correlation with the other points below which a check tells good answers from others badly."""
COLOURS = {"all points": "#009e73", "some": "#e69f00", "none": "#d55e00", "skipped": "#bbbbbb"}
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
        f"{judge.lab.title}, version {judge.lab.version}; rig {judge.dealt.code}{told}",
    ]
    if rest := [each for each in results if each not in shown]:
        got, most = (sum(each[key] for each in rest) for key in ("score", "max_score"))
        lines.append(f"{got:g} of {most:g} of them by checks that are not shown")
    blocks = [
        Verdict(lines, result["score"] >= result["max_score"]),
        table({**result, "results": shown}),
        *pictured(judge, {each["name"]: each for each in shown}),
    ]
    return html(f"{judge.lab.title}: {result['student']}", blocks)


def pictured(judge: Judge, shown: Mapping[str, Result]) -> list[Block]:
    """The run of the check that lost most points; the first one where none did."""
    runs = [
        each
        for each in judge.lab.checks(hidden=True)
        if each.name in shown and each.scenario and not each.number
    ]
    if not runs:
        return []
    lost = [shown[each.name]["max_score"] - shown[each.name]["score"] for each in runs]
    check = runs[int(np.argmax(lost))]
    try:
        run = judge.picture(check)
        drawing = overview([replace(run, name="your answer")])
    except Exception as error:  # noqa: BLE001 - what cannot be drawn costs nobody a mark
        return [Text([f"No picture of '{check.name}': {error}"])]
    note = f"The first run of this check. {check.look}" if max(lost) > 0 else ""
    return [Picture(f"Check: {check.name}", drawing, note)]


def of_class(lab: Lab, found: Sequence[Result], folder: Path) -> str:
    """The page of a class.

    Args:
        lab: The lab.
        found: The results of its students.
        folder: Where their pages lie, beside this one.
    """
    marked = [each for each in found if each["score"] is not None]
    total = np.array([each["score"] for each in marked])
    checks = lab.checks(hidden=True)
    most = sum(each.points for each in checks)
    judged = [each for each in marked if each["results"]]
    points = np.array([[its["score"] for its in each["results"]] for each in judged])
    ends = [[ending(each["results"][at]) for each in judged] for at in range(len(checks))]
    rows = [
        (
            *(check.name, check.visible.replace("_", " ")),
            *(str(each.count(end)) for end in COLOURS),
            f"{points[:, at].mean():.2f} of {check.points:g}" if len(judged) else "-",
            *reached([its["results"][at]["data"]["value"] for its in judged]),
            discrimination(points, at),
            ramp(check),
        )
        for at, (check, each) in enumerate(zip(checks, ends, strict=True))
    ]
    heads = ("check", "shown", *COLOURS, "mean points", "median", "from", "to", "tells", "limits")
    note = (
        "median, from, to: the number that is judged, over the class. tells: correlation of a "
        f"check's points with those of all others; below {WEAK:g} it does not tell good answers "
        "from weak ones, and - where all have the same."
    )
    names = [check.name for check in checks]
    marks = [
        (
            link(each["student"], folder),
            f"{each['score']:g}" if each["score"] is not None else "-",
            *(f"{its['score']:g}" for its in each["results"] or [{"score": 0.0}] * len(checks)),
        )
        for each in sorted(found, key=lambda each: -(each["score"] or 0.0))
    ]
    problems = [(each["student"], each["problem"]) for each in found if "problem" in each]
    lines = [summary(found)]
    if len(total):
        lines.append(
            f"mean {total.mean():.2f} of {most:g} points, lowest {total.min():g}, "
            f"highest {total.max():g}; {int((total >= most).sum())} with all of them"
        )
    blocks: list[Block] = [Text(lines), Picture("Points", chart(total, most, names, ends))]
    if problems:
        blocks.append(Table("Not judged", ("student", "why"), problems, words=(0, 1)))
    blocks.append(Table("Checks", heads, rows, words=(0, 1, -1), note=note))
    blocks.append(Table("Marks", ("student", "points", *names), marks))
    return html(f"{lab.title}: {len(found)} students", blocks)


def summary(found: Sequence[Result]) -> str:
    """How a class did, in a sentence."""
    scores = [each["score"] for each in found if each["score"] is not None]
    problems = sum("problem" in each for each in found)
    middle = float(np.median(scores)) if scores else 0.0
    return f"{len(found)} students, {problems} with a problem; median {middle:g} points"


def ending(check: Mapping[str, Any]) -> str:
    """What became of a check: a key of ``COLOURS``."""
    if check["passed"] is None:
        return "skipped"
    return "all points" if check["passed"] else "some" if check["score"] else "none"


def reached(values: Sequence[float | None]) -> list[str]:
    """Median, least and largest of the numbers that were judged."""
    known = [value for value in values if value is not None]
    return [f"{float(of(known)):.3g}" if known else "-" for of in (np.median, np.min, np.max)]


def discrimination(points: np.ndarray, at: int) -> str:
    """Correlation of a check's points, of shape (people, checks), with those of all others."""
    if len(points) < 3:
        return "-"
    own, others = points[:, at], np.delete(points, at, axis=1).sum(axis=1)
    if not own.std() or not others.std():
        return "-"
    return f"{np.corrcoef(own, others)[0, 1]:.2f}"


def link(student: str, folder: Path) -> str:
    """A student, with the page of theirs behind it where there is one."""
    if not (folder / f"{student}.html").is_file():
        return student
    where = quote(f"{folder.name}/{student}.html")
    return Markup('<a href="{}">{}</a>').format(where, student)


def chart(
    total: np.ndarray, most: float, names: Sequence[str], ends: Sequence[Sequence[str]]
) -> Any:
    """How many have how many points, and what became of each check."""
    with drawn(12, max(3.2, 1.2 + 0.42 * len(names))) as figure:
        left, right = figure.subplots(1, 2, width_ratios=(1, 1.6))
        left.hist(total, np.linspace(0, most, 11).tolist(), color="#0072b2", rwidth=0.9)
        left.set(xlabel="points", ylabel="students", xlim=(0, most))
        left.yaxis.get_major_locator().set_params(integer=True)
        rows = np.arange(len(names))[::-1]
        begin = np.zeros(len(names))
        for end, colour in COLOURS.items():
            count = np.array([each.count(end) for each in ends], float)
            right.barh(rows, count, left=begin, color=colour, label=end)
            begin += count
        right.set_yticks(rows, [each.replace("$", r"\$") for each in names])
        right.set_xlabel("students")
        figure.legend(*right.get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure
