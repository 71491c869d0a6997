"""Counts the alarms that the shadow raises on simulated rigs that are well.

uv run python docs/shadow_healthy.py --hours 24 --laws 0   makes shadow_healthy.md, AFL alone
uv run python docs/shadow_healthy.py --hours 0 --laws 2    makes shadow_laws.md, all other laws

Rigs of the mechanism under AFL, with uneven and with even screens, and the former under every other
law. What has been simulated is kept in runs/shadow_healthy and used again while the code stays the
same, so that more hours cost only the new ones.
"""

from __future__ import annotations

import inspect
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import click
import pandas as pd

from docs.pages import HERE, filled, kept, write
from docs.shadow_trials import (
    FAMILY,
    HEALTHY,
    HEALTHY_SCENARIOS,
    LAW,
    LAWS,
    rates,
    rig,
    shadow_files,
    texts,
)
from twin.base.errors import LogError
from twin.base.jobs import cores, results
from twin.cli.options import PROCESSES_OPTION
from twin.cli.output import progress
from twin.shadow.alarms import CHANGE_TEST, DEAD_TIME_TEST
from twin.shadow.belief import belief_of, logs
from twin.shadow.causes import likely
from twin.shadow.follow import shadow
from twin.study.schema import draw_rigs, read_family
from twin.study.work import code, digest

SEEDS = {"uneven": 400_000, "even": 520_000}
"""First seeds of the rigs under AFL, by their screens,"""
UNDER_LAWS = 2_700_000
"""and of those under other laws, ``PER_LAW`` apart."""
PER_LAW = 10_000
DRAWS = {LAW: 1_804, "others": 1_809}
"""The draws of rigs with uneven screens. 1805 and 1807 have been examined, and are not counted."""
RUN_S = 180.0
"""Seconds of a run."""
TOGETHER = 30
"""Rigs of each sort of screens, under AFL, that are simulated side by side: a period costs little
more for more of them."""
LAW_TOGETHER = 40
"""Rigs under one of the other laws that are simulated side by side."""
WIDE_PLAY_DEG = 0.15
"""Play of the drives in deg above which rigs are counted apart, half the widest of the family."""
CURE = "cure"
"""The law that is counted apart on rigs with play."""
ALLOWED_PER_H = 1 / 24
"""False alarms an hour that are allowed."""
TESTS = ("every", "late")
"""Tests of which the largest log-likelihood ratio is kept: of all causes, of the dead time."""
THRESHOLDS = (CHANGE_TEST.threshold_llr, DEAD_TIME_TEST.threshold_llr)
"""Log-likelihood ratios at which they raise an alarm."""


class Watched(NamedTuple):
    """A healthy rig: number in its draw, screen and law."""

    number: int
    screens: str
    law: str = LAW

    @property
    def seed(self) -> int:
        """Of its noise and of the twin's errors."""
        if self.law == LAW:
            return SEEDS[self.screens] + self.number
        return UNDER_LAWS + PER_LAW * list(LAWS).index(self.law) + self.number

    @property
    def scenario(self) -> str:
        """What it does."""
        return HEALTHY_SCENARIOS[self.number % len(HEALTHY_SCENARIOS)]


def known(job: tuple[Watched, ...]) -> list[dict[str, Any]]:
    """What is said of the rigs of a job: as kept, or tried and then kept."""
    return kept("shadow_healthy", key_of(job), lambda: carry_out(job))


def key_of(job: Sequence[Watched]) -> str:
    """The name under which a job is kept: of all on which it depends what is said of its rigs."""
    how = texts(HERE / "shadow_trials.py", *shadow_files())
    own = inspect.getsource(Watched) + inspect.getsource(carry_out)
    rigs = [(each, each.seed) for each in job]
    return digest(f"{code()} {how} {own} {read_family(FAMILY)} {DRAWS} {RUN_S} {rigs}")


def carry_out(job: Sequence[Watched]) -> list[dict[str, Any]]:
    """Simulate the rigs of a job and let the twin watch each: a row for each in JSON.

    Which rig it is, the play of its drives in deg, why it gave no verdict, seconds that were
    watched, the alarms and their causes, the largest log-likelihood ratios of both tests, and the
    share of the job's processor time in s that it took to simulate and to watch a rig.
    """
    family, begun = read_family(FAMILY), time.process_time()
    draws = {
        law: draw_rigs(family, draw, 1 + max(each.number for each in job))
        for law, draw in DRAWS.items()
    }
    pairs = []
    for each in job:
        points = draws[each.law if each.law in draws else "others"]
        drawn = points[each.number].point if each.screens == "uneven" else None
        pairs.append(rig(each.seed, each.scenario, HEALTHY, drawn, each.law, RUN_S))
    recorded = logs(pairs)
    simulated = time.process_time()
    found = []
    for each, (_, truth), log in zip(job, pairs, recorded, strict=True):
        play = truth.plant.servo.backlash_deg
        about = {**each._asdict(), "scenario": each.scenario, "play": play}
        try:
            said = shadow(log, belief_of(log), replaying=False)
        except LogError as error:
            nothing = {"length": 0.0, "alarms": [], "every": 0.0, "late": 0.0}
            found.append({**about, "why": str(error), **nothing})
            continue
        alarms = [
            {"time": alarm.time, "causes": [cause.name for cause in likely(alarm.causes)]}
            for alarm in said.alarms
        ]
        every, late = (
            float(ratio.max(initial=0.0)) for ratio in (said.tests.ratio, said.tests.delayed)
        )
        largest = {"every": every, "late": late}
        found.append({**about, "why": "", "length": said.length, "alarms": alarms, **largest})
    spent = {
        "simulating": (simulated - begun) / len(job),
        "watching": (time.process_time() - simulated) / len(job),
    }
    return [row | spent for row in found]


def jobs(hours: float, laws: float) -> Iterator[tuple[Watched, ...]]:
    """Rigs that are simulated side by side, the first ones the same however many there are.

    Args:
        hours: Of each sort of screens under AFL.
        laws: Hours under each of the other laws.
    """
    count, others = (round(each * 3600 / RUN_S) for each in (hours, laws))
    for begin in range(0, count, TOGETHER):
        numbers = range(begin, min(begin + TOGETHER, count))
        yield tuple(Watched(number, screens) for screens in SEEDS for number in numbers)
    for law in LAWS:
        for begin in range(0, others if law != LAW else 0, LAW_TOGETHER):
            numbers = range(begin, min(begin + LAW_TOGETHER, others))
            yield tuple(Watched(number, "uneven", law) for number in numbers)


def verdict(alarms: int, hours: float) -> str:
    """What a count says of the rate that is allowed, by its 95 % interval."""
    low, high = rates(alarms, hours)
    if high <= ALLOWED_PER_H:
        return "shown"
    return "**refuted**" if low > ALLOWED_PER_H else "not shown"


def counts(rows: pd.DataFrame, name: str) -> tuple[str, ...]:
    """A row of a table: rigs, hours, false alarms, how often in 24 h, what that says."""
    hours, alarms = float(rows["length"].sum()) / 3600, int(rows["alarms"].str.len().sum())
    low, high = (24 * each for each in rates(alarms, hours))
    often = f"{24 * alarms / hours:.3g} ({low:.3g} to {high:.3g})"
    return name, str(len(rows)), f"{hours:.1f}", str(alarms), often, verdict(alarms, hours)


def raised(rows: pd.DataFrame) -> list[tuple[str, ...]]:
    """A row of a table for each false alarm: the rig, when, and what it was held to be."""
    return [
        (row["law"], row["screens"], row["scenario"], str(row["number"]), f"{alarm['time']:.0f}",
         ", ".join(alarm["causes"]) or "-")
        for row in rows.to_dict("records") for alarm in row["alarms"]
    ]  # fmt: skip


def page_of_afl(found: Iterable[Mapping[str, Any]], command: str) -> str:
    """The page of the rigs under AFL, in Markdown.

    Args:
        found: What was said of every one of them.
        command: That makes this page.
    """
    rows = pd.DataFrame(found)
    peaks = [
        (screens, *(f"{some[test].quantile(q):.1f}" for test in TESTS for q in (0.5, 0.99, 1.0)))
        for screens, some in rows.groupby("screens", sort=False)
    ]  # fmt: skip
    return filled(
        "shadow_healthy",
        command=command,
        seconds=RUN_S,
        scenarios=HEALTHY_SCENARIOS,
        sorts=[
            *(counts(rows[rows["screens"] == each], each) for each in SEEDS),
            counts(rows, "both"),
        ],
        raised=raised(rows),
        peaks=peaks,
        thresholds=THRESHOLDS,
        spent=spent(rows),
        needed=rates(0, 1.0)[1] / ALLOWED_PER_H,
    )


def page_of_laws(found: Iterable[Mapping[str, Any]], command: str) -> str:
    """The page of the rigs under all other laws, in Markdown; as `page_of_afl`."""
    rows = pd.DataFrame(found)
    laws = [(law, rows[rows["law"] == law]) for law in rows["law"].unique()]
    groups = {
        f"{name}, play {side} {WIDE_PLAY_DEG:g} deg": some[some["play"].gt(WIDE_PLAY_DEG) == above]
        for name, some in ((CURE, rows[rows["law"] == CURE]), ("all", rows))
        for side, above in (("up to", False), ("above", True))
    }
    return filled(
        "shadow_laws",
        command=command,
        seconds=RUN_S,
        scenarios=HEALTHY_SCENARIOS,
        laws=[
            (*counts(some, law), *(f"{some[test].max():.1f}" for test in TESTS), *costs(some))
            for law, some in (*laws, ("all", rows))
        ],
        play=[rows["play"].quantile(q) for q in (0.0, 0.5, 1.0)],
        by_play=[counts(some, name) for name, some in groups.items() if len(some)],
        raised=raised(rows),
        thresholds=THRESHOLDS,
        unwatched=[row for row in rows.to_dict("records") if row["why"]],
    )


def costs(rows: pd.DataFrame) -> tuple[str, ...]:
    """Processor time in s of an hour of a rig, to simulate and to watch, for a table."""
    return tuple(f"{each:.0f}" for each in spent(rows))


def spent(rows: pd.DataFrame) -> list[float]:
    """Processor time in s that an hour of a rig takes to simulate, and to watch."""
    return [3600 / RUN_S * float(rows[name].mean()) for name in ("simulating", "watching")]


@click.command()
@click.option(
    "--hours", type=click.FloatRange(min=0), default=24.0, help="Of each screens, under AFL."
)
@click.option(
    "--laws", type=click.FloatRange(min=0), default=2.0, help="Hours under each other law."
)
@PROCESSES_OPTION
def main(hours: float, laws: float, processes: int | None) -> None:
    """Watch healthy simulated rigs, and write how many false alarms there were."""
    found: list[dict[str, Any]] = []
    every = list(enumerate(jobs(hours, laws)))
    with progress("healthy rigs", 1.0) as advance:
        for done, (_, some) in enumerate(results(known, every, processes or cores())):
            found += some
            advance((done + 1) / len(every))
    own, others = ([row for row in found if (row["law"] == LAW) == afl] for afl in (True, False))
    command = "uv run python docs/shadow_healthy.py"
    if own:
        text = page_of_afl(own, f"{command} --hours {hours:g} --laws 0")
        write(HERE / "shadow_healthy.md", text)
    if others:
        write(HERE / "shadow_laws.md", page_of_laws(others, f"{command} --hours 0 --laws {laws:g}"))


if __name__ == "__main__":
    # what other processes work on has to lie in a module
    from docs.shadow_healthy import main as of_module

    of_module()
