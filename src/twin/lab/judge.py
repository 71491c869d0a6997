"""Judges an answer: for each check a number, its points on a ramp, and the reason."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from twin.base.data_file import DataError, read_regular
from twin.base.errors import (
    LawError,
    ScenarioError,
    TwinError,
    nearest,
    printable,
    shorten,
)
from twin.base.validation import read_tables
from twin.lab.handed_in import copy_files, is_there, missing
from twin.lab.process import ANSWER_NAME, AnswerProcess, answering
from twin.lab.schema import AnswerTable, CheckTable, Deal, Lab, load_function, measured_columns
from twin.run.files import INDICATOR_UNITS
from twin.run.finished import Run, run
from twin.run.tables import in_json
from twin.scenario import Scenario
from twin.study.schema import FamilyRig, Point, draw_rigs, read_family
from twin.study.work import Builder, Row, ScenarioRuns, carry_out, code

RESULT_SCHEMA = "ballplate/lab-result/v1"
MAX_INTERVAL_WIDTH = 2.0
"""Largest width of an interval whose distance from the truth counts, as a multiple of the
distance that gives no points: the middle of a wider one may have that error."""


class EarlyEndError(LawError):
    """A run of an answer ended before its time."""


class NotGradedError(TwinError):
    """A check that cannot be graded here, or yet: the reason."""


class CheckedNumber(NamedTuple):
    """The number that a check judges.

    Attributes:
        value: The number; NaN for none.
        text: The number in words.
        log: Lines that the answer printed.
    """

    value: float
    text: str
    log: Sequence[str] = ()


def judge_answer(lab: Lab, dealt: Deal, file: Path, *, hidden: bool) -> dict[str, Any]:
    """The result of an answer: the results of check50 with points; never an error of the answer.

    Args:
        lab: The lab.
        dealt: The rig it is for.
        file: The answer, which may be missing.
        hidden: Whether the lecturer's hidden checks count, too.
    """
    begin, results = time.perf_counter(), list[dict[str, Any]]()
    for check in lab.checks(hidden=hidden):
        none = {each["name"] for each in results if not each["score"]}.intersection(check.after)
        results.append(Judge(lab, dealt, file).result(check, sorted(none)))
    return {
        "schema": RESULT_SCHEMA,
        "lab": lab.name,
        "version": lab.version,
        "title": lab.title,
        "student": dealt.student,
        "code": dealt.code,
        "rig": dealt.point if hidden else dealt.known,
        "answer": digest_of(file),
        "score": round(sum(each["score"] for each in results), 2),
        "max_score": sum(each["max_score"] for each in results),
        "seconds": round(time.perf_counter() - begin, 2),
        "results": results,
        "versions": {"ballplate": version("ballplate"), "model": code()[:16]},
    }


def digest_of(file: Path) -> str:
    """A short hash of a file's content; empty where there is none that may be opened."""
    try:
        return hashlib.sha256(read_regular(file)).hexdigest()[:16]
    except DataError:
        return ""


def ramp(check: CheckTable) -> str:
    """The numbers at which a check gives all points and none, in words."""
    what, unit = describe_quantity(check)
    ends = f"all {check.points:g} points from {check.full:g}{unit} on, none from {check.none:g}"
    return f"{what}: {ends}{unit}"


def describe_quantity(check: CheckTable) -> tuple[str, str]:
    """The quantity that a check judges, and its unit, in words."""
    unit = f" {INDICATOR_UNITS.get(check.metric, '')}".rstrip()
    if check.number:
        what = "width of the interval" if check.judge == "width" else "distance from the truth"
        return f"{check.number}, {what}", " %" if check.relative else ""
    if not check.metric:
        return "share of the runs that finish", ""
    if check.limit is not None:
        return f"share of the runs with {check.metric} of at most {check.limit:g}{unit}", ""
    if check.against:
        return f"{check.metric} over that with {', '.join(check.against)}", ""
    return check.metric, unit


class Judge(NamedTuple):
    """Judges an answer, check by check.

    Attributes:
        lab: The lab.
        dealt: The rig the answer is for.
        file: The answer.
        max_interval_width: Largest width of an interval, see ``MAX_INTERVAL_WIDTH``.
    """

    lab: Lab
    dealt: Deal
    file: Path
    max_interval_width: float = MAX_INTERVAL_WIDTH

    def result(self, check: CheckTable, none: Sequence[str]) -> dict[str, Any]:
        """The result of a check, as check50 has it, with its points.

        Args:
            check: The check.
            none: The checks before it that got no points, without which it cannot be graded.
        """
        passed: bool | None = False
        score, found, look = 0.0, CheckedNumber(math.nan, ""), check.look
        try:
            data = tables(self.lab.answer, self.file)
            if none:
                raise NotGradedError(f"cannot be graded: '{none[0]}' got no points")
            found = self.number(check, data)
            score = check.earned(found.value)
            passed, why = score >= check.points, f"{found.text}; {ramp(check)}. {check.why}".strip()
        except TwinError as error:
            why = printable(str(error))
            passed = None if isinstance(error, NotGradedError) else False
            look = check.look if isinstance(error, EarlyEndError) else ""
        return {
            "name": check.name,
            "description": ramp(check),
            "passed": passed,
            "score": score,
            "max_score": check.points,
            "visible": check.visible,
            "log": [printable(line) for line in found.log],
            "cause": None if passed else {"rationale": why, "help": look},
            "dependency": list(check.after),
            "data": {"value": found.value if math.isfinite(found.value) else None},
        }

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

    def number(self, check: CheckTable, data: Mapping[str, Any]) -> CheckedNumber:
        """The number that a check judges.

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
                    raise LawError(process.failure)
                found = self.of_runs(check, rows)
            return found if process is None else found._replace(log=process.last_printed())

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

    def of_runs(self, check: CheckTable, rows: list[Row]) -> CheckedNumber:
        """The number that a check computes from its runs.

        Raises:
            LawError: If there is none, because of a run.
        """
        what, unit = describe_quantity(check)
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
            text = f"{kept} of {len(rows)} runs" + (f"; {ended}" if ended else "")
            return CheckedNumber(kept / len(rows), text)
        if ended:
            raise EarlyEndError(f"{len(early)} of {len(rows)} runs did not finish: {ended}")
        if check.against:
            values /= np.array(
                [row[check.metric] for row in self.rows(check, check.against)], float
            )
        if not np.isfinite(values).all():
            raise LawError(f"{check.metric}: does not apply to these runs")
        worst = float(values.max() if check.full < check.none else values.min())
        return CheckedNumber(worst, f"{what} {worst:.4g}{unit}")

    def of_numbers(self, check: CheckTable, found: Iterable[tuple[Point, Any]]) -> CheckedNumber:
        """The number that a check computes from the numbers of an answer, one for each rig."""
        value = max(self.error(check, given, point) for point, given in found)
        unit, text = describe_quantity(check)[1], "is no such number"
        if math.isfinite(value):
            text = f"{value:.4g}{unit}"
        elif check.judge == "distance":
            widest = self.max_interval_width * abs(check.none)
            text += f", or an interval wider than {widest:g}{unit}"
        return CheckedNumber(value, f"{check.number}: {text}")

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
    """The tables of an answer that is data; empty for the others, whose file must exist.

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
