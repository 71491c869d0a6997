"""Many answers are judged: a class's, each kept when it is finished; and the lecturer's own."""

from __future__ import annotations

import hashlib
import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from twin.data_file import DataError, parse_json
from twin.errors import ScenarioError, TwinError, nearest
from twin.jobs import results
from twin.lab.judge import Judge, digest_of, judged
from twin.lab.pages import of_student, written
from twin.lab.schema import (
    LOG,
    RIG,
    CheckTable,
    Deal,
    Lab,
    deal,
    filled,
    had_again,
    record,
    starter,
    toml,
    trusted,
)
from twin.page import Verdict, html
from twin.report.numbers import flat
from twin.study.work import code, digest
from twin.writing import write_whole

KEY = "a lab is tried"
"""The key by which rigs are dealt here."""
FAILS = re.compile(r"^\s*# fails: (.+?)\s*$", re.MULTILINE)
STARTER = 0.2
"""Share of the points that a starter may have."""
MUTANT = 0.5
"""Share of a check's points that a mutant may have which is to fail it."""
LONGEST = 60.0
"""Seconds in which an answer is to be judged."""


class Submission(NamedTuple):
    """What a student handed in: the file, there or not, and the folder that is theirs alone."""

    student: str
    file: Path
    folder: Path


def submissions(lab: Lab, folder: Path) -> list[Submission]:
    """What lies in a folder: a folder or a file a student, called like them.

    Raises:
        ScenarioError: If there is nothing, or two of one student.
    """
    if not folder.is_dir():
        raise ScenarioError(f"{folder}: must be the folder of the submissions")
    answer, found = lab.answer.file, []
    for each in sorted(folder.glob("[!.]*")):
        if each.is_dir():
            found.append(Submission(each.name, each / answer, each))
        elif each.suffix == Path(answer).suffix:
            found.append(Submission(each.stem, each, each))
    if not found:
        raise ScenarioError(f"{folder}: holds no submission, a folder or a file a student")
    who = [each.student for each in found]
    if twice := next((name for name in who if who.count(name) > 1), None):
        raise ScenarioError(f"{folder}: two submissions of '{twice}'")
    return found


def graded(
    lab: Lab, key: str | None, people: list[str] | None, kept: Path, each: Submission
) -> dict[str, Any]:
    """The result of a submission, its page written; what is wrong with it is part of that."""
    try:
        if people is not None and each.student not in people:
            where = nearest(each.student, people)
            raise ScenarioError(f"student '{each.student}': not in the class{where}")
        dealt = had_again(lab, each.folder, key, each.student)
        result = judged(lab, dealt, each.file, hidden=True)
        page = of_student(Judge(lab, dealt, each.file), result, everything=False)
    except Exception as error:  # noqa: BLE001 - one answer's trouble is not that of others
        own = isinstance(error, TwinError)
        problem = str(error) if own else f"the grader failed: {type(error).__name__}: {error}"
        result = {"student": each.student, "score": None, "results": [], "problem": problem}
        page = html(f"{lab.title}: {each.student}", [Verdict([problem], good=False)])
    write_whole(kept / f"{each.student}.html", page)
    return result


def grade(
    lab: Lab,
    key: str | None,
    people: list[str] | None,
    handed_in: list[Submission],
    kept: Path,
    processes: int,
    progress: Callable[[float], None],
) -> list[dict[str, Any]]:
    """The results of submissions, and of who of the class handed in none.

    Args:
        lab: The lab.
        key: The course's.
        people: Who is in the class; None for whoever hands in.
        handed_in: The submissions.
        kept: Folder of the results, a file and a page a student, written when it is finished;
            those of unchanged submissions are taken from there.
        processes: How many are judged side by side.
        progress: Told how many are finished.

    Raises:
        TwinError: If a folder cannot be read or written, or a process is killed.
    """
    mark, done = mark_of(lab), {}
    names = {
        each.student: digest(
            f"{mark} {key} {each.student} {digest_of(each.file)} {digest_of(each.folder / RIG)}"
        )
        for each in handed_in
    }
    for student, name in names.items():
        with suppress(OSError, DataError):
            result = parse_json((kept / f"{student}.json").read_bytes())
            if result.get("kept_as") == name and (kept / f"{student}.html").is_file():
                done[student] = result
    left = [(each.student, each) for each in handed_in if each.student not in done]
    for student, result in results(partial(graded, lab, key, people, kept), left, processes):
        done[student] = {**result, "kept_as": names[student]}
        write_whole(kept / f"{student}.json", written(done[student], "json"))
        progress(len(done))
    for student in people or ():
        absent = {"student": student, "score": 0.0, "results": [], "problem": "not handed in"}
        done.setdefault(student, absent)
    return [done[student] for student in sorted(done)]


def mark_of(lab: Lab) -> str:
    """What tells a lab's files, as they are now, and this program from others."""
    total = hashlib.sha256(code().encode())
    for path in sorted(lab.folder.rglob("*")):
        if path.is_file() and "__pycache__" not in path.parts:
            total.update(path.read_bytes())
    return total.hexdigest()


def marks(lab: Lab, found: list[dict[str, Any]]) -> str:
    """The marks of a class as CSV: a student a line, a check a column."""
    heads = ("student", "score", "max_score", *(each.name for each in lab.checks(hidden=True)))
    rows = [each | {check["name"]: check["score"] for check in each["results"]} for each in found]
    return str(pd.DataFrame(rows, columns=[*heads, "problem"]).to_csv(index=False))


class SampleAnswer(NamedTuple):
    """An answer of the lecturer's own.

    Attributes:
        name: ``solution``, ``starter``, or what a mutant is called.
        file: Where it lies.
        fails: The checks that a mutant is to fail.
    """

    name: str
    file: Path
    fails: tuple[str, ...] = ()


class Finding(NamedTuple):
    """What was tried of a lab, whether it is as it must be, and what was found."""

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
        fails = tuple(FAILS.findall(lab.text(f"mutants/{file.name}")))
        if not fails or not names.issuperset(fails):
            raise ScenarioError(
                f"{lab.folder.name}/mutants/{file.name}: must name checks of the lab in lines "
                f"'# fails: NAME', got {', '.join(fails) or 'none'}"
            )
        found.append(SampleAnswer(file.stem, file, fails))
    return found


def prepared(lab: Lab, file: Path, dealt: Deal, folder: Path) -> Path:
    """An answer for a student's rig, as the student would hand it in, beside their log."""
    answer = folder / lab.answer.file
    if lab.answer.data and file.suffix == ".py":
        text = toml(flat(trusted(file, "answer")(dealt.point, folder)))
    else:
        text = filled(file.read_text(encoding="utf-8"), dealt.told)
    answer.write_text(text, encoding="utf-8")
    return answer


def tried(lab: Lab, job: tuple[Path, str]) -> dict[str, Any]:
    """The result of a lecturer's own answer on the rig of some student."""
    file, student = job
    dealt = deal(lab, student, KEY)
    with TemporaryDirectory(prefix="ballplate-lab-") as name:
        folder = Path(name)
        record(lab, dealt, folder / LOG)
        return judged(lab, dealt, prepared(lab, file, dealt, folder), hidden=True)


def all_tried(
    lab: Lab, students: Sequence[str], processes: int
) -> Iterator[tuple[SampleAnswer, dict[str, Any]]]:
    """Every answer of the lecturer's own, and its result on the rigs of some students."""
    jobs = ((each, (each.file, student)) for each in candidates(lab) for student in students)
    yield from results(partial(tried, lab), jobs, processes)


def selftest(lab: Lab, processes: int) -> Iterator[Finding]:
    """What a lab's solution, starter and mutants get.

    Raises:
        ScenarioError: If its solution or a mutant cannot be tried.
    """
    if not lab.answer.data:
        same = starter(lab.text(candidates(lab)[0].file.name)) == lab.text(lab.answer.file)
        yield Finding(
            "the starter is made from the solution",
            same,
            "" if same else "make it again: --starter",
        )
    for who, result in all_tried(lab, ["selftest"], processes):
        points = f"{result['score']:g} of {result['max_score']:g} points, {result['seconds']:.1f} s"
        if who.name == "solution":
            lost = [each for each in result["results"] if not each["passed"]]
            why = "".join(f"; {each['name']}: {each['cause']['rationale']}" for each in lost)
            yield Finding("the solution has all points", not lost, points + why)
        elif who.name == "starter":
            good = result["score"] <= STARTER * result["max_score"]
            yield Finding(f"the starter has at most {STARTER:.0%}", good, points)
        for each in result["results"]:
            if each["name"] in who.fails:
                good = each["passed"] is False and each["score"] <= MUTANT * each["max_score"]
                why = each["cause"]["rationale"] if each["cause"] else "it passes"
                yield Finding(f"mutant {who.name} fails '{each['name']}'", good, why)
        if result["seconds"] > LONGEST:
            yield Finding(f"{who.name} is judged within {LONGEST:g} s", False, points)


def calibrate(
    lab: Lab, rigs: int, processes: int, progress: Callable[[float], None]
) -> Iterator[Finding]:
    """For each check what limits fit, from all own answers on so many rigs.

    Good is where there is room between the limits.
    """
    values: dict[str, dict[SampleAnswer, list[float]]] = defaultdict(lambda: defaultdict(list))
    students = [f"rig{number}" for number in range(rigs)]
    for done, (who, result) in enumerate(all_tried(lab, students, processes), 1):
        progress(done)
        for each in result["results"]:
            if each["data"]["value"] is not None:
                values[each["name"]][who].append(each["data"]["value"])
    for check in lab.checks(hidden=True):
        yield proposed(check, values[check.name], rigs)


def proposed(check: CheckTable, values: dict[SampleAnswer, list[float]], rigs: int) -> Finding:
    """What limits of a check fit the numbers that the lecturer's own answers reached.

    ``full`` is the solution's median and three of its standard deviations, or its worst rig if that
    is worse; ``none`` is the best of the medians of the mutants that are to fail it and, where more
    than the outcome is judged, of the starter.
    """
    sense = 1 if check.full < check.none else -1  # small is good, or large
    good, bad = np.zeros(0), {}
    for who, reached in values.items():
        if who.name == "solution":
            good = sense * np.array(reached)
        elif check.name in who.fails or (who.name == "starter" and (check.metric or check.number)):
            bad[float(np.median(sense * np.array(reached)))] = who.name
    if len(good) < rigs:
        failed = f"the solution fails on {rigs - len(good)} of {rigs} rigs"
        return Finding(check.name, False, failed)
    full, none = max(np.median(good) + 3 * good.std(), good.max()), min(bad, default=np.inf)
    text = f"full = {check.full:g}, none = {check.none:g}; proposed: full = {sense * full:.4g}"
    if bad:
        text += f", none = {sense * none + 0.0:.4g} ({bad[none]})"
    room = bool(full < none)
    return Finding(check.name, room, text + ("" if room else ": they overlap"))
