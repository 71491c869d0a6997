"""A lab's files, checked: its answer, its checks and the rigs of its students."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from pathlib import Path
from runpy import run_path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from controllers.catalog import EXECUTION_LOG
from twin.base.data_file import read_tables
from twin.base.errors import ScenarioError, nearest, shorten
from twin.base.shipped import shipped_labs
from twin.base.validation import Checked, check_named_once, read_model
from twin.base.writing import why
from twin.run.indicators import MOTION_INDICATORS, nearest_indicator
from twin.study.schema import Family, read_family

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
