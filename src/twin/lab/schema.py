"""What a lab's files may say, checked: what is asked, what is dealt, and what is judged."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from pathlib import Path
from runpy import run_path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from twin.errors import ScenarioError, nearest, shortened
from twin.run.files import METRICS
from twin.shipped import shipped_labs
from twin.study.family import Family
from twin.study.family import read as read_family
from twin.validation import Checked, check_named_once, read_model, read_tables

SCHEMA = "ballplate/lab/v1"
Kind = Literal["law", "observer", "function", "numbers", "parameters"]
DATA = ("numbers", "parameters")
"""Kinds that are no code."""
NUMBERS = ("numbers", "function")
"""Kinds that give numbers by name."""
Visible = Literal["visible", "hidden", "after_published"]
NAMED = "[a-z0-9_-]+"
"""What a lab may be called."""
MOST = 256
"""Runs of a check."""
PRIVATE = ("solution.*", "mutants", "hidden.toml", "truth.py", "notes.md")
"""What of a lab's folder no student is handed."""


class AnswerTable(Checked):
    """What is handed in.

    Attributes:
        kind: A class of a law or of an observer; a function; numbers or parameters as data.
        file: What it is called.
        seconds: Time in s that its process may compute or sleep in one check.
        function: What a function is called.
        asked: Of numbers, in a file or given by a function: name to unit.
        keys: Of parameters: dotted keys of a scenario that may be set, or what they begin with.
    """

    kind: Kind
    file: str = Field(
        default_factory=lambda said: f"answer.{'toml' if said.get('kind') in DATA else 'py'}"
    )
    seconds: Annotated[float, Field(gt=0, le=3600)] = 20.0
    function: str = ""
    asked: Mapping[str, str] = Field({})
    keys: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _whole(self) -> AnswerTable:
        belongs = {"asked": NUMBERS, "keys": ("parameters",), "function": ("function",)}
        for key, kinds in belongs.items():
            if bool(getattr(self, key)) != (self.kind in kinds):
                kind = " or ".join(kinds)
                raise ValueError(f"{key}: belongs to an answer of kind {kind}, and that needs it")
        if not self.file.endswith(".toml" if self.data else ".py"):
            raise ValueError("file: must be .toml for numbers and parameters, else .py")
        return self

    @property
    def data(self) -> bool:
        """Whether it is data, never code."""
        return self.kind in DATA


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
    rigs: Annotated[int, Field(ge=1, le=MOST)] = 1
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
        if self.metric and self.metric not in METRICS:
            raise ValueError(f"metric: no '{self.metric}'{nearest(self.metric, METRICS)}")
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
        if self.rigs * max(1, len(self.seeds)) > MOST:
            raise ValueError(f"rigs, seeds: at most {MOST} runs")
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
    name: Annotated[str, Field(pattern=f"^{NAMED}$")]
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
            if bool(each.number) != (answer.kind in NUMBERS) or (
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
        raise ScenarioError(f"{called}: cannot be read: {error}") from None


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
        raise ScenarioError(f"lab '{shortened(str(name))}': {what}")
    said = read_tables(file, f"{place.name}/lab.toml").get("schema")
    if said != SCHEMA:
        raise ScenarioError(
            f"{place.name}/lab.toml: schema: must be '{SCHEMA}', got {shortened(repr(said))}; "
            "a newer one needs a newer ballplate"
        )
    more = read_model(HiddenFile, hidden).check if hidden.is_file() else ()
    return read_model(Lab, file, called=str(name), folder=place.resolve(), hidden=more)


def trusted(file: Path, function: str) -> Callable[..., Any]:
    """A function of a lecturer's own file.

    Raises:
        ScenarioError: If there is none.
    """
    call: Callable[..., Any] | None = run_path(str(file)).get(function)
    if not callable(call):
        raise ScenarioError(f"{file.name}: must define a function {function}")
    return call
