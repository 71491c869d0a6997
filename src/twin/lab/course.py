"""A lab is tried before a class has it: its solution, starter and mutants, and what limits fit."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from twin.errors import ScenarioError
from twin.jobs import results
from twin.lab.judge import judged, trusted
from twin.lab.schema import Lab
from twin.lab.variants import LOG, Deal, deal, filled, record, starter, text_of, toml

KEY = "a lab is tried"
"""The key by which rigs are dealt here."""
FAILS = re.compile(r"^\s*# fails: (.+?)\s*$", re.MULTILINE)
STARTER = 0.2
"""Share of the points that a starter may have."""
MUTANT = 0.5
"""Share of a check's points that a mutant may have which is to fail it."""
LONGEST = 60.0
"""Seconds in which an answer is to be judged."""


class Candidate(NamedTuple):
    """An answer of the lecturer's own.

    Attributes:
        name: ``solution``, ``starter``, or what a mutant is called.
        file: Where it lies.
        fails: The checks that a mutant is to fail.
    """

    name: str
    file: Path
    fails: tuple[str, ...] = ()


def candidates(lab: Lab) -> list[Candidate]:
    """Solution, starter and mutants of a lab.

    Raises:
        ScenarioError: If there is no solution, or a mutant names no check of the lab.
    """
    solutions = sorted(lab.folder.glob("solution.*"))
    if len(solutions) != 1:
        raise ScenarioError(f"{lab.folder.name}: must have one solution.py or solution.toml")
    found = [
        Candidate("solution", solutions[0]),
        Candidate("starter", lab.folder / lab.about.answer.file),
    ]
    names = {each.name for each in lab.checks(hidden=True)}
    for file in sorted((lab.folder / "mutants").glob("*.*")):
        fails = tuple(FAILS.findall(text_of(lab, f"mutants/{file.name}")))
        if not fails or not names.issuperset(fails):
            raise ScenarioError(
                f"{lab.folder.name}/mutants/{file.name}: must name checks of the lab in lines "
                f"'# fails: NAME', got {', '.join(fails) or 'none'}"
            )
        found.append(Candidate(file.stem, file, fails))
    return found


def prepared(lab: Lab, file: Path, dealt: Deal, folder: Path) -> Path:
    """An answer for a student's rig, as the student would hand it in, beside their log."""
    about = lab.about.answer
    answer = folder / about.file
    if about.data and file.suffix == ".py":
        given = trusted(file, "answer")(dealt.point, folder)
        answer.write_text(toml(given), encoding="utf-8")
    else:
        text = file.read_text(encoding="utf-8")
        answer.write_text(filled(text, dealt.told), encoding="utf-8")
    return answer


def tried(lab: Lab, job: tuple[Path, str]) -> dict[str, Any]:
    """The result of a lecturer's own answer on the rig of some student."""
    file, student = job
    dealt = deal(lab, student, KEY)
    with TemporaryDirectory(prefix="ballplate-lab-") as name:
        folder = Path(name)
        record(lab, dealt, folder / LOG)
        return judged(lab, dealt, prepared(lab, file, dealt, folder), hidden=True)


def selftest(lab: Lab, processes: int) -> Iterator[tuple[str, bool, str]]:
    """What is tried of a lab, whether it is as it must be, and what was found.

    Raises:
        ScenarioError: If its solution or a mutant cannot be tried.
    """
    every = candidates(lab)
    if not lab.about.answer.data:
        same = starter(text_of(lab, every[0].file.name)) == text_of(lab, every[1].file.name)
        yield "the starter is made from the solution", same, "" if same else "make it again"
    by_name = {each.name: each for each in every}
    jobs = ((each.name, (each.file, "selftest")) for each in every)
    for name, found in results(partial(tried, lab), jobs, processes):
        points = f"{found['score']:g} of {found['max_score']:g} points, {found['seconds']:.1f} s"
        if name == "solution":
            lost = [each for each in found["results"] if not each["passed"]]
            why = "".join(f"; {each['name']}: {each['cause']['rationale']}" for each in lost)
            yield "the solution has all points", not lost, points + why
        elif name == "starter":
            good = found["score"] <= STARTER * found["max_score"]
            yield f"the starter has at most {STARTER:.0%}", good, points
        for each in found["results"]:
            if each["name"] in by_name[name].fails:
                good = each["passed"] is False and each["score"] <= MUTANT * each["max_score"]
                why = (each["cause"] or {"rationale": "it passes"})["rationale"]
                yield f"mutant {name} fails '{each['name']}'", good, why
        if found["seconds"] > LONGEST:
            yield f"{name} is judged within {LONGEST:g} s", False, points


def calibrate(
    lab: Lab, rigs: int, processes: int, progress: Callable[[float], None]
) -> Iterator[tuple[str, bool, str]]:
    """For each check what limits fit, from all own answers on so many rigs.

    ``full`` is the solution's median and three of its standard deviations, or its worst rig if that
    is worse; ``none`` is the best of the medians of the mutants that are to fail it and, where more
    than the outcome is judged, of the starter.

    Returns:
        Check, whether there is room between the limits, and what is proposed in words.
    """
    every = candidates(lab)
    jobs = ((each, (each.file, f"rig{number}")) for each in every for number in range(rigs))
    values: dict[tuple[str, str], list[float]] = {}
    for done, (who, found) in enumerate(results(partial(tried, lab), jobs, processes), 1):
        progress(done)
        for each in found["results"]:
            if each["data"]["value"] is not None:
                values.setdefault((who.name, each["name"]), []).append(each["data"]["value"])
    for check in lab.checks(hidden=True):
        sense = 1 if check.full < check.none else -1  # small is good, or large
        got = {
            name: sense * np.array(of)
            for (name, which), of in values.items()
            if which == check.name
        }
        good = got.get("solution", np.zeros(0))
        if len(good) < rigs:
            yield check.name, False, f"the solution fails on {rigs - len(good)} of {rigs} rigs"
            continue
        full = max(np.median(good) + 3 * good.std(), good.max())
        to_fail = {each.name for each in every if check.name in each.fails}
        to_fail |= {"starter"} if check.metric or check.number else set()
        bad = {float(np.median(of)): name for name, of in got.items() if name in to_fail}
        text = f"full = {check.full:g}, none = {check.none:g}; proposed: full = {sense * full:.4g}"
        none = min(bad, default=None)
        if none is not None:
            text += f", none = {sense * none + 0.0:.4g} ({bad[none]})"
        room = none is None or bool(full < none)
        yield check.name, room, text + ("" if room else ": they overlap")
