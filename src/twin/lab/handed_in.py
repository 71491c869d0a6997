"""Submissions of a class: the student of each entry of a folder, and its files, opened safely.

An entry is a student's folder or file, under their own name or the name of a course system. Nothing
is opened but regular files of limited size in the submission itself: no link, no pipe, no device,
no file that has a second name elsewhere.
"""

from __future__ import annotations

import os
import re
import stat
import unicodedata
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from twin.base.data_file import DataError, read_regular
from twin.base.errors import ScenarioError, printable, shorten
from twin.lab.deals import RIG_FILE
from twin.lab.handing_out import check_name
from twin.lab.schema import AnswerTable, Lab

MAX_COPIED_BYTES = 32 * 1024**2
"""Sum of the files of a submission that a lab's own function may read."""
MAX_COPIED_FILES = 256
"""Number of these files."""
MAX_SEARCHED_ENTRIES = 500
"""Entries of a submission among which a missing answer is searched."""
MAX_SEARCH_DEPTH = 4
"""Depth of folders in which it is searched."""
MAX_NAMED_FILES = 3
"""Files that a message names."""
ARCHIVE_SUFFIXES = (".zip", ".tar", ".gz", ".tgz", ".bz2", ".xz", ".7z", ".rar")
MOODLE_NAME = re.compile(
    r"(?P<student>.+?)_(?P<number>\d+)_assignsubmission_(?:file|onlinetext)_?(?P<file>.*)",
    re.DOTALL,
)
"""Moodle's ``FULL NAME_12345_assignsubmission_file_``: a folder, or a file's beginning."""
CANVAS_NAME = re.compile(
    r"(?P<student>[^_]+)(?:_(?i:late))?_(?P<number>\d+)_\d+_(?P<file>.+)", re.DOTALL
)
"""Canvas's ``NAME_12345_67890_FILE``, with ``_LATE`` after the name for an overdue one."""
CLASSROOM_FOLDERS = (".git", ".github")
"""Folders in the folder ``LAB-NAME`` of GitHub Classroom."""
REPEATED_NAME = re.compile(r"(?P<stem>.+?)-(?P<number>\d+)(?P<suffix>\.[^.]+)", re.DOTALL)
"""Canvas's name of a file that was handed in again: ``answer-1.py``."""


class Submission(NamedTuple):
    """The submission of a student.

    Attributes:
        student: The student, by a name that is valid for a file; else the entry's name, readable.
        answer: The answer; its expected path if there is none.
        rig: The ``rig.toml``, or its expected path.
        problem: The reason why it cannot be graded, in a line; empty if it can.
        named: Whether the student's name is valid for a file.
        apart: Whether it is in a folder of the student's own, not among the files of others.
    """

    student: str
    answer: Path
    rig: Path
    problem: str = ""
    named: bool = True
    apart: bool = True

    @contextmanager
    def alone(self, called: str) -> Iterator[Path]:
        """The answer in a folder without files of other students.

        Args:
            called: The lab's name of the answer.

        Raises:
            DataError: If it, or the ``rig.toml``, is no file that may be opened.
        """
        if self.apart:
            yield self.answer
            return
        with TemporaryDirectory(prefix="ballplate-submission-") as name:
            answer = Path(name) / called
            answer.write_bytes(read_regular(self.answer))
            if is_there(self.rig):
                (Path(name) / RIG_FILE).write_bytes(read_regular(self.rig))
            yield answer


class Collected(NamedTuple):
    """The entries of a folder: submissions, and the others in words."""

    submissions: list[Submission]
    left_out: list[str]


def is_there(file: Path) -> bool:
    """Whether there is anything of this name, also a link without a target."""
    with suppress(OSError, ValueError):
        file.lstat()
        return True
    return False


@contextmanager
def copy_files(folder: Path) -> Iterator[Path]:
    """A private copy of the regular files of a submission, for a lab's own function to read.

    Args:
        folder: The folder of the submission.

    Raises:
        ScenarioError: If they are too many or too large together.
    """
    with TemporaryDirectory(prefix="ballplate-submission-") as name:
        copies, total = 0, 0
        for file in sorted(folder.iterdir()):
            try:
                content = read_regular(file, MAX_COPIED_BYTES)
            except DataError:
                continue  # a file that cannot be read counts as missing
            copies, total = copies + 1, total + len(content)
            if copies > MAX_COPIED_FILES or total > MAX_COPIED_BYTES:
                most = f"{MAX_COPIED_FILES} files of {MAX_COPIED_BYTES // 1024**2} MB together"
                raise ScenarioError(f"the folder of the answer has more than {most}")
            (Path(name) / file.name).write_bytes(content)
        yield Path(name)


def missing(about: AnswerTable, answer: Path) -> str:
    """The message that an answer is missing, with the files that are there, in a line."""
    here = f"no {about.file}"
    suffix, stem = Path(about.file).suffix, Path(about.file).stem.casefold()
    if not answer.parent.is_dir():
        return here
    files = [path.relative_to(answer.parent) for path in _regular_files(answer.parent)]
    ranked = (
        [each for each in files if each.name == about.file],
        [each for each in files if each.name.casefold().startswith(stem)],
        [each for each in files if each.suffix.casefold() == suffix],
        [each for each in files if each.suffix.casefold() in ARCHIVE_SUFFIXES],
        [each for each in files if each.name != RIG_FILE],
    )
    for alike in ranked:
        if alike:
            names = [shorten(printable(each.as_posix())) for each in alike[:MAX_NAMED_FILES]]
            others = len(alike) - MAX_NAMED_FILES
            more = f" and {others} more" if others > 0 else ""
            packed = all(each.suffix.casefold() in ARCHIVE_SUFFIXES for each in alike)
            unpack = ": unpack it" if packed else ""
            return f"{here}; there is {', '.join(names)}{more}{unpack}"
    return f"{here}; there is nothing else" if not files else here


def _regular_files(folder: Path) -> list[Path]:
    """The regular files of a folder and its subfolders, within limits; no link is followed."""
    found: list[Path] = []
    waiting, seen = [(folder, 0)], 0
    while waiting:
        place, depth = waiting.pop(0)
        with suppress(OSError), os.scandir(place) as entries:
            for entry in sorted(entries, key=lambda each: each.name):
                seen += 1
                if seen > MAX_SEARCHED_ENTRIES:
                    return found
                if entry.name.startswith(".") or entry.name == "__MACOSX":
                    continue
                if entry.is_dir(follow_symlinks=False):
                    if depth < MAX_SEARCH_DEPTH:
                        waiting.append((place / entry.name, depth + 1))
                elif entry.is_file(follow_symlinks=False):
                    found.append(place / entry.name)
    return found


def collect(lab: Lab, folder: Path, people: Collection[str] = ()) -> Collected:
    """The entries of the folder of a class; no entry prevents the mark of a different one.

    Args:
        lab: The lab.
        folder: The folder of the submissions.
        people: The students of the class, if known; those of a mapping have names, by which a
            course system may call them.

    Raises:
        ScenarioError: If there is no such folder, or no student's folder or file in it.
    """
    if not folder.is_dir():
        raise ScenarioError(f"{folder}: must be the folder of the submissions")
    entries: dict[str, list[Path]] = defaultdict(list)
    left_out = []
    for path in sorted(folder.iterdir()):
        try:
            entries[_student_of(lab.answer, path, people)].append(path)
        except ScenarioError as error:
            left_out.append(f"{shorten(printable(path.name))}: {error}")
    for name, paths in list(entries.items()):
        numbers = {path: _number_of(path) for path in paths}
        if len({*numbers.values()} - {""}) > 1:  # namesakes, or a class without names
            del entries[name]
            for path, number in numbers.items():
                entries[f"{name}_{number}".rstrip("_")].append(path)
    if not entries:
        raise ScenarioError(f"{folder}: holds no submission, a folder or a file for each student")
    found = [_submission(lab.answer, name, paths) for name, paths in entries.items()]
    return Collected(sorted(found), left_out)


def _student_of(about: AnswerTable, path: Path, people: Collection[str]) -> str:
    """The student to whom an entry belongs.

    Raises:
        ScenarioError: If it belongs to no student; the message describes it.
    """
    name, mode = path.name, path.lstat().st_mode
    if name.startswith(".") or name == "__MACOSX":
        raise ScenarioError("belongs to the course system")
    if systems := _system_name(path):
        full = _full_name(systems["student"])
        called = dict(people) if isinstance(people, Mapping) else {}
        named = [
            each for each, name in called.items() if _full_name(name).casefold() == full.casefold()
        ]
        return named[0] if len(named) == 1 and full not in people else full
    if stat.S_ISDIR(mode):
        return _in_class(path, people)
    nobodys = name.casefold() in {about.file.casefold(), RIG_FILE}
    if nobodys and _name(path.stem) not in people and stat.S_ISREG(mode):
        raise ScenarioError("names no student: folders and files must have the student's name")
    alike = path.suffix.casefold() == Path(about.file).suffix.casefold()
    if alike or _name(path.stem) in people:
        return _name(path.stem)
    if stat.S_ISLNK(mode) or _name(name) in people:
        return _name(name)
    if path.suffix.casefold() in ARCHIVE_SUFFIXES:
        raise ScenarioError("is an archive: unpack it")
    kind = f"nor a {Path(about.file).suffix} file" if stat.S_ISREG(mode) else "nor a regular file"
    raise ScenarioError(f"is neither a folder {kind}")


def _full_name(text: str) -> str:
    """A person's name as a file name: O'Neil is O_Neil."""
    return re.sub(r"[^\w.@+-]+", "_", unicodedata.normalize("NFC", text).strip())


def _system_name(path: Path) -> re.Match[str] | None:
    """The parts of a name that Moodle or Canvas gave; None for any other name."""
    canvas = None if stat.S_ISDIR(path.lstat().st_mode) else CANVAS_NAME.fullmatch(path.name)
    return MOODLE_NAME.fullmatch(path.name) or canvas


def _number_of(path: Path) -> str:
    """The number of a student in a course system; empty if an entry's name has none."""
    systems = _system_name(path)
    return systems["number"] if systems else ""


def _in_class(folder: Path, people: Collection[str]) -> str:
    """The student of a folder: by name, or the one of the class whom a system's name contains.

    GitHub Classroom writes ``LAB-NAME``, ILIAS ``SURNAME_FIRSTNAME_NAME_4711``.
    """
    name = _name(folder.name)
    repository = any((folder / each).is_dir() for each in CLASSROOM_FOLDERS)
    login = re.fullmatch(r".+?_(.+)_\d+", name)
    found = [
        each
        for each in people
        if (repository and name.endswith(f"-{each}")) or (login and login[1].endswith(f"_{each}"))
    ]
    return name if name in people else max(found, key=len, default=name)


def _name(text: str) -> str:
    """A student's name from a course system in the form of the class's file: NFC, no blanks."""
    return re.sub(" +", "_", unicodedata.normalize("NFC", text).strip(" "))


def _submission(about: AnswerTable, student: str, paths: list[Path]) -> Submission:
    """The submission in a student's entries of the folder."""
    shown = shorten(printable(student))
    first = paths[0]
    try:
        check_name(student)
    except ScenarioError as error:
        return Submission(shown, first, first / RIG_FILE, str(error), named=False)
    links = [path for path in paths if path.is_symlink()]
    folders = [path for path in paths if path not in links and path.is_dir()]
    # Moodle has a second folder for text that a student typed into the page
    texts = [path for path in folders if "_assignsubmission_onlinetext" in path.name]
    if 0 < len(texts) < len(folders):
        folders = [path for path in folders if path not in texts]
        paths = [path for path in paths if path not in texts]
        first = paths[0]
    problem = ""
    if links:
        problem = "the entry is a link; hand in the file itself"
    elif folders and len(paths) > 1:
        names = ", ".join(shorten(printable(path.name)) for path in paths[:MAX_NAMED_FILES])
        problem = f"two submissions: {names}; keep one of them"
    if problem:
        return Submission(student, first, first / RIG_FILE, problem)
    if folders:
        answer, rig = first / about.file, first / RIG_FILE
        there = is_there(answer)
        return Submission(student, answer, rig, "" if there else missing(about, answer))
    return _of_files(about, student, paths)


def _of_files(about: AnswerTable, student: str, paths: list[Path]) -> Submission:
    """The submission in a student's files that are among those of others."""
    newest: dict[str, tuple[int, Path]] = {}
    for path in paths:
        systems = MOODLE_NAME.fullmatch(path.name) or CANVAS_NAME.fullmatch(path.name)
        own = systems["file"] if systems else path.name
        if not systems and path.suffix.casefold() == Path(about.file).suffix.casefold():
            own = about.file  # under the student's own name
        again = REPEATED_NAME.fullmatch(own)
        number = 0
        if again and again["stem"] + again["suffix"] in {about.file, RIG_FILE}:
            own, number = again["stem"] + again["suffix"], int(again["number"])
        if own in newest and newest[own][0] == number:
            names = ", ".join(shorten(printable(each.name)) for each in (newest[own][1], path))
            problem = f"two submissions: {names}; keep one of them"
            return Submission(student, path, path / RIG_FILE, problem)
        newest[own] = max(newest.get(own, (number, path)), (number, path))
    nowhere = paths[0] / RIG_FILE
    rig = newest[RIG_FILE][1] if RIG_FILE in newest else nowhere
    if about.file in newest:
        return Submission(student, newest[about.file][1], rig, apart=False)
    names = ", ".join(shorten(printable(path.name)) for path in paths[:MAX_NAMED_FILES])
    unpack = ": unpack it" if paths[0].suffix.casefold() in ARCHIVE_SUFFIXES else ""
    return Submission(student, paths[0], rig, f"no {about.file}; there is {names}{unpack}")
