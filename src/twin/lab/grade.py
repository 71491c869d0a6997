"""Grades a class: each submission by itself, and again only what changed since the last time.

The result of a student is kept with its measurements and its page as soon as it is complete.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from controllers.catalog import EXECUTION_LOG
from twin.base.data_file import DataError, parse_json, read_regular
from twin.base.errors import ScenarioError, TwinError, printable, suggest
from twin.base.jobs import results
from twin.base.page import Verdict, html
from twin.base.writing import write_whole
from twin.lab.deals import reload_deal
from twin.lab.handed_in import Submission
from twin.lab.judge import Judge, Measured, Measurements, NotMeasuredError, judge_answer, source_of
from twin.lab.pages import Drawing, draw_worst_check, student_page
from twin.lab.result_files import format_result
from twin.lab.result_texts import NOT_HANDED_IN, Result
from twin.lab.schema import RUNS_MESSAGE, Lab


class Kept(NamedTuple):
    """Kept results of an earlier grading of a student.

    Attributes:
        result: The result; empty if there is none.
        measured: Measurements by their key.
        drawing: The picture of the page.
    """

    result: Result
    measured: Mapping[str, Measured]
    drawing: Drawing | None


NOTHING_KEPT = Kept({}, {}, None)


def read_kept(kept: Path, student: str) -> Kept:
    """Kept results of a student; nothing if a file is missing, or was not written whole."""
    try:
        result = parse_json((kept / f"{student}.json").read_bytes())
        measured = {key: Measured(**each) for key, each in result.pop("measured").items()}
        drawing = result.pop("drawing")
        if drawing is not None:
            svg = (kept / f"{student}.svg").read_text(encoding="utf-8")
            drawing = Drawing(**drawing, svg=svg)
    except (OSError, DataError, KeyError, TypeError, AttributeError, UnicodeDecodeError):
        return NOTHING_KEPT
    page = kept / f"{student}.html"
    return Kept(result if page.is_file() else {}, measured, drawing)


def grade_submission(
    lab: Lab,
    key: str | None,
    people: Collection[str] | None,
    kept: Path,
    source: str,
    each: Submission,
    *,
    simulates: bool = True,
) -> dict[str, Any]:
    """The result of a submission; a problem of it is part of the result.

    Its page, the measurements and the picture are written, as far as they changed.

    Args:
        lab: The lab.
        key: The key of the course.
        people: The students of the class; None for everyone who hands in.
        kept: Folder of the results.
        source: Hash of what runs depend on, see ``source_of``.
        each: The submission.
        simulates: Whether what is not kept is simulated.

    Raises:
        NotMeasuredError: If something is not kept, and nothing may be simulated.
        TwinError: If a file cannot be written.
    """
    shown = ""
    earlier = read_kept(kept, each.student)
    measurements = Measurements(source, earlier.measured, simulates)
    try:
        if people is not None and each.student not in people:
            where = suggest(each.student, people)  # not the whole class
            raise ScenarioError(f"student '{each.student}': not in the class{where}")
        if each.problem:
            raise ScenarioError(each.problem)
        with each.alone(lab.answer.file) as answer:
            result, page, drawing = _judge_with_page(
                lab, key, each.student, answer, measurements, earlier
            )
    except NotMeasuredError:
        raise
    except TwinError as error:
        problem = shown = printable(str(error))
    except Exception as error:  # noqa: BLE001 - one answer's error must not stop the others
        problem = printable(f"the grader failed: {type(error).__name__}: {error}")
        shown = "the grader failed; your lecturer has the reason"
    if shown:
        result, drawing = result_without_points(each.student, problem), None
        if result == earlier.result:
            return result
        page = html(f"{lab.shown_title}: {each.student}", [Verdict([shown], good=False)])
    if not page:
        return result
    write_whole(kept / f"{each.student}.html", page)
    if drawing is not None:
        write_whole(kept / f"{each.student}.svg", drawing.svg)
    about = drawing and {"check": drawing.check, "key": drawing.key, "problem": drawing.problem}
    measured = {key: found._asdict() for key, found in measurements.used.items()}
    stored = {**result, "measured": measured, "drawing": about}
    write_whole(kept / f"{each.student}.json", format_result(stored, "json"))
    return result


def result_without_points(student: str, problem: str) -> dict[str, Any]:
    """The result of a submission that could not be graded: its score is None, not 0."""
    return {"student": student, "score": None, "results": [], "problem": problem}


def _judge_with_page(
    lab: Lab,
    key: str | None,
    student: str,
    answer: Path,
    measurements: Measurements,
    earlier: Kept,
) -> tuple[dict[str, Any], str, Drawing | None]:
    """The result of an answer that exists, the student's page of it, and the page's picture.

    The page is empty if nothing changed.

    Raises:
        NotMeasuredError: If something is not kept, and nothing may be simulated.
        TwinError: If it cannot be graded.
    """
    try:
        read_regular(answer)
    except DataError as error:
        raise ScenarioError(f"{lab.answer.file}: {error}") from None
    dealt = reload_deal(lab, answer.parent, key, student)
    judge = Judge(lab, dealt, answer, measurements)
    result = judge_answer(lab, dealt, answer, hidden=True, measurements=measurements)
    if all(key in measurements.kept for key in measurements.used):
        result["seconds"] = earlier.result.get("seconds", result["seconds"])
    if result == earlier.result:
        return result, "", earlier.drawing
    shown = [each for each in result["results"] if each["visible"] != "hidden"]
    names = [each["name"] for each in shown]
    drawing = earlier.drawing
    for check in lab.checks(hidden=True):
        if drawing and check.name == drawing.check:
            still = check.name in names and judge.key(check) == drawing.key
            drawing = drawing if still else None
    if drawing is None or drawing.check not in names:
        if not measurements.simulates:
            raise NotMeasuredError("picture")
        drawing = draw_worst_check(judge, shown)
    return result, student_page(judge, result, everything=False, drawing=drawing), drawing


def grade(
    lab: Lab,
    key: str | None,
    people: Collection[str] | None,
    handed_in: list[Submission],
    kept: Path,
    processes: int,
    progress: Callable[[float], None],
) -> list[dict[str, Any]]:
    """The results of submissions, and of the students of the class without one.

    Args:
        lab: The lab.
        key: The key of the course.
        people: The students of the class; None for everyone who hands in.
        handed_in: The submissions.
        kept: Folder of the results, a file and a page for each student, written as soon as it is
            complete. A check with unchanged answer, rig, runs and code is not simulated again:
            points and texts are made from the measurements that are kept there.
        processes: Number of submissions that are graded at the same time.
        progress: Called with the number of finished ones.

    Raises:
        TwinError: If a folder cannot be read or written, or a process is killed.
    """
    for file in lab.own_code:
        EXECUTION_LOG.info(RUNS_MESSAGE, file)  # logged here, once, whatever process runs it
    work = partial(grade_submission, lab, key, people, kept, source_of(lab))
    done, left = {}, []
    for each in handed_in:
        if not each.named:  # no file can have the student's name
            done[each.student] = result_without_points(each.student, each.problem)
            continue
        try:
            done[each.student] = work(each, simulates=False)
        except NotMeasuredError:
            left.append((each.student, each))
    progress(len(done))
    if left:
        for student, result in results(work, left, processes):
            done[student] = result
            progress(len(done))
    for student in people or ():
        absent = {"student": student, "score": 0.0, "results": [], "problem": NOT_HANDED_IN}
        done.setdefault(student, absent)
    return [done[student] for student in sorted(done)]
