"""Judges an answer: for each check a number, its points on a ramp, and the reason."""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from twin.base.data_file import DataError, read_regular, read_tables
from twin.base.errors import (
    LawError,
    ScenarioError,
    TwinError,
    nearest,
    printable,
    shorten,
)
from twin.base.parts import own_version
from twin.base.shipped import shipped_in, shipped_scenarios
from twin.lab.deals import Deal, measured_columns
from twin.lab.handed_in import copy_files, is_there, missing
from twin.lab.process import ANSWER_NAME, AnswerProcess, OutOfTimeError, answering
from twin.lab.schema import AnswerTable, CheckTable, Lab, load_function
from twin.lab.words import words
from twin.run.finished import Run, run
from twin.run.indicators import INDICATORS
from twin.run.tables import in_json
from twin.scenario import Scenario
from twin.study.schema import FamilyRig, Point, draw_rigs, read_family
from twin.study.work import Builder, Row, ScenarioRuns, carry_out, code, digest

RESULT_SCHEMA = "ballplate/lab-result/v1"
MAX_INTERVAL_WIDTH = 2.0
"""Largest width of an interval that is scored by its distance from the truth, as a multiple of the
distance that gives no points: the middle of a wider one may have that error."""


NOT_SIMULATED = ("name", "points", "full", "none", "after", "why", "look", "visible", "texts")
"""Keys of a check that change none of its runs."""


class NotGradedError(TwinError):
    """A check that cannot be graded here, or yet: the reason."""


Ending = Literal["measured", "early", "broken", "timed out", "not graded"]
"""How the measurement of a check may end."""


class Measured(NamedTuple):
    """The result of the runs of a check, before points and texts.

    Attributes:
        value: The number that the check judges; None for none.
        runs: Number of runs; of those that ended early, where they leave no number.
        note: How runs ended early, or the error, in a line.
        ending: How the measurement ended.
        log: Lines that the answer printed.
        too_much: Size in kB of what is kept of its printed text, if it printed more; else 0.
    """

    value: float | None
    runs: int = 0
    note: str = ""
    ending: Ending = "measured"
    log: Sequence[str] = ()
    too_much: int = 0


class NotMeasuredError(Exception):
    """A result needs a measurement that is not kept."""


@dataclass
class Measurements:
    """Measurements that are kept, by what was simulated for each.

    Attributes:
        source: Hash of the code and of the lab's files that runs depend on, see ``source_of``.
        kept: Measurements by their key.
        simulates: Whether one that is not kept is simulated.
        used: Those that were needed, kept before or new.
    """

    source: str
    kept: Mapping[str, Measured] = field(default_factory=dict)
    simulates: bool = True
    used: dict[str, Measured] = field(default_factory=dict)

    def get(self, key: str, measure: Callable[[], Measured]) -> Measured:
        """The measurement of a key.

        Raises:
            NotMeasuredError: If it is not kept, and nothing may be simulated.
        """
        if key not in self.kept and not self.simulates:
            raise NotMeasuredError(key)
        self.used[key] = self.kept[key] if key in self.kept else measure()
        return self.used[key]


def source_of(lab: Lab) -> str:
    """A hash of this program and of the files of a lab that its runs may depend on."""
    total = hashlib.sha256(code().encode())
    own = {*lab.folder.rglob("*")} - {lab.folder / lab.answer.file}
    own -= {*lab.folder.glob("*.md"), *lab.folder.glob("solution.*")}
    own -= {lab.folder / "lab.toml", lab.folder / "hidden.toml"}
    shipped = set()
    for check in lab.checks(hidden=True):
        named = ((check.scenario, shipped_scenarios()), (check.family, shipped_in("families")))
        shipped |= {known[name] for name, known in named if name in known}
    for path in sorted(own | shipped):
        inner = {"mutants", "__pycache__"}.intersection(path.parts)
        if path.is_file() and not inner:
            total.update(path.name.encode() + path.read_bytes())
    return total.hexdigest()


def judge_answer(
    lab: Lab,
    dealt: Deal,
    file: Path,
    *,
    hidden: bool,
    measurements: Measurements | None = None,
) -> dict[str, Any]:
    """The result of an answer: the results of check50 with points; never an error of the answer.

    Args:
        lab: The lab.
        dealt: The rig it is for.
        file: The answer, which may be missing.
        hidden: Whether the lecturer's hidden checks count, too.
        measurements: Measurements that are kept.

    Raises:
        NotMeasuredError: If one is not kept, and nothing may be simulated.
    """
    begin, results = time.perf_counter(), list[dict[str, Any]]()
    judge = Judge(lab, dealt, file, measurements)
    for check in lab.checks(hidden=hidden):
        none = {each["name"] for each in results if not each["score"]}.intersection(check.after)
        results.append(judge.result(check, sorted(none)))
    return {
        "schema": RESULT_SCHEMA,
        "lab": lab.name,
        "version": lab.version,
        "title": lab.shown_title,
        "language": lab.language,
        "student": dealt.student,
        "code": dealt.code,
        "rig": dealt.point if hidden else dealt.known,
        "answer": digest_of(file),
        "score": round(sum(each["score"] for each in results), 2),
        "max_score": sum(each["max_score"] for each in results),
        "seconds": round(time.perf_counter() - begin, 2),
        "results": results,
        "versions": {"ballplate": own_version(), "model": code()[:16]},
    }


def digest_of(file: Path) -> str:
    """A short hash of a file's content; empty where there is none that may be opened."""
    try:
        return hashlib.sha256(read_regular(file)).hexdigest()[:16]
    except DataError:
        return ""


class Quantity(NamedTuple):
    """The quantity that a check judges.

    Attributes:
        what: The quantity in words.
        unit: Its unit as it is printed, after a blank; empty for none.
        scale: Factor from the value to that unit.
    """

    what: str
    unit: str = ""
    scale: float = 1.0

    def value(self, value: float) -> str:
        """A value in its unit, in the digits that matter."""
        return f"{self.scale * value:.3g}{self.unit}"


def quantity_of(check: CheckTable, language: str) -> Quantity:
    """The quantity that a check judges, in words of a language."""
    say = words(language)
    if check.number:
        what = "width" if check.judge == "width" else "distance"
        return Quantity(say(what, number=check.number), " %" if check.relative else "")
    if not check.metric:
        return Quantity(say("outcome_named"), " %", 100.0)
    metric, printed = say.metric(check.metric), INDICATORS[check.metric].get("printed", "")
    if check.against:
        settings = ", ".join(check.against)
        return Quantity(say("against", metric=metric, settings=settings))
    own = Quantity(metric, f" {printed}".rstrip(), 1000.0 if printed == "mm" else 1.0)
    if check.limit is None:
        return own
    limit = own.value(check.limit)
    return Quantity(say("share_named", metric=metric, limit=limit), " %", 100.0)


def describe_limits(check: CheckTable, language: str) -> str:
    """The numbers at which a check gives all points and none, in words."""
    quantity = quantity_of(check, language)
    name = "limits_up_to" if check.full < check.none else "limits_from"
    full, none = (quantity.value(each) for each in (check.full, check.none))
    return words(language)(name, full=full, none=none)


def describe_check(check: CheckTable, language: str) -> str:
    """The quantity that a check judges and the limits of its points, in words."""
    limits = describe_limits(check, language)
    return words(language)("described", what=quantity_of(check, language).what, limits=limits)


class Judge(NamedTuple):
    """Judges an answer, check by check.

    Attributes:
        lab: The lab.
        dealt: The rig the answer is for.
        file: The answer.
        measurements: Measurements that are kept; None for none.
        max_interval_width: Largest width of an interval, see ``MAX_INTERVAL_WIDTH``.
    """

    lab: Lab
    dealt: Deal
    file: Path
    measurements: Measurements | None = None
    max_interval_width: float = MAX_INTERVAL_WIDTH

    def result(self, check: CheckTable, none: Sequence[str]) -> dict[str, Any]:
        """The result of a check, as check50 has it, with its points.

        Args:
            check: The check.
            none: The checks before it that got no points, without which it cannot be graded.

        Raises:
            NotMeasuredError: If its measurement is not kept, and nothing may be simulated.
        """
        say, texts = words(self.lab.language), check.texts_in(self.lab.language)
        if none:
            first = next(each for each in self.lab.checks(hidden=True) if each.name == none[0])
            name = first.texts_in(self.lab.language).name
            found = Measured(None, note=say("skipped_after", check=name), ending="not graded")
        elif self.measurements is None:
            found = self.measure(check)
        else:
            found = self.measurements.get(self.key(check), lambda: self.measure(check))
        score = 0.0 if found.value is None else check.earned(found.value)
        passed = None if found.ending == "not graded" else score >= check.points
        why, look = found.note, ""
        if found.ending == "early":
            why = say("unfinished", count=found.runs, ended=found.note)
        elif found.ending == "measured":
            why = f"{self.describe(check, found)}. {texts.why}".strip()
        if found.ending in ("measured", "early"):
            look = texts.look
        return {
            "name": check.name,
            "title": texts.name,
            "description": describe_check(check, self.lab.language),
            "passed": passed,
            "score": score,
            "max_score": check.points,
            "visible": check.visible,
            "log": list(found.log),
            "remark": say("too_much", size=found.too_much) if found.too_much else "",
            "cause": None if passed else {"rationale": why, "help": look},
            "dependency": list(check.after),
            "data": {"value": found.value, "ending": found.ending},
        }

    def key(self, check: CheckTable) -> str:
        """A hash of what is simulated for a check: the answer, the rig, its runs, the code.

        Points, limits and texts are not part of it.
        """
        assert self.measurements is not None
        measured = check.model_dump(mode="json", exclude=set(NOT_SIMULATED))
        measured["small is good"] = check.full < check.none
        if check.number:
            measured["none"] = check.none  # the widest interval that counts
        about = self.lab.answer.model_dump(mode="json")
        parts = [self.measurements.source, digest_of(self.file), self.dealt._asdict(), about]
        return digest(json.dumps([*parts, measured], sort_keys=True))

    def describe(self, check: CheckTable, found: Measured) -> str:
        """The sentence about a number that was measured, with the limits of its points."""
        language = self.lab.language
        say, quantity = words(language), quantity_of(check, language)
        limits = describe_limits(check, language)
        ended = f"; {found.note}" if found.note else ""
        if found.value is None:
            limit = f"{self.max_interval_width * abs(check.none):g}{quantity.unit}"
            name = "too_wide" if check.judge == "distance" else "no_number"
            return f"{say(name, number=check.number, limit=limit)} ({limits})"
        if not check.number and (not check.metric or check.limit is not None):
            count = round(found.value * found.runs)
            parts = {"count": count, "runs": found.runs}
            if check.limit is None:
                return say("outcome", **parts) + ended
            metric = quantity_of(check.model_copy(update={"limit": None}), language)
            limit = metric.value(check.limit)
            return f"{say('share', metric=metric.what, limit=limit, **parts)} ({limits}){ended}"
        value = quantity.value(found.value)
        return f"{say('measured', what=quantity.what, value=value)} ({limits})"

    def measure(self, check: CheckTable) -> Measured:
        """Simulate the runs of a check; an error of the answer is part of the measurement."""
        try:
            data = tables(self.lab.answer, self.file)
            return self.number(check, data)
        except TwinError as error:
            ending: Ending = "broken"
            if isinstance(error, NotGradedError):
                ending = "not graded"
            elif isinstance(error, OutOfTimeError):
                ending = "timed out"
            return Measured(None, note=printable(str(error)), ending=ending)

    def picture(self, check: CheckTable) -> Run:
        """The first run of a check, whole.

        Raises:
            TwinError: If the answer fails.
        """
        with self.enter(tables(self.lab.answer, self.file)) as (fixed, _):
            return run(self.scenarios(check, fixed)[0][1])

    @contextmanager
    def enter(
        self, data: Mapping[str, Any]
    ) -> Iterator[tuple[Sequence[str], AnswerProcess | None]]:
        """The overrides that put an answer into a scenario, and its process, if it has one."""
        about = self.lab.answer
        if about.data:
            fixed = [f"{key}={value}" for key, value in in_json(data).items()]
            yield fixed if about.kind == "parameters" else (), None
            return
        with answering(self.file, about) as process:
            table = {"law": "controller", "observer": "observer"}.get(about.kind)
            yield [f"{table}.kind={ANSWER_NAME}"] if table else (), process

    def number(self, check: CheckTable, data: Mapping[str, Any]) -> Measured:
        """The number that a check judges, measured.

        Args:
            check: The check.
            data: The answer's tables, if it is data.

        Raises:
            NotGradedError: If it cannot be graded here.
            TwinError: If the answer fails: one line.
        """
        with self.enter(data) as (fixed, process):
            if check.number:
                found = self.of_numbers(check, self.answers(check, data, process))
            else:
                rows = self.rows(check, fixed)
                if process is not None and process.failure is not None:
                    raise process.error()
                found = self.of_runs(check, rows)
            if process is None:
                return found
            log = [printable(line) for line in process.last_printed()]
            kept_kb = process.most_printed // 1024 if process.prints_too_much() else 0
            return found._replace(log=log, too_much=kept_kb)

    def answers(
        self, check: CheckTable, data: Mapping[str, Any], process: AnswerProcess | None
    ) -> Iterator[tuple[Point, Any]]:
        """Rigs, and the number that the answer gives for each.

        Raises:
            LawError: If a function returns something else.
        """
        if process is None:
            yield self.rigs(check)[0][0].point, data[check.number]
            return
        cases = self.scenarios(check, ()) if check.scenario else [(self.dealt.point, None)]
        for point, scenario in cases:
            log = (
                {} if scenario is None else {"log": measured_columns(scenario.model_dump_json())[0]}
            )
            returned = process.call("function", {**log, **check.given})
            try:
                yield point, check_numbers(self.lab.answer, returned, self.file.name)[check.number]
            except ScenarioError as error:
                raise LawError(str(error)) from None

    def rigs(self, check: CheckTable) -> tuple[list[FamilyRig], set[str]]:
        """The rigs of a check, and which of their values are factors on the scenario's."""
        family = self.lab.family
        rigs = [FamilyRig({} if check.nominal else self.dealt.point, self.dealt.seed)]
        if check.family:
            family = read_family(self.lab.path(check.family))
            rigs = draw_rigs(family, check.draw, check.rigs)
        parameters = family.parameters if family is not None else {}
        return rigs, {key for key, each in parameters.items() if each.relative}

    def scenarios(self, check: CheckTable, fixed: Sequence[str]) -> list[tuple[Point, Scenario]]:
        """The runs of a check with the answer as overrides: the rig, and the scenario.

        Raises:
            ScenarioError: If an override is wrong.
        """
        (rigs, relative), build = self.rigs(check), Builder(self.lab.path(check.scenario))
        return [
            (point, build((*check.set, *fixed, f"seed={seed}"), point, relative))
            for point, own in rigs
            for seed in check.seeds or (own,)
        ]

    def rows(self, check: CheckTable, fixed: Sequence[str]) -> list[Row]:
        """The results of the runs of a check, a row each."""
        work = ScenarioRuns(scenario for _, scenario in self.scenarios(check, fixed))
        return carry_out(work.jobs(work.tasks))

    def of_runs(self, check: CheckTable, rows: list[Row]) -> Measured:
        """The number that a check computes from its runs.

        Raises:
            LawError: If there is none, because of a run.
        """
        refused = next((row["reason"] for row in rows if row["outcome"] == "refused"), None)
        if refused is not None:
            raise LawError(refused)
        early = [row for row in rows if row["outcome"] != "finished"]
        ended = f"{early[0]['outcome']} ({early[0]['reason']})" if early else ""
        values = np.array([row.get(check.metric) for row in rows], float)  # NaN of one that ended
        if not check.metric or check.limit is not None:
            kept = (
                len(rows) - len(early)
                if check.limit is None
                else int((values <= check.limit).sum())
            )
            return Measured(kept / len(rows), len(rows), ended)
        if ended:
            return Measured(None, len(early), ended, "early")
        if check.against:
            values /= np.array(
                [row[check.metric] for row in self.rows(check, check.against)], float
            )
        if not np.isfinite(values).all():
            raise LawError(f"{check.metric}: does not apply to these runs")
        worst = float(values.max() if check.full < check.none else values.min())
        return Measured(worst, len(rows))

    def of_numbers(self, check: CheckTable, found: Iterable[tuple[Point, Any]]) -> Measured:
        """The number that a check computes from the numbers of an answer, one for each rig."""
        errors = [self.error(check, given, point) for point, given in found]
        worst = max(errors)
        return Measured(worst if math.isfinite(worst) else None, len(errors))

    def error(self, check: CheckTable, given: Any, point: Point) -> float:
        """The distance of an answer in numbers from the truth, or the width of its interval."""
        low, high = given if isinstance(given, list) else (given, given)
        truth = None if check.truth is None else self.truth(check, check.truth, point)
        if isinstance(given, str) or isinstance(truth, str):
            return 0.0 if given == truth else math.inf
        scale = abs(truth) / 100 if check.relative and truth else 1.0
        if check.judge == "width" or truth is None:
            return float(high - low) / scale
        if check.judge == "error":
            return float(max(truth - low, high - truth)) / scale
        # an interval that holds everything states nothing
        if high - low > self.max_interval_width * abs(check.none) * scale:
            return math.inf
        return float(max(low - truth, truth - high, 0.0)) / scale

    def truth(self, check: CheckTable, truth: float | str, point: Point) -> float | str:
        """The true value for an answer in numbers, for a rig.

        Raises:
            NotGradedError: If only the lecturer knows it.
        """
        name, _, function = str(truth).partition(":")
        if not isinstance(truth, str) or not (function or check.scenario):
            return truth
        own, data = self.lab.folder / name, self.lab.answer.data
        if (data and not self.dealt.true) or (function and not own.is_file()):
            raise NotGradedError("graded by your lecturer, who knows the rig")
        if function:
            given = copy_files(self.file.parent) if data else nullcontext(check.given)
            with given as known_to_student:
                found = load_function(own, function)(point, known_to_student)
        else:
            known = Builder(self.lab.path(check.scenario)).value
            part = point.get(truth, 1.0) if truth in self.rigs(check)[1] else None
            found = point.get(truth) if part is None else part * known(check.set, truth)
            found = known(check.set, truth) if found is None else found
        return found if isinstance(found, str) else float(found)


def tables(about: AnswerTable, file: Path) -> dict[str, Any]:
    """The tables of an answer that is data; empty for the other kinds, which need a file.

    Raises:
        ScenarioError: If it is missing, or not what the lab requests.
    """
    if not is_there(file):
        alike = sorted({each.name for each in file.parent.glob(f"{file.stem}.*")} - {about.file})
        other = missing(about, file).partition("; ")[2]
        if alike:
            other = f"an answer here is a {about.kind}, not {printable(', '.join(alike))}"
        raise ScenarioError("; ".join(filter(None, (f"{file.name}: not handed in", other))))
    if file.suffix != Path(about.file).suffix:
        raise ScenarioError(f"{file.name}: must be {about.file}, as the answer is a {about.kind}")
    found = read_tables(file, regular=True) if about.data else {}
    if about.kind == "parameters":
        for key in in_json(found):
            if not f"{key}.".startswith(tuple(f"{each}." for each in about.keys)):
                allowed = ", ".join(about.keys)
                raise ScenarioError(f"{file.name}: {key}: may not be set (allowed: {allowed})")
        return found
    return check_numbers(about, found, file.name) if about.data else {}


def check_numbers(about: AnswerTable, found: Mapping[str, Any], called: str) -> dict[str, Any]:
    """Numbers by name, intervals or texts, if they are those that the lab requests.

    Raises:
        ScenarioError: If not.
    """
    for key in found:
        if key not in about.asked:
            where = nearest(key, about.asked)
            raise ScenarioError(f"{called}: {shorten(key)}: unknown{where}")
    for key, unit in about.asked.items():
        if not _answers(found.get(key)):
            what = f"a number in {unit}, an interval [low, high] or a text"
            raise ScenarioError(f"{called}: {key}: must be {what}")
    return dict(found)


def _answers(given: Any) -> bool:
    """Whether it is a number, an interval or a text."""
    pair = given if isinstance(given, list) and len(given) == 2 else [given, given]
    numbers = all(type(each) in {int, float} and math.isfinite(each) for each in pair)
    return isinstance(given, str) or (numbers and pair[0] <= pair[1])
