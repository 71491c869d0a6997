"""A lab's files, checked: what is asked, dealt and judged; and the rig of every student."""

from __future__ import annotations

import csv
import hashlib
import hmac
import io
import json
import re
import unicodedata
from collections.abc import Callable, Mapping
from functools import cached_property, lru_cache
from pathlib import Path
from runpy import run_path
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import BeforeValidator, Field, model_validator

from controllers.arrays import Array
from controllers.catalog import EXECUTES
from twin.base.errors import ScenarioError, nearest, printable, shorten
from twin.base.foreign import decode_text
from twin.base.shipped import shipped_labs
from twin.base.validation import Checked, check_named_once, read_model, read_tables
from twin.base.writing import why, write_folder, write_whole
from twin.run.files import MOTION_INDICATORS, export
from twin.run.finished import run
from twin.scenario import Scenario
from twin.study.schema import Family, Point, draw_rigs, read_family
from twin.study.work import Builder

LAB_SCHEMA = "ballplate/lab/v1"
Kind = Literal["law", "observer", "function", "numbers", "parameters"]
DATA_KINDS = ("numbers", "parameters")
"""Kinds that are no code."""
NUMBER_KINDS = ("numbers", "function")
"""Kinds that give numbers by name."""
Visible = Literal["visible", "hidden", "after_published"]
LAB_NAME_PATTERN = "[a-z0-9_-]+"
"""What a lab may be called."""
MAX_CHECK_RUNS = 256
"""Runs of a check."""
PRIVATE_FILES = ("solution.*", "mutants", "hidden.toml", "truth.py", "notes.md", "*key.txt")
"""What of a lab's folder no student is handed."""
MAX_NAME_BYTES = 200
"""Length of a student's name in UTF-8; the files of a result have it and some letters more."""


class AnswerTable(Checked):
    """What is handed in.

    Attributes:
        kind: A class of a law or of an observer; a function; numbers or parameters as data.
        file: What it is called.
        seconds: Time in s that its process may compute or sleep in one check.
        function: What a function is called.
        asked: Of numbers, in a file or given by a function: name to unit.
        keys: Of parameters: dotted keys of a scenario that may be set, or what they begin with.
        command: Of a law or observer in another language: the program and its arguments.
    """

    kind: Kind
    file: str = Field(
        default_factory=lambda said: f"answer.{'toml' if said.get('kind') in DATA_KINDS else 'py'}"
    )
    seconds: Annotated[float, Field(gt=0, le=3600)] = 20.0
    function: str = ""
    asked: Mapping[str, str] = Field({})
    keys: tuple[str, ...] = ()
    command: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _whole(self) -> AnswerTable:
        belongs = {"asked": NUMBER_KINDS, "keys": ("parameters",), "function": ("function",)}
        for key, kinds in belongs.items():
            if bool(getattr(self, key)) != (self.kind in kinds):
                kind = " or ".join(kinds)
                raise ValueError(f"{key}: belongs to an answer of kind {kind}, and that needs it")
        if self.command and self.kind not in ("law", "observer"):
            raise ValueError("command: belongs to an answer of kind law or observer")
        if not (self.command or self.file.endswith(".toml" if self.data else ".py")):
            raise ValueError("file: must be .toml for numbers and parameters, else .py")
        return self

    @property
    def data(self) -> bool:
        """Whether it is data, never code."""
        return self.kind in DATA_KINDS


class VariantTable(Checked):
    """What every student has of their own.

    Attributes:
        family: Name or file of the family of rigs.
        keys: Which of its keys are dealt; the others stay as the scenario has them.
        told: Which of those the sheet tells; the others are drawn from the course's key alone.
        log: Scenario of which a log is made on the student's rig, or ``FILE.py:FUNCTION`` that
            writes one, given the rig and a folder.
        set: Overrides ``key=value`` of that log.
    """

    family: str
    keys: Annotated[tuple[str, ...], Field(min_length=1)]
    told: tuple[str, ...] = ()
    log: str = ""
    set: tuple[str, ...] = ()


def as_list(given: Any) -> Any:
    """A list of texts that may be given as one text."""
    return (given,) if isinstance(given, str) else given


class CheckTable(Checked):
    """One thing that is judged, as a number on a ramp from ``none`` to ``full``.

    Attributes:
        name: What it is called.
        points: At most.
        full: The number from which on there are all points.
        none: The number from which on there are none; above or below ``full``.
        scenario: Name or file of what is run, has the key that is the truth, or of which a
            function is given a log.
        set: Overrides ``key=value`` of it.
        nominal: Whether it is run as it is, instead of on the student's rig.
        family: Family of rigs on which it is run instead.
        rigs: How many of them.
        draw: Number of the draw.
        seeds: Of the noise, every rig with each; that of the rig if there are none.
        metric: Indicator of a run, on the true ball; without one the outcome is judged.
        limit: What it may be at most; judged is then the share of runs that keep to it.
        given: What a function is given besides, by name.
        against: Overrides of the same run that the metric is divided by.
        number: Name of an answer in numbers, of which the worst of all runs counts.
        truth: What it should be: a value, a key of the scenario, or ``truth.py:FUNCTION``.
        judge: Whether the distance of its interval from the truth is judged, that of the end which
            is farther off (``error``), or the width.
        relative: Whether in percent of the truth.
        after: Checks without which this one cannot be judged: skipped where one got no points.
        why: What is wrong with an answer that fails.
        look: What to look at.
        visible: To whom it is shown.
    """

    name: Annotated[str, Field(min_length=1)]
    points: Annotated[float, Field(gt=0, le=1000)]
    full: float = 1.0
    none: float = 0.0
    scenario: str = ""
    set: tuple[str, ...] = ()
    nominal: bool = False
    family: str = ""
    rigs: Annotated[int, Field(ge=1, le=MAX_CHECK_RUNS)] = 1
    draw: Annotated[int, Field(ge=0)] = 0
    seeds: tuple[Annotated[int, Field(ge=0)], ...] = ()
    metric: str = ""
    limit: float | None = None
    against: tuple[str, ...] = ()
    given: Mapping[str, Any] = Field({})
    number: str = ""
    truth: float | str | None = None
    judge: Literal["distance", "error", "width"] = "distance"
    relative: bool = False
    after: Annotated[tuple[str, ...], BeforeValidator(as_list)] = ()
    why: str = ""
    look: str = ""
    visible: Visible = "visible"

    @model_validator(mode="after")
    def _one_judge(self) -> CheckTable:
        if self.metric and self.metric not in MOTION_INDICATORS:
            raise ValueError(f"metric: no '{self.metric}'{nearest(self.metric, MOTION_INDICATORS)}")
        if self.full == self.none:
            raise ValueError("full, none: must differ; points go along the line between them")
        if not self.metric and (self.limit is not None or self.against):
            raise ValueError("metric: missing; limit and against are about one")
        if self.metric and self.number:
            raise ValueError("metric, number: give one of them")
        if self.number and self.truth is None and self.judge != "width":
            raise ValueError("truth: missing; it says what the number should be")
        if (self.metric or self.number) and not {"full", "none"} <= self.model_fields_set:
            raise ValueError("full, none: both must be given")
        if not self.number and not self.scenario:
            raise ValueError("scenario: missing; it says what is run")
        if self.rigs * max(1, len(self.seeds)) > MAX_CHECK_RUNS:
            raise ValueError(f"rigs, seeds: at most {MAX_CHECK_RUNS} runs")
        if self.nominal and self.family:
            raise ValueError("nominal, family: give one of them")
        return self

    def earned(self, value: float) -> float:
        """Points for a judged number."""
        share = (value - self.none) / (self.full - self.none)
        return round(self.points * min(max(share, 0.0), 1.0), 2) if share == share else 0.0  # noqa: PLR0124


class HiddenCheck(CheckTable):
    """A check that only the lecturer has: hidden unless it says otherwise."""

    visible: Visible = "hidden"


class HiddenFile(Checked):
    """The tables of ``hidden.toml``."""

    check: tuple[HiddenCheck, ...]


class Lab(Checked):
    """A lab: the tables of ``lab.toml``, where it lies, and what only the lecturer has.

    Attributes:
        check: What is judged, and students may read.
        called: The name or folder by which it was asked for.
        folder: Where it lies.
        hidden: The checks of ``hidden.toml``.
    """

    schema_: Annotated[str, Field(alias="schema")]
    name: Annotated[str, Field(pattern=f"^{LAB_NAME_PATTERN}$")]
    version: Annotated[int, Field(ge=1)]
    title: str
    minutes: Annotated[int, Field(ge=1)] = 90
    textbooks: tuple[str, ...] = ()
    answer: AnswerTable
    variant: VariantTable | None = None
    check: Annotated[tuple[CheckTable, ...], Field(min_length=1)]
    called: str
    folder: Path
    hidden: tuple[HiddenCheck, ...]

    @model_validator(mode="after")
    def _whole(self) -> Lab:
        """Checks have names of their own, follow each other and fit the answer."""
        answer, names, _ = self.answer, list[str](), self.family
        for each in self.checks(hidden=True):
            for other in each.after:
                if other not in names:
                    raise ValueError(f"check '{each.name}': after: no check before it is '{other}'")
            names.append(each.name)
            if bool(each.number) != (answer.kind in NUMBER_KINDS) or (
                each.given and answer.kind != "function"
            ):
                what = f"does not judge an answer of kind {answer.kind}"
                raise ValueError(f"check '{each.name}': {what}")
            if each.number and each.number not in answer.asked:
                where = nearest(each.number, answer.asked)
                raise ValueError(f"check '{each.name}': number: no '{each.number}'{where}")
        check_named_once("check", names)
        return self

    @cached_property
    def family(self) -> Family | None:
        """The family of the rigs that are dealt, with the keys that are; None: all are alike.

        Raises:
            ValueError: If there is none, or it has not the keys.
        """
        if self.variant is None:
            return None
        keys, family = self.variant.keys, read_family(self.path(self.variant.family))
        known = {"keys": family.parameters, "told": keys}
        for table, those in known.items():
            for key in getattr(self.variant, table):
                if key not in those:
                    raise ValueError(f"variant.{table}: no '{key}'{nearest(key, those)}")
        dealt = {key: family.parameters[key] for key in keys}
        return family.model_copy(update={"parameters": dealt})

    def checks(self, *, hidden: bool) -> tuple[CheckTable, ...]:
        """What is judged, with or without what only the lecturer has."""
        if hidden:
            return self.check + self.hidden
        return tuple(each for each in self.check if each.visible == "visible")

    @property
    def own_code(self) -> list[Path]:
        """Its files that have functions which judging runs."""
        named = {str(each.truth).partition(":") for each in self.checks(hidden=True)}
        files = {self.folder / file for file, _, function in named if function}
        return sorted(filter(Path.is_file, files))

    def path(self, name: str) -> str:
        """A file of this lab's folder by its path; any other name, as of what is shipped, as is."""
        own = self.folder / name
        return str(own) if name and own.is_file() else name

    def text(self, name: str) -> str:
        """The text of a file of this lab's folder.

        Raises:
            ScenarioError: If it cannot be read.
        """
        return text_of(self.folder / name, f"{self.folder.name}/{name}")


def text_of(file: Path, called: str) -> str:
    """The text of a file.

    Args:
        file: The file.
        called: What a message calls it.

    Raises:
        ScenarioError: If it cannot be read.
    """
    try:
        return file.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ScenarioError(f"{called}: cannot be read: {why(error)}") from None


def read(name: str | Path) -> Lab:
    """The lab of a shipped name or a folder.

    Raises:
        ScenarioError: If there is none, or anything in its files is unknown or out of range.
    """
    known = shipped_labs()
    place = known.get(str(name)) or Path(name)
    file, hidden = place / "lab.toml", place / "hidden.toml"
    if not file.is_file():
        what = "has no lab.toml" if place.is_dir() else "not found" + nearest(str(name), known)
        raise ScenarioError(f"lab '{shorten(str(name))}': {what}")
    said = read_tables(file, f"{place.name}/lab.toml").get("schema")
    if said != LAB_SCHEMA:
        raise ScenarioError(
            f"{place.name}/lab.toml: schema: must be '{LAB_SCHEMA}', got {shorten(repr(said))}; "
            "a newer one needs a newer ballplate"
        )
    more = read_model(HiddenFile, hidden).check if hidden.is_file() else ()
    return read_model(Lab, file, called=str(name), folder=place.resolve(), hidden=more)


RUNS = "runs %s of the lab"
"""What is told before a lab's own file is run."""


def load_function(file: Path, function: str) -> Callable[..., Any]:
    """A function of a lecturer's own file.

    Raises:
        ScenarioError: If there is none.
    """
    EXECUTES.info(RUNS, file)
    call: Callable[..., Any] | None = run_path(str(file)).get(function)
    if not callable(call):
        raise ScenarioError(f"{file.name}: must define a function {function}")
    return call


RIG_FILE = "rig.toml"
"""What a student is handed of their rig."""
LOG_FILE = "log.csv"
"""The log that is made on it."""
PRACTICE_KEY = "practice"
"""The key of a course that has none."""
_FILLED_LINE_PATTERN = re.compile(
    r"^(\s*\w+[^=#]*=\s*)([^#]*?)(\s*# told: )(\S+)[ \t]*$", re.MULTILINE
)
"""A line ``NAME = 0.18  # told: KEY`` of an answer."""


class HandedRig(Checked):
    """The file ``rig.toml`` that a student is handed."""

    lab: str
    version: int
    student: str
    code: str
    practice: bool
    told: Mapping[str, float | str] = Field({})


class Deal(NamedTuple):
    """The rig of one student.

    Attributes:
        student: Whose.
        code: What tells it from others; printed on the sheet.
        point: What it is: dotted key to value.
        told: What of that the student knows.
        seed: Of its noise.
        true: Whether what is hidden is as the course has it, not a value to practise on.
    """

    student: str
    code: str
    point: Point
    told: Point
    seed: int
    true: bool = True


def deal(lab: Lab, student: str, key: str | None = None, code: str | None = None) -> Deal:
    """The rig of a student.

    HMAC-SHA256 of the course's key over lab, version and student, once for what is told and once
    for what is hidden. Who lacks the key but has the code has the first, and, of what is hidden,
    values to practise on.

    Args:
        lab: The lab.
        student: Their name or number.
        key: The course's.
        code: That of the student's sheet, for who lacks the key.
    """
    name = f"{lab.name} {lab.version} {student}"
    secret = (PRACTICE_KEY if key is None else key).encode()
    digests = [
        hmac.new(secret, f"{name} {part}".encode(), hashlib.sha256).hexdigest()[:16]
        for part in ("told", "hidden")
    ]
    if key is None and code is not None:
        digests = [code, hashlib.sha256(code.encode()).hexdigest()[:16]]
    own, hidden = digests
    if lab.family is None or lab.variant is None:
        return Deal(student, own, {}, {}, int(hidden, 16) % 2**31)
    open_, closed = (draw_rigs(lab.family, int(each, 16), 1)[0] for each in digests)
    told = {key: open_.point[key] for key in lab.variant.told}
    return Deal(student, own, closed.point | told, told, closed.seed)


def reload_deal(lab: Lab, folder: Path, key: str | None, student: str | None = None) -> Deal:
    """The rig that a folder's answer is for: by its ``rig.toml``, or by the student's name.

    Raises:
        ScenarioError: If the file is of another lab, version, student or key.
    """
    try:
        (folder / RIG_FILE).lstat()
    except OSError:
        return deal(lab, student or "nobody", key)
    said = read_model(HandedRig, folder / RIG_FILE, regular=True)
    wanted = {"lab": lab.name, "version": lab.version, "student": student or said.student}
    for what, must in wanted.items():
        if (has := getattr(said, what)) != must:
            raise ScenarioError(f"{RIG_FILE}: {what}: is {has!r}, must be {must!r}")
    found = deal(
        lab, said.student, PRACTICE_KEY if said.practice and key is None else key, said.code
    )
    if found.code != said.code:
        raise ScenarioError(
            f"{RIG_FILE}: code: the course's key deals {said.student} another rig; "
            "is it the key of this course?"
        )
    return found._replace(true=said.practice or key is not None)


def students(path: Path) -> list[str]:
    """The students of a class: the first column of a CSV file below its heading.

    Spreadsheets write it with commas, semicolons or tabs, in UTF-8, UTF-16 or as Windows has it.

    Raises:
        ScenarioError: If it cannot be read, names nobody, or somebody twice.
    """
    try:
        text = decode_text(path.read_bytes())
        between = max(",;\t", key=text.partition("\n")[0].count)
        table = csv.reader(io.StringIO(text, newline=""), delimiter=between)
        cells = [row[0].strip() for row in table if row and row[0].strip()]
        rows = [unicodedata.normalize("NFC", cell) for cell in cells[1:]]
    except (OSError, csv.Error) as error:
        raise ScenarioError(f"{path}: cannot be read: {why(error)}") from None
    twice = next((name for name in rows if rows.count(name) > 1), None)
    if not rows or twice:
        what = f"two students are called '{twice}'" if twice else "names nobody below its heading"
        raise ScenarioError(f"{path}: {what}")
    for name in rows:
        check_name(name)
    return rows


def check_name(student: str) -> None:
    """Make sure that a student's name can be that of a folder, and of the files made for it.

    Raises:
        ScenarioError: If not.
    """
    letters = re.fullmatch(r"[\w@+-][\w.@+-]{0,99}", student)
    if not letters or len(student.encode()) > MAX_NAME_BYTES:
        raise ScenarioError(
            f"student '{shorten(printable(student))}': is called by up to 100 letters, digits "
            f"and .@+-_, {MAX_NAME_BYTES} bytes in UTF-8"
        )


def hand_out(lab: Lab, places: Mapping[str, str], key: str | None, folder: Path) -> None:
    """Write what students begin with: sheet, starter, rig, log.

    Args:
        lab: The lab.
        places: Who, and in which folder of the new one, ``.`` for itself.
        key: The course's; without one their rigs are to practise on.
        folder: Where to; must not exist.

    Raises:
        TwinError: If a file of the lab cannot be read, its log not be run, or one not be written.
    """
    answer = lab.answer.file
    sheet, begun = lab.text("task.md").rstrip(), lab.text(answer)

    def fill(inner: Path) -> None:
        for student, place in places.items():
            dealt, own = deal(lab, student, key), inner / place
            rig = {"lab": lab.name, "version": lab.version, "student": student}
            rig |= {"code": dealt.code, "practice": key is None}
            told = toml({json.dumps(each): value for each, value in dealt.told.items()})
            write_whole(own / RIG_FILE, f"{toml(rig)}[told]\n{told}")
            told = "".join(f"- `{each}` = {value}\n" for each, value in dealt.told.items())
            about = f"## Your rig\n\n{student}, code {dealt.code}\n\n{told}"
            write_whole(own / "task.md", f"{sheet}\n\n{about}")
            write_whole(own / answer, fill_answer(begun, dealt.told))
            record(lab, dealt, own / LOG_FILE)

    for student in places:
        check_name(student)
    write_folder(folder, fill)


def toml(values: Mapping[str, Any]) -> str:
    """Numbers, texts and lists of them by key, dotted or not, as TOML."""
    return "".join(f"{key} = {json.dumps(value)}\n" for key, value in values.items())


def starter(solution: str) -> str:
    """What a student begins with, out of a solution.

    Lines between ``# BEGIN SOLUTION`` and ``# END SOLUTION`` go; of those between
    ``# BEGIN STARTER`` and ``# END STARTER`` the comment signs do.
    """
    given = re.sub(MARKED_LINES_PATTERN.format("SOLUTION"), "", solution)
    sign = r"(?m)^( *)# ?"
    return re.sub(
        MARKED_LINES_PATTERN.format("STARTER"), lambda found: re.sub(sign, r"\1", found[1]), given
    )


MARKED_LINES_PATTERN = r"(?ms)^ *# BEGIN {0}$\n(.*?)^ *# END {0}$\n"
"""Lines between two marks."""


def fill_answer(text: str, told: Mapping[str, Any]) -> str:
    """An answer's text with what the student's sheet tells in its lines marked ``# told: KEY``."""

    def line(found: re.Match[str]) -> str:
        begin, _, mark, key = found.groups()
        return f"{begin}{told[key]!r}{mark}{key}" if key in told else found.group()

    return _FILLED_LINE_PATTERN.sub(line, text)


def record(lab: Lab, dealt: Deal, path: Path) -> None:
    """Write the log of a student's rig, where there is to be one: all but the truth.

    Raises:
        TwinError: If its scenario cannot be run.
    """
    variant = lab.variant
    file, _, function = (variant.log if variant else "").partition(":")
    if function:
        load_function(lab.folder / file, function)(dealt.point, path.parent)
    elif variant is not None and file and lab.family is not None:
        fixed = (*variant.set, f"seed={dealt.seed}")
        relative = [key for key, each in lab.family.parameters.items() if each.relative]
        scenario = Builder(lab.path(variant.log))(fixed, dealt.point, relative)
        export(path, *measured_columns(scenario.model_dump_json()))


@lru_cache(maxsize=4)
def measured_columns(scenario: str) -> tuple[dict[str, Array], Mapping[str, str]]:
    """What a rig's own computer sees of a run, before any observer: columns by name, units.

    Args:
        scenario: What is run, in JSON.
    """
    done = run(Scenario.model_validate_json(scenario))
    rows = {
        name: values for name, values in done.rows.items() if name.startswith(SEEN_COLUMN_PREFIXES)
    }
    return rows, done.units


SEEN_COLUMN_PREFIXES = ("time", "measured_", "requested_", "applied_", "age", "touched")
"""Beginnings of the columns that a rig's own computer has, before any observer."""
