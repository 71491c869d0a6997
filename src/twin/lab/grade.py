"""Grades a class (resumable), tests a lab with its own answers, exports to course systems.

A result is kept for each student as soon as it is complete. Exports are packs of a lab for course
systems, and results in their formats, as JUnit and as pages.
"""

from __future__ import annotations

import json
import os
import re
import shutil
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple
from urllib.parse import quote

import numpy as np
from markupsafe import Markup, escape

from controllers.catalog import EXECUTION_LOG
from twin.base.data_file import DataError, parse_json, read_regular
from twin.base.errors import ScenarioError, TwinError, plural, printable, shorten, suggest
from twin.base.jobs import results
from twin.base.page import Block, Picture, Table, Text, Verdict, digits, html, inline
from twin.base.page import render_template as rendered
from twin.base.parts import own_version
from twin.base.shipped import folder as shipped
from twin.base.writing import write_folder, write_whole
from twin.lab.handed_in import Submission
from twin.lab.judge import (
    Judge,
    Measured,
    Measurements,
    NotMeasuredError,
    judge_answer,
    source_of,
)
from twin.lab.schema import (
    LAB_NAME_PATTERN,
    LOG_FILE,
    MAX_NAME_BYTES,
    PRIVATE_FILES,
    RUNS_MESSAGE,
    CheckTable,
    Deal,
    Lab,
    deal,
    fill_answer,
    load_function,
    record,
    reload_deal,
    starter,
    toml,
    write_notebook,
)
from twin.lab.words import words
from twin.run.tables import flat

NOT_HANDED_IN = "not handed in"
"""Problem of a student of the class without a submission."""
LAB_TEMPLATE_FOLDER = Path(__file__).with_name("templates")
Result = Mapping[str, Any]
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


def begin(name: str, folder: Path, like: Lab | None = None) -> None:
    """Write a lab as a start for a new one: a small one that passes its selftest, or a copy.

    Args:
        name: Its name.
        folder: Where to; must not exist.
        like: The lab to copy whole: solution, mutants, hidden checks and notes, as far as this
            installation has them; never a key.

    Raises:
        TwinError: If no lab can have that name, or it cannot be written.
    """
    if not re.fullmatch(LAB_NAME_PATTERN, name):
        allowed = "lower-case letters, digits, - and _, a letter or digit first, as in friction2"
        raise ScenarioError(f"NAME '{shorten(name)}': must be {allowed}")
    words, start = name.replace("_", " ").capitalize(), shipped() / "starts" / "lab"

    def fill(inner: Path) -> None:
        for file in filter(Path.is_file, start.rglob("*.*")):
            text = file.read_text(encoding="utf-8").replace("NAME", name)
            write_whole(inner / file.relative_to(start), text.replace("TITLE", words))
        write_whole(inner / "answer.py", starter((inner / "solution.py").read_text("utf-8")))

    def copy(inner: Path) -> None:
        assert like is not None
        for file in filter(Path.is_file, like.folder.rglob("*")):
            if "__pycache__" not in file.parts and not file.name.endswith("key.txt"):
                content = file.read_bytes()
                if file.suffix in (".md", ".toml", ".py"):
                    content = _rename_in(file, like.name, name).encode()
                write_whole(inner / file.relative_to(like.folder), content)

    write_folder(folder, fill if like is None else copy)


def _rename_in(file: Path, old: str, new: str) -> str:
    """The text of a file of a lab for the lab's copy: its name wherever it is named."""
    text = file.read_text(encoding="utf-8-sig")
    if file.name == "lab.toml":
        text = re.sub(r"(?m)^name\s*=.*$", f'name = "{new}"', text, count=1)
    return re.sub(rf"(ballplate lab \w+ |\bcd |\bLab `){re.escape(old)}\b", rf"\g<1>{new}", text)


def pack(lab: Lab, system: str, out: Path, key: str | None, wheel: Path | None) -> None:
    """Write a lab for a course system.

    Args:
        lab: The lab.
        system: ``folder``, all that students may have; ``gradescope``, a zip file; ``classroom50``,
            a folder for the autograder.
        out: File or folder; must not exist.
        key: The key of the course.
        wheel: Wheel of this program, where it is not to come from a package index.

    Raises:
        TwinError: If something of the lab is missing, or it cannot be written.
    """
    if wheel is not None and not wheel.is_file():
        raise ScenarioError(f"--wheel {wheel}: not found")
    if out.exists():
        raise ScenarioError(f"--out {out}: exists; give a new one")
    if system == "gradescope" and out.suffix != ".zip":
        raise ScenarioError(f"--out {out}: must end in .zip")
    if system != "gradescope":
        write_folder(out, lambda inner: _fill(lab, system, inner, key, wheel))
        return
    with TemporaryDirectory(prefix="ballplate-pack-") as name:
        inner = Path(name) / "zip"
        _fill(lab, system, inner, key, wheel)
        made = Path(shutil.make_archive(str(Path(name) / "made"), "zip", inner))
        write_whole(out, made.read_bytes())


def _fill(lab: Lab, system: str, inner: Path, key: str | None, wheel: Path | None) -> None:
    """Write the lab and the files of a system's templates into a folder."""
    graded = system != "folder"
    wanted = f"/autograder/source/{wheel.name}" if wheel else f"ballplate=={own_version()}"
    closed = {*PRIVATE_FILES, "__pycache__"} - ({"hidden.toml", "truth.py"} if graded else set())
    place = inner / "lab" if graded else inner
    shutil.copytree(lab.folder, place, dirs_exist_ok=True, ignore=shutil.ignore_patterns(*closed))
    check_without_key(place, key)
    if not graded:
        write_notebook(lab, inner, lab.sheet, lab.text(lab.answer.file))
        return
    for template in (LAB_TEMPLATE_FOLDER / system).iterdir():
        made = inner / template.stem
        write_whole(made, rendered(template, lab=lab, key=key, requirement=wanted))
        made.chmod(0o755)
    if key:  # in a folder of its own, from which no answer is copied
        write_whole(inner / KEY_FOLDER / "key.txt", key)
        (inner / KEY_FOLDER / "key.txt").chmod(0o600)
        (inner / KEY_FOLDER).chmod(0o700)
    if wheel:
        shutil.copy(wheel, inner)


KEY_FOLDER = "secret"
"""Folder of the course's key in a pack, closed to others than its owner."""


def check_without_key(folder: Path, key: str | None) -> None:
    """Make sure that the key is in no file of a lab that is exported.

    Raises:
        ScenarioError: If it is in one.
    """
    for file in filter(Path.is_file, folder.rglob("*")):
        if key and key.encode() in file.read_bytes():
            name = file.relative_to(folder)
            raise ScenarioError(
                f"{name}: contains the course's key; move it out of the lab's folder"
            )


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
    title = say("class_title", title=lab.shown_title, count=len(found))
    return html(title, blocks, lab.language)


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


HISTOGRAM_BINS = 10
"""Largest number of bins of the histogram of points."""
LONGEST_BAR = 20
"""Characters of the longest bar of a histogram."""


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


def summary(found: Sequence[Result], language: str = "en") -> str:
    """The results of a class, in a sentence."""
    import pandas as pd  # noqa: PLC0415  of classes only, and not in ballplate-core

    scores = pd.Series([each["score"] for each in found if each["results"]], dtype=float)
    ends = {"low": scores.min(), "high": scores.max(), "median": scores.median()}
    problems = sum("problem" in each for each in found)
    shown = {name: digits(value) for name, value in ends.items()}
    return words(language)("summary", count=len(found), problems=problems, **shown)


def link(student: str, folder: Path) -> str:
    """A student's name, linked to their page where there is one."""
    page = folder / f"{student}.html"
    if len(page.name.encode()) > MAX_NAME_BYTES + len(".html") or not page.is_file():
        return student
    where = quote(f"{folder.name}/{student}.html")
    return Markup('<a href="{}">{}</a>').format(where, student)


FAILS_PATTERN = re.compile(r"^\s*# fails: (.+?)\s*$", re.MULTILINE)
"""A line of a mutant that names a check which it must fail."""


@dataclass(frozen=True, kw_only=True)
class SelfTest:
    """How a lab is tested with the lecturer's own answers.

    Attributes:
        key: Key by which rigs are dealt for it.
        max_starter_share: Largest share of all points for the starter.
        max_mutant_share: Largest share of a check's points for a mutant that must fail it.
        max_grading_s: Longest time in s for grading an answer.
        full_stds: Distance of a proposed limit ``full`` from the solution's median, in standard
            deviations.
    """

    key: str = "a lab is tried"
    max_starter_share: float = 0.2
    max_mutant_share: float = 0.5
    max_grading_s: float = 60.0
    full_stds: float = 3


SELF_TEST = SelfTest()


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


FORMULA_START = re.compile(r"(^|[;,|])(\s*)(?=[=+\-@\uff1d\uff0b\uff0d\uff20])")
"""Where a spreadsheet would begin a formula: first in a cell, or after a sign between cells."""


def in_cell(text: str) -> str:
    """A text as a cell of a table that a spreadsheet opens: in one line, and no formula.

    An apostrophe is put before the beginning of one.
    """
    return FORMULA_START.sub(r"\1\2'", printable(text))


class SampleAnswer(NamedTuple):
    """An answer of the lecturer's own.

    Attributes:
        name: ``solution``, ``starter``, or the name of a mutant.
        file: Its path.
        fails: The checks that a mutant must fail.
    """

    name: str
    file: Path
    fails: tuple[str, ...] = ()


class Finding(NamedTuple):
    """One result of a test of a lab.

    Attributes:
        what: The property that was tested.
        good: Whether the lab has it.
        found: The numbers or the reason.
    """

    what: str
    good: bool
    found: str


def candidates(lab: Lab) -> list[SampleAnswer]:
    """Solution, starter and mutants of a lab.

    Raises:
        ScenarioError: If there is no solution, or a mutant names no check of the lab.
    """
    solutions = sorted(lab.folder.glob("solution.*"))
    if len(solutions) != 1:
        raise ScenarioError(f"{lab.folder.name}: must have one solution.py or solution.toml")
    found = [SampleAnswer("solution", solutions[0])]
    found.append(SampleAnswer("starter", lab.folder / lab.answer.file))
    names = {each.name for each in lab.checks(hidden=True)}
    for file in sorted((lab.folder / "mutants").glob("*.*")):
        fails = tuple(FAILS_PATTERN.findall(lab.text(f"mutants/{file.name}")))
        if not fails or not names.issuperset(fails):
            raise ScenarioError(
                f"{lab.folder.name}/mutants/{file.name}: must name checks of the lab in lines "
                f"'# fails: NAME', got {', '.join(fails) or 'none'}"
            )
        found.append(SampleAnswer(file.stem, file, fails))
    return found


def prepare_answer(lab: Lab, file: Path, dealt: Deal, folder: Path) -> Path:
    """An answer for a student's rig, as the student would hand it in, next to their log."""
    answer = folder / lab.answer.file
    if lab.answer.data and file.suffix == ".py":
        text = toml(flat(load_function(file, "answer")(dealt.point, folder)))
    else:
        text = fill_answer(file.read_text(encoding="utf-8"), dealt.known)
    answer.write_text(text, encoding="utf-8")
    return answer


def try_answer(lab: Lab, key: str, job: tuple[Path, str]) -> dict[str, Any]:
    """The result of a lecturer's own answer on the rig that a key deals to a student."""
    file, student = job
    dealt = deal(lab, student, key)
    with TemporaryDirectory(prefix="ballplate-lab-") as name:
        folder = Path(name)
        record(lab, dealt, folder / LOG_FILE)
        return judge_answer(lab, dealt, prepare_answer(lab, file, dealt, folder), hidden=True)


def try_answers(
    lab: Lab, students: Sequence[str], processes: int, key: str
) -> Iterator[tuple[SampleAnswer, dict[str, Any]]]:
    """Every answer of the lecturer's own, and its result on the rigs of some students."""
    jobs = ((each, (each.file, student)) for each in candidates(lab) for student in students)
    yield from results(partial(try_answer, lab, key), jobs, processes)


def selftest(lab: Lab, processes: int, test: SelfTest = SELF_TEST) -> Iterator[Finding]:
    """Whether a lab's solution, starter and mutants get the points that they should.

    Args:
        lab: The lab.
        processes: Number of answers that are graded at the same time.
        test: Constants of the test.

    Raises:
        ScenarioError: If its solution or a mutant cannot be tried.
    """
    if not lab.answer.data:
        same = starter(lab.text(candidates(lab)[0].file.name)) == lab.text(lab.answer.file)
        yield Finding(
            "the starter is made from the solution",
            same,
            "" if same else "write it again: --starter",
        )
    for who, result in try_answers(lab, ["selftest"], processes, test.key):
        points = f"{result['score']:g} of {result['max_score']:g} points, {result['seconds']:.1f} s"
        if who.name == "solution":
            lost = [each for each in result["results"] if not each["passed"]]
            why = "".join(f"; {each['name']}: {each['cause']['rationale']}" for each in lost)
            yield Finding("the solution has all points", not lost, points + why)
        elif who.name == "starter":
            good = result["score"] <= test.max_starter_share * result["max_score"]
            yield Finding(f"the starter has at most {test.max_starter_share:.0%}", good, points)
        for each in result["results"]:
            if each["name"] in who.fails:
                allowed = test.max_mutant_share * each["max_score"]
                good = each["passed"] is False and each["score"] <= allowed
                why = each["cause"]["rationale"] if each["cause"] else "it passes"
                yield Finding(f"mutant {who.name} fails '{each['name']}'", good, why)
        if result["seconds"] > test.max_grading_s:
            yield Finding(f"{who.name} is graded within {test.max_grading_s:g} s", False, points)


def calibrate(
    lab: Lab,
    rigs: int,
    processes: int,
    progress: Callable[[float], None],
    test: SelfTest = SELF_TEST,
) -> Iterator[Finding]:
    """Proposed limits for each check, from all own answers on a number of rigs.

    A finding is good where there is room between the limits.
    """
    values: dict[str, dict[SampleAnswer, list[float]]] = defaultdict(lambda: defaultdict(list))
    students = [f"rig{number}" for number in range(rigs)]
    for done, (who, result) in enumerate(try_answers(lab, students, processes, test.key), 1):
        progress(done)
        for each in result["results"]:
            if each["data"]["value"] is not None:
                values[each["name"]][who].append(each["data"]["value"])
    for check in lab.checks(hidden=True):
        yield propose_limits(check, values[check.name], rigs, test.full_stds)


def propose_limits(
    check: CheckTable,
    values: dict[SampleAnswer, list[float]],
    rigs: int,
    full_stds: float = SELF_TEST.full_stds,
) -> Finding:
    """Limits of a check for the numbers that the lecturer's own answers reached.

    ``full`` is the solution's median and a number of its standard deviations, or its worst rig if
    that is worse; ``none`` is the best of the medians of the mutants that must fail it and, where
    more than the outcome counts, of the starter.
    """
    sense = 1 if check.full < check.none else -1  # small is good, or large
    good, bad = np.zeros(0), {}
    for who, reached in values.items():
        if who.name == "solution":
            good = sense * np.array(reached)
        elif check.name in who.fails or (who.name == "starter" and (check.metric or check.number)):
            bad[float(np.median(sense * np.array(reached)))] = who.name
    if len(good) < rigs:
        failed = f"the solution fails on {rigs - len(good)} of {plural(rigs, 'rig')}"
        return Finding(check.name, False, failed)
    full = max(np.median(good) + full_stds * good.std(), good.max())
    none = min(bad, default=np.inf)
    text = f"full = {check.full:g}, none = {check.none:g}; proposed: full = {sense * full:.4g}"
    if bad:
        text += f", none = {sense * none + 0.0:.4g} ({bad[none]})"
    room = bool(full < none)
    return Finding(check.name, room, text + ("" if room else ": they overlap"))
