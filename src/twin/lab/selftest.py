"""Tests a lab with the lecturer's own answers, and proposes limits from what they reach."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from twin.base.errors import ScenarioError, plural
from twin.base.jobs import results
from twin.base.page import percent
from twin.lab.deals import LOG_FILE, Deal, deal, write_log
from twin.lab.handing_out import fill_answer, format_toml, make_starter
from twin.lab.judge import judge_answer
from twin.lab.schema import CheckTable, Lab, load_function
from twin.run.tables import flat

FAILS_PATTERN = re.compile(r"^\s*# fails: (.+?)\s*$", re.MULTILINE)
"""A line of a mutant that names a check which it must fail."""


@dataclass(frozen=True, kw_only=True)
class SelfTest:
    """How a lab is tested with the lecturer's own answers.

    Attributes:
        key: Key by which rigs are dealt for it.
        max_starter_share: Largest share of all points for the starter.
        max_mutant_share: Largest share of a check's points for a mutant that must fail it.
        max_grading_s: Longest time in s for grading an answer.
        full_stds: Distance of a proposed limit ``full`` from the solution's median, in standard
            deviations.
    """

    key: str = "a lab is tried"
    max_starter_share: float = 0.2
    max_mutant_share: float = 0.5
    max_grading_s: float = 60.0
    full_stds: float = 3


SELF_TEST = SelfTest()


class SampleAnswer(NamedTuple):
    """An answer of the lecturer's own.

    Attributes:
        name: ``solution``, ``starter``, or the name of a mutant.
        file: Its path.
        fails: The checks that a mutant must fail.
    """

    name: str
    file: Path
    fails: tuple[str, ...] = ()


class Finding(NamedTuple):
    """One result of a test of a lab.

    Attributes:
        what: The property that was tested.
        good: Whether the lab has it.
        found: The numbers or the reason.
    """

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
        fails = tuple(FAILS_PATTERN.findall(lab.text(f"mutants/{file.name}")))
        if not fails or not names.issuperset(fails):
            raise ScenarioError(
                f"{lab.folder.name}/mutants/{file.name}: must name checks of the lab in lines "
                f"'# fails: NAME', got {', '.join(fails) or 'none'}"
            )
        found.append(SampleAnswer(file.stem, file, fails))
    return found


def prepare_answer(lab: Lab, file: Path, dealt: Deal, folder: Path) -> Path:
    """An answer for a student's rig, as the student would hand it in, next to their log."""
    answer = folder / lab.answer.file
    if lab.answer.data and file.suffix == ".py":
        text = format_toml(flat(load_function(file, "answer")(dealt.point, folder)))
    else:
        text = fill_answer(file.read_text(encoding="utf-8"), dealt.known)
    answer.write_text(text, encoding="utf-8")
    return answer


def try_answer(lab: Lab, key: str, job: tuple[Path, str]) -> dict[str, Any]:
    """The result of a lecturer's own answer on the rig that a key deals to a student."""
    file, student = job
    dealt = deal(lab, student, key)
    with TemporaryDirectory(prefix="ballplate-lab-") as name:
        folder = Path(name)
        write_log(lab, dealt, folder / LOG_FILE)
        return judge_answer(lab, dealt, prepare_answer(lab, file, dealt, folder), hidden=True)


def try_answers(
    lab: Lab, students: Sequence[str], processes: int, key: str
) -> Iterator[tuple[SampleAnswer, dict[str, Any]]]:
    """Every answer of the lecturer's own, and its result on the rigs of some students."""
    jobs = ((each, (each.file, student)) for each in candidates(lab) for student in students)
    yield from results(partial(try_answer, lab, key), jobs, processes)


def selftest(lab: Lab, processes: int, test: SelfTest = SELF_TEST) -> Iterator[Finding]:
    """Whether a lab's solution, starter and mutants get the points that they should.

    Args:
        lab: The lab.
        processes: Number of answers that are graded at the same time.
        test: Constants of the test.

    Raises:
        ScenarioError: If its solution or a mutant cannot be tried.
    """
    if not lab.answer.data:
        same = make_starter(lab.text(candidates(lab)[0].file.name)) == lab.text(lab.answer.file)
        yield Finding(
            "the starter is made from the solution",
            same,
            "" if same else "write it again: --starter",
        )
    for who, result in try_answers(lab, ["selftest"], processes, test.key):
        points = f"{result['score']:g} of {result['max_score']:g} points, {result['seconds']:.1f} s"
        if who.name == "solution":
            lost = [each for each in result["results"] if not each["passed"]]
            why = "".join(f"; {each['name']}: {each['cause']['rationale']}" for each in lost)
            yield Finding("the solution has all points", not lost, points + why)
        elif who.name == "starter":
            good = result["score"] <= test.max_starter_share * result["max_score"]
            most = percent(test.max_starter_share, 0)
            yield Finding(f"the starter has at most {most}", good, points)
        for each in result["results"]:
            if each["name"] in who.fails:
                allowed = test.max_mutant_share * each["max_score"]
                good = each["passed"] is False and each["score"] <= allowed
                why = each["cause"]["rationale"] if each["cause"] else "it passes"
                yield Finding(f"mutant {who.name} fails '{each['name']}'", good, why)
        if result["seconds"] > test.max_grading_s:
            yield Finding(f"{who.name} is graded within {test.max_grading_s:g} s", False, points)


def calibrate(
    lab: Lab,
    rigs: int,
    processes: int,
    progress: Callable[[float], None],
    test: SelfTest = SELF_TEST,
) -> Iterator[Finding]:
    """Proposed limits for each check, from all own answers on a number of rigs.

    A finding is good where there is room between the limits.
    """
    values: dict[str, dict[SampleAnswer, list[float]]] = defaultdict(lambda: defaultdict(list))
    students = [f"rig{number}" for number in range(rigs)]
    for done, (who, result) in enumerate(try_answers(lab, students, processes, test.key), 1):
        progress(done)
        for each in result["results"]:
            if each["data"]["value"] is not None:
                values[each["name"]][who].append(each["data"]["value"])
    for check in lab.checks(hidden=True):
        yield propose_limits(check, values[check.name], rigs, test.full_stds)


def propose_limits(
    check: CheckTable,
    values: dict[SampleAnswer, list[float]],
    rigs: int,
    full_stds: float = SELF_TEST.full_stds,
) -> Finding:
    """Limits of a check for the numbers that the lecturer's own answers reached.

    ``full`` is the solution's median and a number of its standard deviations, or its worst rig if
    that is worse; ``none`` is the best of the medians of the mutants that must fail it and, where
    more than the outcome counts, of the starter.
    """
    sense = 1 if check.full < check.none else -1  # small is good, or large
    good, bad = np.zeros(0), {}
    for who, reached in values.items():
        if who.name == "solution":
            good = sense * np.array(reached)
        elif check.name in who.fails or (who.name == "starter" and (check.metric or check.number)):
            bad[float(np.median(sense * np.array(reached)))] = who.name
    if len(good) < rigs:
        failed = f"the solution fails on {rigs - len(good)} of {plural(rigs, 'rig')}"
        return Finding(check.name, False, failed)
    full = max(np.median(good) + full_stds * good.std(), good.max())
    none = min(bad, default=np.inf)
    text = f"full = {check.full:g}, none = {check.none:g}; proposed: full = {sense * full:.4g}"
    if bad:
        text += f", none = {sense * none + 0.0:.4g} ({bad[none]})"
    room = bool(full < none)
    return Finding(check.name, room, text + ("" if room else ": they overlap"))
