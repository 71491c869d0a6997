"""Which simulations tables need, and doing them on all processors."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from twin.errors import TwinError
from twin.jobs import cores, results
from twin.thesis.reproduce.cases import SimulationCase
from twin.thesis.reproduce.continuous import exact
from twin.thesis.reproduce.measures import SimulationTrace, judge
from twin.thesis.reproduce.sampled import sampled
from twin.thesis.reproduce.tables import SimulatedTable, tables

WORTH_PROCESSES = 1000.0
"""Simulated seconds from which starting further processes saves time."""
MOST_PROCESSES = 8
FIGURE_STEP = 0.02
"""Seconds between the points that figures are drawn through."""

RowId = tuple[str, int]
"""Number of the table and index of the row."""


@dataclass(frozen=True)
class ReproductionJob:
    """Rows that are simulated as one batch.

    Attributes:
        way: "exact", "sampled" or "mujoco", the columns of the comparison, or "fitted": the exact
            model with the settings that fit a table better than its text's.
        places: The rows.
        cost: Simulated seconds of all its runs together.
    """

    way: str
    places: tuple[RowId, ...]
    cost: float


@dataclass(frozen=True, kw_only=True)
class RowResult:
    """What one simulation of a row gave.

    Attributes:
        place: Number of the table and index of the row.
        way: How it was simulated.
        values: Column to the values of all runs.
        ended: Why a run ended early, in words; empty if all lasted.
        excerpt: The first run, for a figure.
    """

    place: RowId
    way: str
    values: dict[str, list[float]]
    ended: str
    excerpt: SimulationTrace


def plan(wanted: Iterable[SimulatedTable]) -> list[ReproductionJob]:
    """The jobs that tables need, the longest first.

    Rows that differ in law and reference only are put together, which is faster than one by one
    and changes nothing: every case has the same noise.
    """
    batches: dict[Any, list[RowId]] = defaultdict(list)
    for table in wanted:
        ways = ("exact", "sampled", "mujoco", *(("fitted",) if table.fitted else ()))
        for index in range(len(table.rows)):
            for way in ways:
                place = (table.id, index)
                batches[way, _batch(place, way)].append(place)
    jobs = [
        ReproductionJob(way, tuple(places), _cost(places, way))
        for (way, _), places in batches.items()
    ]
    return sorted(jobs, key=lambda job: -job.cost)


def row_results(
    jobs: Sequence[ReproductionJob],
    processes: int | None = None,
    progress: Callable[[float], None] = print,
) -> Iterator[RowResult]:
    """The results of all jobs' rows, as they come.

    Args:
        jobs: What to do, the longest first.
        processes: On how many processors; None for all, or for one if there is little to do.
        progress: Called with the cost of what is done so far.

    Raises:
        TwinError: If a job fails.
    """
    total = sum(job.cost for job in jobs)
    if processes is None:
        few = total < WORTH_PROCESSES
        processes = 1 if few else min(cores(), MOST_PROCESSES, len(jobs))
    done = 0.0
    for index, found in results(_tried, enumerate(jobs), processes):
        done += jobs[index].cost
        progress(done)
        yield from found


def _tried(job: ReproductionJob) -> list[RowResult]:
    """The job's results, or one line that says which job failed."""
    try:
        return carry_out(job)
    except TwinError:
        raise
    except Exception as error:
        where = ", ".join(sorted({table for table, _ in job.places}))
        raise TwinError(f"table {where}, {job.way}: {type(error).__name__}: {error}") from error


def carry_out(job: ReproductionJob) -> list[RowResult]:
    """Simulate the rows of a job."""
    cases = [_case(place, job.way) for place in job.places]
    if job.way in ("exact", "fitted"):
        traces = exact(cases)
    else:
        traces = sampled(cases, mechanism=job.way == "mujoco")
    return [
        RowResult(
            place=place,
            way=job.way,
            values=judge(trace, case, tables()[place[0]].columns),
            ended=trace.ended,
            excerpt=trace.excerpt(FIGURE_STEP),
        )
        for place, case, trace in zip(job.places, cases, traces, strict=True)
    ]


def _case(place: RowId, way: str) -> SimulationCase:
    table = tables()[place[0]]
    case = SimulationCase(**table.rows[place[1]].setup)
    if way != "fitted":
        return case
    assert table.fitted is not None
    return replace(case, **{key: value for key, value in table.fitted.items() if key != "label"})


def _batch(place: RowId, way: str) -> object:
    """What rows of one batch have in common."""
    case = _case(place, way)
    if case.observer is None:
        return (place[0] if way == "exact" else "", case.duration)
    return repr(replace(case, controller={}, reference={}, steady_from=0.0))


def _cost(places: Iterable[RowId], way: str) -> float:
    """Simulated seconds of all runs together."""
    return sum(case.duration * case.seeds for case in (_case(place, way) for place in places))
