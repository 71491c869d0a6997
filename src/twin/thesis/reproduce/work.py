"""Which simulations a table needs, and doing them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

from twin.thesis.reproduce.cases import Case
from twin.thesis.reproduce.exact import exact
from twin.thesis.reproduce.measures import Trace, judge
from twin.thesis.reproduce.sampled import sampled
from twin.thesis.reproduce.tables import Table, tables

FIGURE_STEP = 0.02
"""Seconds between the points that figures are drawn through."""

Place = tuple[str, int]
"""Table and index of the row."""


@dataclass(frozen=True)
class Job:
    """Rows that are simulated as one batch.

    Attributes:
        way: "exact", "sampled" or "mujoco", the columns of the comparison, or "fitted": the exact
            model with the settings that fit a table better than its text's.
        places: The rows.
        cost: Seconds it takes on one core, roughly.
    """

    way: str
    places: tuple[Place, ...]
    cost: float


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What one simulation of a row gave.

    Attributes:
        place: Table and row.
        way: How it was simulated.
        values: Column to the values of all runs.
        ended: Why a run ended early, in words; empty if all lasted.
        excerpt: The first run, for a figure.
    """

    place: Place
    way: str
    values: dict[str, list[float]]
    ended: str
    excerpt: Trace


def plan(wanted: Iterable[Table]) -> list[Job]:
    """The jobs that tables need, the longest first.

    Rows that differ in law and reference only are put together, which is faster than one by one
    and changes nothing: every case has the same noise.
    """
    batches: dict[Any, list[Place]] = defaultdict(list)
    for table in wanted:
        ways = ("exact", "sampled", "mujoco", *(("fitted",) if table.fitted else ()))
        for index in range(len(table.rows)):
            for way in ways:
                place = (table.id, index)
                batches[way, _batch(place, way)].append(place)
    jobs = [Job(way, tuple(places), _cost(way, places)) for (way, _), places in batches.items()]
    return sorted(jobs, key=lambda job: -job.cost)


def carry_out(job: Job) -> list[Finding]:
    """Simulate the rows of a job."""
    cases = [_case(place, job.way) for place in job.places]
    if job.way in ("exact", "fitted"):
        traces = exact(cases)
    else:
        traces = sampled(cases, mechanism=job.way == "mujoco")
    return [
        Finding(
            place=place,
            way=job.way,
            values=judge(trace, case, tables()[place[0]].columns),
            ended=trace.ended,
            excerpt=trace.excerpt(FIGURE_STEP),
        )
        for place, case, trace in zip(job.places, cases, traces, strict=True)
    ]


def _case(place: Place, way: str) -> Case:
    table = tables()[place[0]]
    case = Case(**table.rows[place[1]].setup)
    if way != "fitted":
        return case
    assert table.fitted is not None
    return replace(case, **{key: value for key, value in table.fitted.items() if key != "label"})


def _batch(place: Place, way: str) -> object:
    """What rows of one batch have in common."""
    case = _case(place, way)
    if case.observer is None:
        return (place[0] if way == "exact" else "", case.duration)
    return repr(replace(case, controller={}, reference={}, steady_from=0.0))


def _cost(way: str, places: Iterable[Place]) -> float:
    """Seconds, from measurements on one core: so much a simulated second, so much a rig."""
    cases = [_case(place, way) for place in places]
    rigs = sum(case.seeds for case in cases)
    full = cases[0].observer is None
    once, each = {
        "exact": (0.0, 0.03) if full else (0.15, 0.002),
        "fitted": (0.1, 0.0012),
        "sampled": (0.15, 0.015) if full else (0.2, 0.004),
        "mujoco": (0.2, 0.035) if full else (0.3, 0.009),
    }[way]
    return cases[0].duration * (once + each * rigs)
