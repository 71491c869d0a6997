"""A class's answers are judged: each kept when it is finished, so that nothing is done twice."""

from __future__ import annotations

import csv
import hashlib
import io
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from twin.data_file import DataError, parse_json
from twin.errors import ScenarioError, TwinError
from twin.jobs import results
from twin.lab.judge import digest_of, judged
from twin.lab.results import own
from twin.lab.schema import Lab
from twin.lab.variants import RIG, had_again, known
from twin.study.work import code, digest
from twin.writing import write_whole


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
    answer, found = lab.about.answer.file, []
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


class Grader(NamedTuple):
    """What every submission is judged by.

    Attributes:
        lab: The lab.
        key: The course's.
        mark: What tells the lab's present files and this program from others.
        people: Who is in the class; None for whoever hands in.
        user: Whom an answer's process belongs to.
    """

    lab: Lab
    key: str | None
    mark: str
    people: list[str] | None = None
    user: str | None = None

    def name(self, each: Submission) -> str:
        """What tells a submission's result from that of any other."""
        parts = (self.mark, each.student, digest_of(each.file), digest_of(each.folder / RIG))
        return digest(" ".join((*parts, str(self.key))))

    def __call__(self, each: Submission) -> dict[str, Any]:
        """The result of a submission; what is wrong with it is part of that."""
        result: dict[str, Any] = {"student": each.student, "score": None, "results": []}
        try:
            if self.people is not None:
                known(each.student, self.people)
            dealt = had_again(self.lab, each.folder, self.key, each.student)
            result = judged(self.lab, dealt, each.file, hidden=True, user=self.user)
        except TwinError as error:
            result["problem"] = str(error)
        except Exception as error:  # noqa: BLE001 - one answer's trouble is not that of others
            result["problem"] = f"the grader failed: {type(error).__name__}: {error}"
        return {**result, "kept_as": self.name(each)}

    def grade(
        self,
        handed_in: list[Submission],
        kept: Path,
        processes: int,
        progress: Callable[[float], None],
    ) -> list[dict[str, Any]]:
        """The results of submissions, and of who of the class handed in none.

        Args:
            handed_in: The submissions.
            kept: Folder of the results, one file a student, written when it is finished; those of
                unchanged submissions are taken from there.
            processes: How many are judged side by side.
            progress: Told how many are finished.

        Raises:
            TwinError: If a folder cannot be read or written, or a process is killed.
        """
        done = {}
        for each in handed_in:
            with suppress(OSError, DataError):
                result = parse_json((kept / f"{each.student}.json").read_bytes())
                if result.get("kept_as") == self.name(each):
                    done[each.student] = result
        left = [(each.student, each) for each in handed_in if each.student not in done]
        for name, result in results(self.__call__, left, processes):
            write_whole(kept / f"{name}.json", own(result))
            done[name] = result
            progress(len(done))
        for name in self.people or ():
            absent = {"student": name, "score": 0.0, "results": [], "problem": "not handed in"}
            done.setdefault(name, absent)
        return [done[name] for name in sorted(done)]


def mark_of(lab: Lab) -> str:
    """What tells a lab's files, as they are now, and this program from others."""
    files = sorted(path for path in lab.folder.rglob("*") if path.is_file())
    total = hashlib.sha256(code().encode())
    for path in files:
        if "__pycache__" not in path.parts:
            total.update(path.read_bytes())
    return total.hexdigest()


def marks(lab: Lab, found: list[dict[str, Any]]) -> str:
    """The marks of a class as CSV: a student a line, a check a column."""
    checks = [each.name for each in lab.checks(hidden=True)]
    text = io.StringIO()
    rows = csv.writer(text)
    rows.writerow(["student", "score", "max_score", *checks, "problem"])
    for each in found:
        scores = {check["name"]: check["score"] for check in each["results"]}
        rows.writerow(
            [each["student"], each["score"], each.get("max_score", "")]
            + [scores.get(name, "") for name in checks]
            + [each.get("problem", "")]
        )
    return text.getvalue()


def summary(found: list[dict[str, Any]]) -> str:
    """How a class did, in a sentence."""
    scores = sorted(each["score"] for each in found if each["score"] is not None)
    problems = sum("problem" in each for each in found)
    middle = scores[len(scores) // 2] if scores else 0.0
    return f"{len(found)} students, {problems} with a problem; median {middle:g} points"
