"""An answer is judged: check by check a number, its points on a ramp, and why."""

from __future__ import annotations

import hashlib
import importlib.util
import json
import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from controllers import catalog
from twin.errors import LawError, ScenarioError, TwinError, nearest, shortened
from twin.lab.process import NAME, AnswerProcess, answer_class
from twin.lab.schema import AnswerTable, CheckTable, Lab
from twin.lab.variants import Deal
from twin.run.indicators import UNITS
from twin.scenario.schema import Scenario
from twin.study.family import FamilyRig, drawn
from twin.study.family import read as read_family
from twin.study.work import Builder, Row, ScenarioRuns, carry_out, code
from twin.validation import read_tables

RESULT = "ballplate/lab-result/v1"


class NotJudgedError(TwinError):
    """What cannot be judged here, or yet: why."""


class Judged(NamedTuple):
    """A number that was judged.

    Attributes:
        value: The number.
        said: It in words.
        log: What the answer printed.
    """

    value: float
    said: str
    log: list[str]


class Answer(NamedTuple):
    """An answer that is judged.

    Attributes:
        file: Where it lies.
        data: Its tables, of an answer that is data.
        user: Whom its process belongs to.
    """

    file: Path
    data: Mapping[str, Any]
    user: str | None = None


def judged(lab: Lab, dealt: Deal, file: Path, *, hidden: bool, user: str | None = None) -> Any:
    """The result of an answer: what check50 calls its results, with points; never an error of it.

    Args:
        lab: The lab.
        dealt: The rig it is for.
        file: The answer, there or not.
        hidden: Whether what only the lecturer has is judged, too.
        user: Whom the answer's process shall belong to.
    """
    begin, problem = time.perf_counter(), None
    results: list[dict[str, Any]] = []
    data: dict[str, Any] = {}
    try:
        data = tables(lab.about.answer, file)
    except TwinError as error:
        problem = str(error)
    for check in lab.checks(hidden=hidden):
        lacking = [each["name"] for each in results if each["name"] in check.after]
        lacking = [name for name in lacking if not _score(results, name)]
        result: dict[str, Any] = _begun(check)
        try:
            if problem:
                raise ScenarioError(problem)
            if lacking:
                raise NotJudgedError(f"cannot be judged: '{lacking[0]}' got no points")
            found = _number(lab, check, dealt, Answer(file, data, user))
        except NotJudgedError as error:
            result |= {"passed": None, "cause": {"rationale": str(error), "help": ""}}
        except TwinError as error:
            result["cause"] |= {"rationale": str(error)}
        else:
            score = check.earned(found.value)
            result |= {"score": score, "passed": score >= check.points, "log": found.log}
            result["data"] = {"value": found.value if math.isfinite(found.value) else None}
            result["cause"] |= {"actual": found.said}
            result["cause"]["rationale"] = f"{found.said}; {ramp(check)}. {check.why}".strip()
        if result["passed"]:
            result["cause"] = None
        results.append(result)
    return {
        "schema": RESULT,
        "lab": lab.about.name,
        "version": lab.about.version,
        "title": lab.about.title,
        "student": dealt.student,
        "code": dealt.code,
        "rig": dealt.point if hidden else dealt.told,
        "answer": digest_of(file),
        "score": round(sum(each["score"] for each in results), 2),
        "max_score": sum(each["max_score"] for each in results),
        "seconds": round(time.perf_counter() - begin, 2),
        "results": results,
        "versions": {"ballplate": version("ballplate"), "model": code()[:16]},
    }


def _score(results: list[dict[str, Any]], name: str) -> float:
    return float(next(each["score"] for each in results if each["name"] == name))


def _begun(check: CheckTable) -> dict[str, Any]:
    return {
        "name": check.name,
        "description": ramp(check),
        "passed": False,
        "score": 0.0,
        "max_score": check.points,
        "visible": check.visible,
        "log": [],
        "cause": {"rationale": check.why, "help": check.look, "expected": ramp(check)},
        "dependency": list(check.after),
        "data": {},
    }


def digest_of(file: Path) -> str:
    """A short name for what an answer's file holds; empty where there is none."""
    return hashlib.sha256(file.read_bytes()).hexdigest()[:16] if file.is_file() else ""


def ramp(check: CheckTable) -> str:
    """Where the points begin and where all of them are reached, in words."""
    what, unit = measured(check)
    return (
        f"{what}: all {check.points:g} points from {check.full:g}{unit} on, "
        f"none from {check.none:g}{unit}"
    )


def measured(check: CheckTable) -> tuple[str, str]:
    """What a check judges, and its unit, in words."""
    unit = UNITS.get(check.metric, "1")
    unit = "" if unit == "1" else f" {unit}"
    if check.number:
        what = "width of the interval" if check.judge == "width" else "distance from the truth"
        return f"{check.number}, {what}", " %" if check.relative else ""
    if check.arguments:
        return "largest difference from what is expected", ""
    if not check.metric:
        return "share of the runs that finish", ""
    if check.limit is not None:
        return f"share of the runs with {check.metric} of at most {check.limit:g}{unit}", ""
    if check.against:
        return f"{check.metric} over that with {', '.join(check.against)}", ""
    return check.metric, unit


def _number(lab: Lab, check: CheckTable, dealt: Deal, answer: Answer) -> Judged:
    """The number that a check judges.

    Raises:
        NotJudgedError: If it cannot be judged here.
        TwinError: If the answer fails: one line.
    """
    if check.number:
        value = _off(lab, check, dealt, answer)
        said = "is no such number" if math.isinf(value) else f"{value:.4g}{measured(check)[1]}"
        return Judged(value, f"{check.number}: {said}", [])
    about = lab.about.answer
    if about.kind == "parameters":
        fixed = [f"{key}={json.dumps(value)}" for key, value in flat(answer.data)]
        return _judge_runs(lab, check, dealt, fixed, [])
    with AnswerProcess(answer.file, about, answer.user) as process:
        if about.kind == "function":
            worst = _called(check, process)
            return Judged(worst, f"largest difference {worst:.4g}", process.printed())
        table = "controller" if about.kind == "law" else "observer"
        with _taken_in(process):
            found = _judge_runs(lab, check, dealt, [f"{table}.kind={NAME}"], process.printed)
        if process.failure is not None:
            raise LawError(process.failure)
        return found


@contextmanager
def _taken_in(process: AnswerProcess) -> Iterator[None]:
    """Have the answer's class in the catalog within the context."""
    catalog.register(answer_class(process))
    try:
        yield
    finally:
        catalog._registered.pop(NAME)
        catalog._all_classes.cache_clear()


def _judge_runs(
    lab: Lab,
    check: CheckTable,
    dealt: Deal,
    fixed: list[str],
    printed: Callable[[], list[str]] | list[str],
) -> Judged:
    rows = _rows(lab, check, dealt, fixed)
    log = printed() if callable(printed) else printed
    what, unit = measured(check)
    refused = next((row["reason"] for row in rows if row["outcome"] == "refused"), None)
    if refused is not None:
        raise LawError(refused)
    ended = [row for row in rows if row["outcome"] != "finished"]
    good = [row for row in rows if row["outcome"] == "finished"]
    if check.metric and check.limit is None:
        if ended:
            raise LawError(f"{len(ended)} of {len(rows)} runs did not finish: {_end(ended[0])}")
        values = np.array([row[check.metric] for row in rows], float)
        if check.against:
            beside = _rows(lab, check, dealt, list(check.against))
            values = values / np.array([row[check.metric] for row in beside], float)
        if not np.isfinite(values).all():
            raise LawError(f"{check.metric}: does not apply to these runs")
        worst = float(values.max() if check.full < check.none else values.min())
        return Judged(worst, f"{what} {worst:.4g}{unit}", log)
    if check.limit is not None:
        good = [
            row
            for row in good
            if (row[check.metric] is not None) and row[check.metric] <= check.limit
        ]
    share = len(good) / len(rows)
    said = f"{len(good)} of {len(rows)} runs" + (f"; {_end(ended[0])}" if ended else "")
    return Judged(share, said, log)


def _end(row: Row) -> str:
    return f"{row['outcome']} ({row['reason']})" if row["reason"] else str(row["outcome"])


def _rows(lab: Lab, check: CheckTable, dealt: Deal, fixed: list[str]) -> list[Row]:
    """What the runs of a check gave, a row each."""
    work = ScenarioRuns(scenarios(lab, check, dealt, fixed))
    return carry_out(work.jobs(work.tasks))


def scenarios(lab: Lab, check: CheckTable, dealt: Deal, fixed: list[str]) -> list[Scenario]:
    """The runs of a check.

    Raises:
        ScenarioError: If an override is wrong.
    """
    family = lab.family
    rigs = [FamilyRig({} if check.nominal else dealt.point, dealt.seed)]
    if check.family:
        family = read_family(lab.file(check.family))
        rigs = drawn(family, check.draw, check.rigs)
    parameters = family.parameters if family is not None else {}
    relative = {key for key, each in parameters.items() if each.relative}
    build = Builder(lab.file(check.scenario))
    return [
        build((*check.set, *fixed, f"seed={seed}"), point, relative)
        for point, own in rigs
        for seed in check.seeds or (own,)
    ]


def _called(check: CheckTable, process: AnswerProcess) -> float:
    """The largest difference of a function's values from what they should be."""
    content = (json.dumps(each).encode() for each in check.arguments)
    got = [float(process.numbers(b"c", each, [(1,)])[0][0]) for each in content]
    return float(np.abs(np.subtract(got, check.expected)).max())


def _off(lab: Lab, check: CheckTable, dealt: Deal, answer: Answer) -> float:
    """How far an answer in numbers is from the truth, or how wide its interval is."""
    given = answer.data[check.number]
    low, high = given if isinstance(given, list) else (given, given)
    truth = None if check.truth is None else _truth(lab, check, dealt, answer.file.parent)
    if isinstance(given, str) or isinstance(truth, str):
        return 0.0 if given == truth and check.judge == "distance" else math.inf
    scale = abs(truth) / 100 if check.relative and truth else 1.0
    if check.judge == "width":
        return float(high - low) / scale
    assert truth is not None
    return float(max(low - truth, truth - high, 0.0)) / scale


def _truth(lab: Lab, check: CheckTable, dealt: Deal, folder: Path) -> float | str:
    """What an answer in numbers should be.

    Raises:
        NotJudgedError: If only the lecturer knows it.
    """
    truth = check.truth
    name, _, function = str(truth).partition(":")
    if not isinstance(truth, str) or (not function and not check.scenario):
        assert truth is not None
        return truth
    if not dealt.true or (function and not (lab.folder / name).is_file()):
        raise NotJudgedError("judged by your lecturer, who knows the rig")
    if not function:
        build = Builder(lab.file(check.scenario))
        given = dealt.point.get(truth)
        found = build.value(check.set, truth) if given is None else given
    else:
        found = trusted(lab.folder / name, function)(dealt.point, folder)
    return found if isinstance(found, str) else float(found)


def trusted(file: Path, function: str) -> Callable[..., Any]:
    """A function of a lecturer's own file.

    Raises:
        ScenarioError: If there is none.
    """
    spec = importlib.util.spec_from_file_location(f"lab_{file.stem}", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    if not callable(call := getattr(module, function, None)):
        raise ScenarioError(f"{file.name}: must define a function {function}")
    found: Callable[..., Any] = call
    return found


def tables(about: AnswerTable, file: Path) -> dict[str, Any]:
    """The tables of an answer that is data; of others none, once the file is known to be there.

    Raises:
        ScenarioError: If it is not there, or not what was asked for.
    """
    if not file.is_file():
        raise ScenarioError(f"{about.file}: not handed in")
    if not about.data:
        if file.suffix != ".py":
            raise ScenarioError(f"{file.name}: must be {about.file}, a {about.kind} in Python")
        return {}
    if file.suffix != ".toml":
        raise ScenarioError(f"{file.name}: must be {about.file}, {about.kind} in TOML")
    found = read_tables(file)
    if about.kind == "parameters":
        for key, _ in flat(found):
            if not any(key == each or key.startswith(f"{each}.") for each in about.keys):
                raise ScenarioError(
                    f"{file.name}: {key}: may not be set (allowed: {', '.join(about.keys)})"
                )
        return found
    for key in found:
        if key not in about.asked:
            raise ScenarioError(
                f"{file.name}: {shortened(key)}: unknown{nearest(key, about.asked)}"
            )
    for key, unit in about.asked.items():
        if not _answers(found.get(key)):
            raise ScenarioError(
                f"{file.name}: {key}: must be a number in {unit}, an interval [low, high] or a text"
            )
    return found


def _answers(given: Any) -> bool:
    """Whether it is a number, an interval or a text."""

    def number(value: Any) -> bool:
        return isinstance(value, int | float) and math.isfinite(value) and value is not True

    if isinstance(given, list):
        return len(given) == 2 and all(map(number, given)) and given[0] <= given[1]
    return isinstance(given, str) or number(given)


def flat(data: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted keys and values of tables."""
    for key, value in data.items():
        if isinstance(value, dict):
            yield from flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
