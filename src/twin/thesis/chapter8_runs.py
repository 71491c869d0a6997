"""Runs of the rows of Tables 8.1 to 8.21: jobs, their simulation, and the columns of each run."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from controllers.arrays import Array
from controllers.interfaces import Measurement
from twin.base.errors import plural
from twin.base.jobs import cores, results
from twin.run.assemble import assemble
from twin.run.loop import drive
from twin.run.metrics import Ending, Motion, Outcome, measure
from twin.run.record import Recorder
from twin.thesis.chapter8_tables import CONTROL_PERIOD_S, SimulatedRow, SimulatedTable, tables
from twin.thesis.columns import THESIS_COLUMNS

COMPUTED_WAYS = ("exact", "sampled", "mujoco")
"""Values of a cell: the stored one, and those of the two plants of ``SimulatedRow.scenario``."""


def judge(row: SimulatedRow, motion: Motion, off: Array, start: float) -> dict[str, list[float]]:
    """A row's columns for one run that lasted; of t_ss also the values of the bands' ends.

    Args:
        row: The row.
        motion: What the run did.
        off: State less estimate, shape (K, 8).
        start: Time in s from which steady tracking is evaluated.
    """
    last = float(motion.time[-1])
    found = [
        measure(motion, Outcome(Ending.FINISHED, last), start=start, band_percent=band)
        for band in row.bands
    ]
    values = dict(found[0])
    values |= {f"x{state + 1}_error": np.sqrt((off[:, state] ** 2).mean()) for state in range(4)}
    # beyond the end, in % of it
    values["overshoot_percent"] = max(0.0, 100 * (motion.ball[:, 0].max() / motion.ball[-1, 0] - 1))
    settled = [last if each["settling_time"] is None else each["settling_time"] for each in found]
    return {
        column: settled
        if column == "t_ss"
        else [float(values[THESIS_COLUMNS[column].metric or column])]
        for column in row.cells
    }


RowId = tuple[str, int]
"""Number of the table and index of the row."""
FIGURE_STEP = 0.02
"""Seconds between the points that figures are drawn through."""


class ReproductionJob(NamedTuple):
    """Rows that are simulated as one batch.

    Attributes:
        way: "sampled" or "mujoco".
        places: The rows.
        cost: Simulated seconds of all its runs together.
    """

    way: str
    places: tuple[RowId, ...]
    cost: float


class RowResult(NamedTuple):
    """Result of one simulation of a row.

    Attributes:
        place: Number of the table and index of the row.
        way: How it was simulated.
        values: Column to the values of all runs; none if one ended early.
        ended: Why a run ended early, in words; empty if all lasted.
        excerpt: The first run until it ended, some instants of it, for a figure: ``time`` in s,
            shape (K,), ``state`` and ``estimate``, (K, 8), ``applied`` accelerations, (K, 2), and
            ``reference`` in m, (K, 2).
    """

    place: RowId
    way: str
    values: dict[str, list[float]]
    ended: str
    excerpt: Mapping[str, Array]


Results = Mapping[tuple[RowId, str], RowResult]


def plan(wanted: Iterable[SimulatedTable]) -> list[ReproductionJob]:
    """The jobs that tables need, the longest first.

    Rows that differ in law and reference only are put together, which is faster than one by one
    and changes nothing: every row has the same noise.
    """
    batches: dict[Any, list[RowId]] = defaultdict(list)
    for table in wanted:
        for index, row in enumerate(table.rows):
            own = {"controller", "reference", "metrics"}
            common = {key: value for key, value in row.setup.items() if key not in own}
            for way in COMPUTED_WAYS[1:]:
                batches[way, json.dumps(common), row.seeds].append((table.id, index))
    jobs = []
    for (way, _, seeds), places in batches.items():
        seconds = tables()[places[0][0]].rows[places[0][1]].setup["duration"]
        jobs.append(ReproductionJob(way, tuple(places), len(places) * seeds * seconds))
    return sorted(jobs, key=lambda job: -job.cost)


def row_results(
    jobs: Sequence[ReproductionJob],
    processes: int | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> Iterator[RowResult]:
    """The results of all jobs' rows, as they come.

    Args:
        jobs: What to do, the longest first.
        processes: On how many processors; None for all.
        progress: Called with the cost of what is done so far.

    Raises:
        TwinError: If a job fails.
    """
    done, count = 0.0, min(processes or cores(), max(1, len(jobs)))
    for cost, found in results(carry_out, ((job.cost, job) for job in jobs), count):
        done += cost
        progress(done)
        yield from found


def carry_out(job: ReproductionJob, period: float = CONTROL_PERIOD_S) -> list[RowResult]:
    """Simulate the rows of a job at a control period in s.

    Raises:
        KeyboardInterrupt: If the user interrupts.
    """
    rows = [tables()[table].rows[index] for table, index in job.places]
    seeds = rows[0].seeds
    scenarios = [row.scenario(job.way, period) for row in rows]
    # the disturbance makes the drives drift, so the rig's sum of all commands goes astray
    rig, controller = assemble(
        [each for each in scenarios for _ in range(seeds)],
        threads=1,
        seeds=[np.random.SeedSequence(0, spawn_key=(run,)) for _ in rows for run in range(seeds)],
        anchor=0.0,
    )

    def from_origin(measurement: Measurement) -> Measurement:
        """The estimate begins where the thesis's does, whatever is measured."""
        controller.start(measurement._replace(y=np.zeros_like(measurement.y)))
        return measurement

    ticks = round(scenarios[0].duration / period) + 1
    keep = ("state", "applied", "estimate")
    record = Recorder(ticks, seeds * len(rows), period, keep=keep)
    outcomes = drive(rig, controller, ticks * period, record, begin=from_origin)
    if any(outcome.interrupted for outcome in outcomes):
        raise KeyboardInterrupt
    desired = controller.reference(record.time)[0].reshape(record.length, -1, 2)
    every = max(1, round(FIGURE_STEP / period))
    found = []
    for at, (place, row, scenario) in enumerate(zip(job.places, rows, scenarios, strict=True)):
        own = range(seeds * at, seeds * (at + 1))
        ended = _early([outcomes[rig] for rig in own])
        values: dict[str, list[float]] = {column: [] for column in row.cells}
        for rig_number in range(0) if ended else own:
            motion = Motion.of(record, desired[:, rig_number], rig_number)
            off = record["state"][:, rig_number] - record["estimate"][:, rig_number]
            for column, more in judge(row, motion, off, scenario.metrics.start).items():
                values[column] += more
        shown = slice(0, np.searchsorted(record.time, outcomes[own[0]].time, "right"), every)
        excerpt = {name: record[name][shown, own[0]].copy() for name in keep}
        excerpt |= {"time": record.time[shown], "reference": desired[shown, own[0]].copy()}
        found.append(RowResult(place, job.way, values, ended, excerpt))
    return found


def _early(outcomes: Sequence[Outcome]) -> str:
    """The runs that ended early, in words; empty if none did."""
    early = sorted((end.time, end.ending) for end in outcomes if end.ending != Ending.FINISHED)
    if not early:
        return ""
    time, ending = early[0]
    of_all = plural(len(outcomes), "run")
    return f"{len(early)} of {of_all} ended early, the first {ending} at {time:.1f} s"
