"""A lab's files, checked: answer, checks and variants; and the rig of every student."""

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
from controllers.catalog import EXECUTION_LOG
from twin.base.errors import ScenarioError, nearest, printable, shorten
from twin.base.foreign import decode_text
from twin.base.shipped import shipped_labs
from twin.base.validation import Checked, check_named_once, read_model, read_tables
from twin.base.writing import why, write_folder, write_whole
from twin.lab.words import words
from twin.run.exporters import export
from twin.run.finished import run
from twin.run.indicators import MOTION_INDICATORS, nearest_indicator
from twin.scenario import Scenario
from twin.study.schema import Family, Point, draw_rigs, read_family
from twin.study.work import Builder

LAB_SCHEMA = "ballplate/lab/v1"
Language = Literal["en", "de"]
"""Languages of results and pages; equal to those of ``words.toml``."""
Kind = Literal["law", "observer", "function", "numbers", "parameters"]
DATA_KINDS = ("numbers", "parameters")
"""Kinds that are no code."""
NUMBER_KINDS = ("numbers", "function")
"""Kinds of answer with numbers by name as result."""
Visible = Literal["visible", "hidden", "after_published"]
LAB_NAME_PATTERN = "[a-z0-9][a-z0-9_-]*"
"""Pattern of a lab's name."""
MAX_CHECK_RUNS = 256
"""Largest number of runs of a check."""
PRIVATE_FILES = ("solution.*", "mutants", "hidden.toml", "truth.py", "notes.md", "*key.txt")
"""Files of a lab's folder that no student receives."""
MAX_NAME_BYTES = 200
"""Length of a student's name in UTF-8; the files of a result have it and a few more letters."""


class AnswerTable(Checked):
    """The answer that students hand in.

    Attributes:
        kind: A class of a law or of an observer; a function; numbers or parameters as data.
        file: Name of its file.
        seconds: Time in s that its process may compute or sleep in one check.
        function: Name of a function.
        asked: For numbers, in a file or from a function: name to unit.
        keys: For parameters: dotted keys of a scenario that may be set, or their beginnings.
        command: For a law or observer that is not in Python: the program and its arguments.
    """

    kind: Kind
    file: str = Field(
        default_factory=lambda keys: f"answer.{'toml' if keys.get('kind') in DATA_KINDS else 'py'}"
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
    """The rig and the log of every student.

    Attributes:
        family: Name or file of the family of rigs.
        keys: Keys of it that are dealt; the others keep the scenario's values.
        told: Dealt keys with values on the sheet; the others are drawn from the course's key alone.
        log: Scenario whose log is made on the student's rig, or ``FILE.py:FUNCTION`` that writes
            one for a rig into a folder.
        set: Overrides ``key=value`` of that log.
    """

    family: str
    keys: Annotated[tuple[str, ...], Field(min_length=1)]
    told: tuple[str, ...] = ()
    log: str = ""
    set: tuple[str, ...] = ()


def as_list(given: Any) -> Any:
    """A list of texts, which may be one text."""
    return (given,) if isinstance(given, str) else given


class CheckTexts(Checked):
    """The texts of a check in a further language.

    Attributes:
        name: Its name.
        why: The usual mistake of an answer that fails.
        look: A hint where to look.
    """

    name: Annotated[str, Field(min_length=1)]
    why: str = ""
    look: str = ""


class LabTexts(Checked):
    """The texts of a lab in a further language.

    Attributes:
        title: Its title.
    """

    title: str


class CheckTable(Checked):
    """A check: a number on a ramp from ``none`` to ``full``.

    Attributes:
        name: Its name.
        points: Largest number of points.
        full: The number at which it gives all points.
        none: The number at which it gives none; above or below ``full``.
        scenario: Name or file of the scenario that is run, has the key of the truth, or gives the
            log of a function.
        set: Overrides ``key=value`` of it.
        nominal: Whether it is run unchanged, instead of on the student's rig.
        family: Family of rigs on which it is run instead.
        rigs: Number of these rigs.
        draw: Number of the draw.
        seeds: Seeds of the noise, each on every rig; the rig's own seed if there are none.
        metric: Indicator of a run, from the true ball; without one the outcome counts.
        limit: Largest value of the metric; the share of runs within it counts then.
        given: Further arguments of a function, by name.
        against: Overrides of a second run; the metric is divided by the metric of that run.
        number: Name of an answer in numbers; the worst of all runs counts.
        truth: Its true value: a value, a key of the scenario, or ``truth.py:FUNCTION``.
        judge: Whether the distance of its interval from the truth counts, the distance of the
            farther end (``error``), or the width.
        relative: Whether in percent of the truth.
        after: Checks without which this one cannot be graded: skipped where one got no points.
        why: The usual mistake of an answer that fails.
        look: A hint where to look.
        visible: To whom it is shown.
        texts: Name, why and look in other languages.
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
    texts: Mapping[Language, CheckTexts] = Field({})

    def texts_in(self, language: Language) -> CheckTexts:
        """Name, why and look in a language; its own texts if they are not translated."""
        own = CheckTexts(name=self.name, why=self.why, look=self.look)
        return self.texts.get(language, own)

    @model_validator(mode="after")
    def _one_judge(self) -> CheckTable:
        if self.metric and self.metric not in MOTION_INDICATORS:
            raise ValueError(f"metric: no '{self.metric}'{nearest_indicator(self.metric)}")
        if self.full == self.none:
            raise ValueError("full, none: must differ; points go along the line between them")
        if not self.metric and (self.limit is not None or self.against):
            raise ValueError("metric: missing; limit and against need it")
        if self.metric and self.number:
            raise ValueError("metric, number: give one of them")
        if self.number and self.truth is None and self.judge != "width":
            raise ValueError("truth: missing; it is the true value of the number")
        if (self.metric or self.number) and not {"full", "none"} <= self.model_fields_set:
            raise ValueError("full, none: both must be given")
        if not self.number and not self.scenario:
            raise ValueError("scenario: missing; it names the scenario to run")
        if self.rigs * max(1, len(self.seeds)) > MAX_CHECK_RUNS:
            raise ValueError(f"rigs, seeds: at most {MAX_CHECK_RUNS} runs")
        if self.nominal and self.family:
            raise ValueError("nominal, family: give one of them")
        return self

    def earned(self, value: float) -> float:
        """Points for the number of a check."""
        share = (value - self.none) / (self.full - self.none)
        return round(self.points * min(max(share, 0.0), 1.0), 2) if share == share else 0.0  # noqa: PLR0124


class HiddenCheck(CheckTable):
    """A check that only the lecturer has: hidden by default."""

    visible: Visible = "hidden"


class HiddenFile(Checked):
    """The tables of ``hidden.toml``."""

    check: tuple[HiddenCheck, ...]


class Lab(Checked):
    """A lab: the tables of ``lab.toml``, its folder, and the hidden checks.

    Attributes:
        language: Language of sheets, results and pages.
        texts: Its title in other languages.
        check: Checks that students may read.
        called: The name or folder by which it was requested.
        folder: Its folder.
        hidden: The checks of ``hidden.toml``.
    """

    schema_: Annotated[str, Field(alias="schema")]
    name: Annotated[str, Field(pattern=f"^{LAB_NAME_PATTERN}$")]
    version: Annotated[int, Field(ge=1)]
    title: str
    language: Language = "en"
    texts: Mapping[Language, LabTexts] = Field({})
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
        """The family of the rigs that are dealt, with the dealt keys; None if all are alike.

        Raises:
            ValueError: If there is none, or it lacks the keys.
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
        """The checks, with or without those that only the lecturer has."""
        if hidden:
            return self.check + self.hidden
        return tuple(each for each in self.check if each.visible == "visible")

    @property
    def own_code(self) -> list[Path]:
        """Its files with functions that are called while an answer is graded."""
        named = {str(each.truth).partition(":") for each in self.checks(hidden=True)}
        files = {self.folder / file for file, _, function in named if function}
        return sorted(filter(Path.is_file, files))

    @property
    def shown_title(self) -> str:
        """Its title in its language."""
        return self.texts[self.language].title if self.language in self.texts else self.title

    @property
    def sheet(self) -> str:
        """The text of its sheet: of ``task.LANGUAGE.md``, or of ``task.md`` if there is none.

        Raises:
            ScenarioError: If it cannot be read.
        """
        own = f"task.{self.language}.md"
        return self.text(own if (self.folder / own).is_file() else "task.md")

    def path(self, name: str) -> str:
        """The path of a file of this lab's folder; any other name unchanged, as a shipped one."""
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
        called: Its name in a message.

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
    schema = read_tables(file, f"{place.name}/lab.toml").get("schema")
    if schema != LAB_SCHEMA:
        raise ScenarioError(
            f"{place.name}/lab.toml: schema: must be '{LAB_SCHEMA}', got {shorten(repr(schema))}; "
            "a newer one needs a newer ballplate"
        )
    more = read_model(HiddenFile, hidden).check if hidden.is_file() else ()
    return read_model(Lab, file, called=str(name), folder=place.resolve(), hidden=more)


RUNS_MESSAGE = "runs %s of the lab"
"""Log message before a lab's own file is run."""


def load_function(file: Path, function: str) -> Callable[..., Any]:
    """A function of a lecturer's own file.

    Raises:
        ScenarioError: If there is none.
    """
    EXECUTION_LOG.info(RUNS_MESSAGE, file)
    call: Callable[..., Any] | None = run_path(str(file)).get(function)
    if not callable(call):
        raise ScenarioError(f"{file.name}: must define a function {function}")
    return call


RIG_FILE = "rig.toml"
"""File of a student's rig."""
LOG_FILE = "log.csv"
"""File of the log of that rig."""
PRACTICE_KEY = "practice"
"""Key of a course without one."""
_FILLED_LINE_PATTERN = re.compile(
    r"^(\s*\w+[^=#]*=\s*)([^#]*?)(\s*# told: )(\S+)[ \t]*$", re.MULTILINE
)
"""A line ``NAME = 0.18  # told: KEY`` of an answer."""


class HandedRig(Checked):
    """The file ``rig.toml`` that a student receives."""

    lab: str
    version: int
    student: str
    code: str
    practice: bool
    told: Mapping[str, float | str] = Field({})


class Deal(NamedTuple):
    """The rig of one student.

    Attributes:
        student: The student.
        code: Its code, unique in the course; printed on the sheet.
        point: Its values: dotted key to value.
        known: The values that the student knows.
        seed: Seed of its noise.
        true: Whether the hidden values are those of the course, not values for practice.
    """

    student: str
    code: str
    point: Point
    known: Point
    seed: int
    true: bool = True


def deal(lab: Lab, student: str, key: str | None = None, code: str | None = None) -> Deal:
    """The rig of a student.

    HMAC-SHA256 of the course's key over lab, version and student, once for the known values and
    once for the hidden ones. The code without the key gives the known values, and hidden values for
    practice.

    Args:
        lab: The lab.
        student: Their name or number.
        key: The key of the course.
        code: The code of the student's sheet, used without the key.
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
    known = {key: open_.point[key] for key in lab.variant.told}
    return Deal(student, own, closed.point | known, known, closed.seed)


def reload_deal(lab: Lab, folder: Path, key: str | None, student: str | None = None) -> Deal:
    """The rig of a folder's answer: by its ``rig.toml``, or by the student's name.

    The rig of ``lab start``, to practise on, has the name that the student typed: any will do as
    long as there is no key. With one, it is passed over where a lab hands out neither values nor a
    log of a rig, as the answer then cannot depend on it.

    Raises:
        ScenarioError: If the file has a different lab, version, student or key, or is of a rig to
            practise on where the course's own is needed.
    """
    try:
        (folder / RIG_FILE).lstat()
    except OSError:
        return deal(lab, student or "nobody", key)
    handed = read_model(HandedRig, folder / RIG_FILE, regular=True)
    for what, must in {"lab": lab.name, "version": lab.version}.items():
        if (has := getattr(handed, what)) != must:
            raise ScenarioError(f"{RIG_FILE}: {what}: is {has!r}, must be {must!r}")
    if handed.practice and key is not None:
        if lab.variant is not None and (lab.variant.told or lab.variant.log):
            raise ScenarioError(
                f"{RIG_FILE}: practice: is of the rig that `lab start` makes to practise on; the "
                "answer must be made for the rig that the course hands out"
            )
        return deal(lab, student or handed.student, key)
    if student and handed.student != student and not handed.practice:
        raise ScenarioError(
            f"{RIG_FILE}: student: is {handed.student!r}, must be {student!r}; if they are one, "
            f"the class (--class) must have the name of {handed.student} in its second column"
        )
    own_key = PRACTICE_KEY if handed.practice and key is None else key
    found = deal(lab, handed.student, own_key, handed.code)
    if found.code != handed.code:
        raise ScenarioError(
            f"{RIG_FILE}: code: the course's key draws a different rig for {handed.student}; "
            "is it the key of this course?"
        )
    return found._replace(true=handed.practice or key is not None)


def students(path: Path) -> dict[str, str]:
    """The students of a class and their names, which may be empty.

    They are the first and the second column of a CSV file below its heading.

    Spreadsheets write it with commas, semicolons or tabs, in UTF-8, UTF-16 or Windows' encoding.

    Raises:
        ScenarioError: If it cannot be read, names nobody, or somebody twice.
    """
    try:
        text = decode_text(path.read_bytes())
        between = max(",;\t", key=text.partition("\n")[0].count)
        table = csv.reader(io.StringIO(text, newline=""), delimiter=between)
        cells = [[*row, ""][:2] for row in table if row and row[0].strip()][1:]
        rows = [unicodedata.normalize("NFC", cell[0].strip()) for cell in cells]
    except (OSError, csv.Error) as error:
        raise ScenarioError(f"{path}: cannot be read: {why(error)}") from None
    twice = next((name for name in rows if rows.count(name) > 1), None)
    if not rows or twice:
        what = f"two students are called '{twice}'" if twice else "names nobody below its heading"
        raise ScenarioError(f"{path}: {what}")
    for name in rows:
        check_name(name)
    return {row: printable(cell[1].strip()) for row, cell in zip(rows, cells, strict=True)}


def check_name(student: str) -> None:
    """Make sure that a student's name is valid for a folder, and for the files made for it.

    Raises:
        ScenarioError: If not.
    """
    letters = re.fullmatch(r"[\w@+-][\w.@+-]{0,99}", student)
    if not letters or len(student.encode()) > MAX_NAME_BYTES:
        raise ScenarioError(
            f"student '{shorten(printable(student))}': the name has up to 100 letters, digits "
            f"and .@+-_, {MAX_NAME_BYTES} bytes in UTF-8"
        )


def hand_out(
    lab: Lab, places: Mapping[str, str], key: str | None, folder: Path, *, notebook: bool = False
) -> None:
    """Write the files with which students begin: sheet, starter, rig, log.

    Args:
        lab: The lab.
        places: Students, and their folders within the new one, ``.`` for itself.
        key: The key of the course; without one the rigs are for practice.
        folder: The new folder; must not exist.
        notebook: Whether to write a notebook of sheet, starter and check as well.

    Raises:
        TwinError: If a file of the lab cannot be read, or one not be written, or a log not be run.
    """
    answer, say = lab.answer.file, words(lab.language)
    sheet, template = lab.sheet.rstrip(), lab.text(answer)

    def fill(inner: Path) -> None:
        for student, place in places.items():
            dealt, own = deal(lab, student, key), inner / place
            rig = {"lab": lab.name, "version": lab.version, "student": student}
            rig |= {"code": dealt.code, "practice": key is None}
            known = toml({json.dumps(each): value for each, value in dealt.known.items()})
            write_whole(own / RIG_FILE, f"{toml(rig)}[told]\n{known}")
            listed = "".join(f"- `{each}` = {value}\n" for each, value in dealt.known.items())
            heading = say("your_rig", student=student, code=dealt.code)
            text = f"{sheet}\n\n## {heading}\n\n{listed}"
            filled = fill_answer(template, dealt.known)
            write_whole(own / "task.md", text)
            write_whole(own / answer, filled)
            if notebook:
                write_notebook(lab, own, text, filled)
            record(lab, dealt, own / LOG_FILE)

    for student in places:
        check_name(student)
    write_folder(folder, fill)


def write_notebook(lab: Lab, folder: Path, sheet: str, answer: str) -> None:
    """Write a Jupyter notebook of a sheet, a starter and the check of the lab into a folder.

    Raises:
        RecordError: If it cannot be written.
    """
    from twin.base.page import render_template  # noqa: PLC0415  with jinja, for a notebook only

    template = Path(__file__).with_name("templates") / "folder" / "notebook.ipynb.j2"
    text = render_template(template, lab=lab, sheet=sheet, answer=answer)
    text = json.dumps(json.loads(text), indent=1, ensure_ascii=False) + "\n"
    write_whole(folder / f"{lab.name}.ipynb", text)


def toml(values: Mapping[str, Any]) -> str:
    """Numbers, texts and lists of them by key, dotted or not, as TOML."""
    return "".join(f"{key} = {json.dumps(value)}\n" for key, value in values.items())


def starter(solution: str) -> str:
    """The starter that is made from a solution.

    Lines between ``# BEGIN SOLUTION`` and ``# END SOLUTION`` are removed; of those between
    ``# BEGIN STARTER`` and ``# END STARTER`` the comment signs are.
    """
    given = re.sub(MARKED_LINES_PATTERN.format("SOLUTION"), "", solution)
    sign = r"(?m)^( *)# ?"
    return re.sub(
        MARKED_LINES_PATTERN.format("STARTER"), lambda found: re.sub(sign, r"\1", found[1]), given
    )


MARKED_LINES_PATTERN = r"(?ms)^ *# BEGIN {0}$\n(.*?)^ *# END {0}$\n"
"""Lines between two marks, with the word of the marks to be filled in."""


def fill_answer(text: str, known: Mapping[str, Any]) -> str:
    """An answer's text with the known values in its lines marked ``# told: KEY``."""

    def line(found: re.Match[str]) -> str:
        begin, _, mark, key = found.groups()
        return f"{begin}{known[key]!r}{mark}{key}" if key in known else found.group()

    return _FILLED_LINE_PATTERN.sub(line, text)


def record(lab: Lab, dealt: Deal, path: Path) -> None:
    """Write the log of a student's rig, if the lab has one: all columns but the truth.

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
    """Columns of a run that a rig's own computer has before any observer: by name, and units.

    Args:
        scenario: The scenario in JSON.
    """
    done = run(Scenario.model_validate_json(scenario))
    rows = {
        name: values for name, values in done.rows.items() if name.startswith(SEEN_COLUMN_PREFIXES)
    }
    return rows, done.units


SEEN_COLUMN_PREFIXES = ("time", "measured_", "requested_", "applied_", "age", "touched")
"""Beginnings of the columns that a rig's own computer has, before any observer."""
