"""Tables 8.1 to 8.21, which the thesis simulated: run again, with every cell next to the thesis's.

A row is a scenario: what the data files say is laid over ``IDEAL``. *sampled* runs it on the
equations (5.9), *mujoco* on the mechanism without rolling friction, both at 2 ms through the seam.
*exact* is the same under continuous control, integrated once by commit eda4a26 and kept as data:
full state feedback by LSODA at a relative tolerance of 1e-9; plant, observer in continuous time,
dead time and held noise together by RK4 at 10 ms.
"""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple

import numpy as np

from controllers.arrays import Array, Mask
from controllers.interfaces import Measurement
from twin.base.data_file import read_packaged
from twin.base.errors import plural
from twin.base.jobs import cores, results
from twin.hal.cams import FixedRatio
from twin.hal.interface import Transmission
from twin.run.assemble import assemble
from twin.run.loop import drive
from twin.run.metrics import Ending, Motion, Outcome, measure
from twin.run.plants import PlantKind, register
from twin.run.record import Recorder
from twin.scenario.load import check
from twin.scenario.merging import merge_tables, put
from twin.scenario.schema import Scenario
from twin.sim.plant.exact import ExactPlant
from twin.sim.plant.interface import Plant

TOLERANCES_PERCENT = {"full_state": 4.0, "observers": 5.0, "tracking": 5.0}
"""Data file to the deviation in % that a value may have from the thesis's."""
COMPUTED_WAYS = ("exact", "sampled", "mujoco")
CONTROL_PERIOD_S = 0.002
FINE_STEP_S, COARSE_STEP_S = 0.0005, 0.002
"""Physics steps of the mechanism in s: the steady errors of full state feedback, 0.1 mm and less,
shrink with the step; with noise nothing changes by more than 0.01 % between 0.5 and 2 ms."""
PACKAGE_NAME = "twin.thesis"
IDEAL_RIG = read_packaged(PACKAGE_NAME, "data/ideal.toml")
"""A rig with the imperfections that a row gives, and no others; nothing saturates."""


class Reason(StrEnum):
    """Why a cell is known not to agree with the thesis, the weakest reason first.

    UNEXPLAINED: no reason is known. FITTED: a reason that was fitted to the cell afterwards, which
    the thesis's text does not give. NOT_GIVEN: the cell depends on a number that the thesis does
    not give. COPIED: the cell repeats a number of a different table. ARTEFACT: an artefact of the
    thesis's computation, shown by computing it.
    """

    UNEXPLAINED = "unexplained"
    FITTED = "fitted"
    NOT_GIVEN = "not given"
    COPIED = "copied"
    ARTEFACT = "artefact"


REASON_WORDS = {
    Reason.UNEXPLAINED: "unexplained",
    Reason.FITTED: "with a reason that was fitted to them afterwards",
    Reason.NOT_GIVEN: "that depend on numbers which the thesis does not give",
    Reason.COPIED: "that repeat the numbers of another table",
    Reason.ARTEFACT: "by an artefact of the thesis's computation",
}
"""The reasons in words, behind a number of cells."""


class Disagreement(NamedTuple):
    """Why a cell is known not to agree, as the data file has it.

    Attributes:
        because: What kind of reason there is.
        note: In words.
    """

    because: Reason
    note: str


@dataclass(frozen=True, kw_only=True)
class SimulatedRow:
    """A row: one simulation of the thesis.

    Attributes:
        name: What distinguishes it from the table's other rows.
        detail: Its settings in words.
        setup: The tables of its scenario, without those of ``IDEAL``.
        seeds: Number of runs that differ in their noise.
        bands: Settling band in %, then the narrowest and the widest it may have been read with.
        cells: Column to the thesis's value.
        notes: Column to a remark on the cell.
        causes: Column to what made the thesis's values of this kind inexact.
        exceptions: Column to why this cell is known not to agree.
    """

    name: str
    detail: str = ""
    setup: Mapping[str, Any]
    seeds: int
    bands: Sequence[float]
    cells: Mapping[str, float]
    notes: Mapping[str, str] = field(default_factory=dict)
    causes: Mapping[str, str]
    exceptions: Mapping[str, Disagreement] = field(default_factory=dict)

    def scenario(self, way: str, period: float = CONTROL_PERIOD_S) -> Scenario:
        """What runs, on the plant of ``sampled`` or ``mujoco``, at a control period in s."""
        mechanism = way == "mujoco"
        step = COARSE_STEP_S if "disturbance" in self.setup else FINE_STEP_S
        settings = {
            "plant.kind": "mujoco" if mechanism else "endless",
            "plant.ball_spin": "free" if mechanism else "thesis",
            "plant.step": min(step, period) if mechanism else period,
            "rig.period": period,
        }
        return check(put(merge_tables(IDEAL_RIG, self.setup), settings.items()), self.name)


@dataclass(frozen=True, kw_only=True)
class SimulatedTable:
    """A table of the thesis.

    Attributes:
        id: Its number.
        title: Its subject.
        group: The data file it stands in.
        bound: Deviation in % that a value may have.
        shared: How all tables of the group were made, as far as that was found out.
        own: How this one was made.
        rows: Its rows.
    """

    id: str
    title: str
    group: str
    bound: float
    shared: tuple[str, ...]
    own: tuple[str, ...]
    rows: tuple[SimulatedRow, ...]


@cache
def tables() -> dict[str, SimulatedTable]:
    """All tables by number, in the thesis's order."""
    found = {}
    for group, bound in TOLERANCES_PERCENT.items():
        content = read_packaged(PACKAGE_NAME, f"data/{group}.toml")
        for entry in content["table"]:
            common = {
                "seeds": content.get("seeds", 1),
                "bands": entry.get("bands", (5.0,)),
                "causes": {**content.get("causes", {}), **entry.get("causes", {})},
            }
            setup = merge_tables(content["setup"], entry.get("setup", {}))
            found[entry["id"]] = SimulatedTable(
                id=entry["id"],
                title=entry["title"],
                group=group,
                bound=bound,
                shared=tuple(content["remarks"]),
                own=tuple(entry.get("remarks", ())),
                rows=tuple(_row(common | row, setup) for row in entry["row"]),
            )
    return dict(sorted(found.items(), key=lambda item: int(item[0].split(".")[1])))


def _row(about: Mapping[str, Any], setup: Mapping[str, Any]) -> SimulatedRow:
    """A row of a data file, over the setup of its table."""
    exceptions = {
        column: Disagreement(Reason(each["because"]), each["note"])
        for column, each in about.get("exceptions", {}).items()
    }
    own = {"setup": merge_tables(setup, about.get("setup", {})), "exceptions": exceptions}
    return SimulatedRow(**{**about, **own})


@cache
def read_stored(chapter: str) -> dict[str, Any]:
    """Results computed once for a chapter and kept next to its tables.

    ``chapter_8``: table, row and column to the values under continuous control, one, or with its
    range; ``fitted`` of a row is a second reading of the thesis, in words. ``chapter_9``:
    what ``ballplate fit chapter_9`` found: parameters, correlation, of every search its end with
    all tables and without each, and what docs/chapter9.py finds of its goals.
    """
    return json.loads((files(PACKAGE_NAME) / f"data/{chapter}.json").read_bytes())


@dataclass(frozen=True, kw_only=True)
class ThesisColumn:
    """A column of the thesis's tables.

    Attributes:
        label: Its quantity, as the thesis calls it.
        unit: Its unit.
        compared: "value" against the bound, "reading" against a value read by eye from a figure,
            "noise" against the range of the seeds.
        zero: Absolute bound where the thesis prints 0.
        metric: The indicator of ``twin.run.metrics`` that it is; empty for one of its own.
    """

    label: str
    unit: str
    compared: str = "value"
    zero: float = 0.0
    metric: str = ""

    @property
    def name(self) -> str:
        """Label and unit."""
        return f"{self.label} [{self.unit}]"


THESIS_COLUMNS = {
    name: ThesisColumn(**about)
    for name, about in read_packaged(PACKAGE_NAME, "data/columns.toml").items()
}
"""The columns of this chapter and the next by the names the data files use.

The "average tracking error" is not (C.4), but a root mean square over the run. e_tt (C.7) and the
"max. steady tracking error" are taken from ``metrics.start`` on.
"""


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


class EndlessPlate(ExactPlant):
    """The equations as the thesis simulates them: its plate has no edge."""

    @property
    def on_plate(self) -> Mask:
        """Always, shape (N,)."""
        return np.ones(self.rigs, bool)


def _endless(scenarios: Sequence[Scenario], _: int) -> tuple[Plant, Transmission]:
    plant = scenarios[0].plant
    endless = EndlessPlate(rigs=len(scenarios), step=plant.step, ball_spin=plant.ball_spin)
    return endless, FixedRatio()


register("endless", PlantKind(_endless, "equations of the thesis", least=2))


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
        for rig_number in () if ended else own:
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


WORTH_A_NOTE = 1.0
"""Deviation in % from which a cause of inexact values is named."""


class Agreement(StrEnum):
    """Whether a cell agrees with the thesis.

    AGREES: within its bound. EXCEPTION: not, and it is noted among those that do not, with its
    ``Reason`` or with none. DIFFERS: not, and it is not noted.
    """

    AGREES = "agrees"
    EXCEPTION = "exception"
    DIFFERS = "differs"


class Value(NamedTuple):
    """A computed cell: its value, and the range of the seeds or of the reading, if there is one."""

    value: float
    range: tuple[float, float] | None = None

    def deviation(self, thesis: float) -> float | None:
        """Percent from the thesis's value; None where that is 0."""
        return 100 * (self.value / thesis - 1) if thesis else None


@dataclass(frozen=True, kw_only=True)
class ThesisCell:
    """A numeric cell of the thesis and its value here.

    Attributes:
        table: The table's number.
        row: The row's name.
        column: The column's key in ``THESIS_COLUMNS``.
        thesis: The thesis's value.
        exact: Equations (5.9), continuous control, as kept.
        sampled: Equations (5.9), sampled loop through the seam; None if it ended early.
        mujoco: The mechanism without rolling friction, through the seam; None if it ended early.
        note: What is known of the cell.
        verdict: Whether exact and sampled value agree with the thesis's.
        because: What kind of reason an exception has; None for other cells.
    """

    table: str
    row: str
    column: str
    thesis: float
    exact: Value
    sampled: Value | None
    mujoco: Value | None
    note: str
    verdict: Agreement
    because: Reason | None = None

    @property
    def mark(self) -> str:
        """Of a cell that does not agree: (!) with a reason, !! without."""
        if self.verdict is Agreement.AGREES:
            return ""
        return "!!" if self.because in {None, Reason.UNEXPLAINED} else "(!)"

    @property
    def deviation_percent(self) -> float | None:
        """Deviation of the exact value from the thesis's in %."""
        return self.exact.deviation(self.thesis)

    def as_dict(self) -> dict[str, Any]:
        """The ``--json`` form of a cell."""
        found: dict[str, Any] = {
            "table": self.table,
            "row": self.row,
            "column": THESIS_COLUMNS[self.column].name,
            "thesis": self.thesis,
            "deviation_percent": self.deviation_percent,
            "note": self.note,
            "verdict": self.verdict.value,
            "because": self.because and self.because.value,
        }
        for way in COMPUTED_WAYS:
            value: Value | None = getattr(self, way)
            found[way] = value and value.value
            if value and value.range:
                found[f"{way}_range"] = list(value.range)
        return found


def compare(wanted: Iterable[SimulatedTable], found: Results) -> list[ThesisCell]:
    """Every cell of the tables."""
    return [
        _cell(table, index, column, found)
        for table in wanted
        for index, row in enumerate(table.rows)
        for column in row.cells
    ]


def _cell(table: SimulatedTable, index: int, column: str, found: Results) -> ThesisCell:
    row = table.rows[index]
    thesis, known = row.cells[column], read_stored("chapter_8")[table.id][row.name]
    exact, *span = known[column]
    mine = {way: found[(table.id, index), way] for way in COMPUTED_WAYS[1:]}
    values = {way: _value(result.values[column], column) for way, result in mine.items()}
    of_exact = Value(exact, (span[0], span[1]) if span else None)
    agrees = all(_agrees(v, thesis, column, table.bound) for v in (of_exact, values["sampled"]))
    known_not_to = row.exceptions.get(column)
    remarks = [row.notes.get(column), known_not_to and known_not_to.note]
    deviation = of_exact.deviation(thesis)
    if deviation is not None and abs(deviation) > WORTH_A_NOTE and not known_not_to:
        remarks.append(row.causes.get(column))
    if not agrees and THESIS_COLUMNS[column].compared == "noise":
        remarks.append("Outside the 5 to 95 % range.")
    if column == "e_tt":
        remarks.append(known["fitted"])
    remarks += [f"{way}: {result.ended}." for way, result in mine.items() if result.ended]
    differs = Agreement.EXCEPTION if known_not_to else Agreement.DIFFERS
    return ThesisCell(
        table=table.id,
        row=row.name,
        column=column,
        thesis=thesis,
        exact=of_exact,
        **values,
        note=" ".join(filter(None, remarks)),
        verdict=Agreement.AGREES if agrees else differs,
        because=known_not_to.because if known_not_to and not agrees else None,
    )


def _value(values: list[float], column: str) -> Value | None:
    """One value of all runs of a row."""
    if not values:
        return None
    if THESIS_COLUMNS[column].compared == "reading":
        return Value(values[0], (min(values), max(values)))
    if len(values) == 1:
        return Value(values[0])
    low, middle, high = np.quantile(values, (0.05, 0.5, 0.95)).tolist()
    return Value(middle, (low, high))


def _agrees(value: Value | None, thesis: float, column: str, bound: float) -> bool:
    if value is None:
        return False
    kind = THESIS_COLUMNS[column]
    if kind.compared != "value" and value.range is not None:
        low, high = value.range
        if low <= thesis <= high:
            return True
        if kind.compared == "reading":
            return False
    deviation = value.deviation(thesis)
    return value.value <= kind.zero if deviation is None else abs(deviation) <= bound


CHAPTER8_HEADINGS = (
    "row",
    "quantity",
    "thesis",
    "exact",
    "sampled",
    "MuJoCo",
    "exact − thesis",
    "",
)
DEVIATION_STEPS_PERCENT = (1.0, 2.0, 4.0, 5.0)
"""Deviations in % by which cells are counted."""


def format_computed(value: Value | None) -> str:
    """A computed value in the digits worth reading, with its range."""
    if value is None:
        return "-"
    if value.range is None or value.range[1] - value.range[0] < 1e-3 * value.value:
        return f"{value.value:.5g}"
    low, high = value.range
    return f"{value.value:.4g} ({low:.3g} to {high:.3g})"


def lines(cells: Iterable[ThesisCell]) -> tuple[list[tuple[str, ...]], list[str]]:
    """A table's cells under ``HEADINGS``, each row named once, and the numbered notes.

    Notes that differ only in the value of a fitted reading are one note, with the values in the
    order of the cells.
    """
    notes: dict[str, list[str]] = {}
    found: list[tuple[str, ...]] = []
    last = ""
    for cell in cells:
        off = cell.deviation_percent
        mark = cell.mark
        if cell.note:
            text, *values = split_note(cell.note)
            notes.setdefault(text, []).extend(values)
            mark = f"{mark} [{list(notes).index(text) + 1}]"
        found.append(
            (
                "" if cell.row == last else cell.row,
                THESIS_COLUMNS[cell.column].name,
                f"{cell.thesis:.5g}",
                *(format_computed(getattr(cell, way)) for way in COMPUTED_WAYS),
                "-" if off is None else f"{off:+.1f} %",
                mark.strip(),
            )
        )
        last = cell.row
    numbered = enumerate(notes.items(), start=1)
    return found, [f"[{number}] {join_note(text, values)}" for number, (text, values) in numbered]


def split_note(note: str) -> list[str]:
    """The text of a note and, if it ends with the value of a fitted reading, that value."""
    found = re.fullmatch(r"(.*Exact with [^:]*): ([^ ]+(?: \([^)]*\))?)\.", note)
    return [found[1], found[2]] if found else [note]


def join_note(text: str, values: Sequence[str]) -> str:
    """A note with its values."""
    return f"{text}: {', '.join(values)}." if values else text


def summary(cells: Sequence[ThesisCell]) -> dict[str, Any]:
    """How many cells agree how well.

    Cells with noise are evaluated by the range of the seeds; the worst is sought among the others
    that agree.
    """
    plain = [
        (abs(cell.deviation_percent), cell)
        for cell in cells
        if cell.deviation_percent is not None and THESIS_COLUMNS[cell.column].compared == "value"
    ]
    agreeing = [each for each in plain if each[1].verdict is Agreement.AGREES]
    worst = max(agreeing, key=lambda each: each[0], default=None)
    return {
        "cells": len(cells),
        "values": len(plain),
        "within": {step: sum(off <= step for off, _ in plain) for step in DEVIATION_STEPS_PERCENT},
        "worst": worst and worst[1],
        **{kind.value: sum(cell.verdict is kind for cell in cells) for kind in Agreement},
        "disagree": sum(cell.verdict is not Agreement.AGREES for cell in cells),
        "because": {kind.value: sum(cell.because is kind for cell in cells) for kind in Reason},
    }


def sentence(cells: Sequence[ThesisCell]) -> str:
    """The summary in one line."""
    found = summary(cells)
    within = ", ".join(f"{count} within {step:g} %" for step, count in found["within"].items())
    why = [f"{found['because'][kind]} {words}" for kind, words in REASON_WORDS.items()]
    why = [each for each in why if not each.startswith("0 ")]
    if found["differs"]:
        why.insert(0, f"{found['differs']} new, not noted so far")
    text = f"{plural(found['cells'], 'cell')}: {found['agrees']} agree, {found['disagree']} do not"
    text += f" ({', '.join(why)}). " if why else ". "
    text += f"Of {plural(found['values'], 'value')} without spread {within}"
    worst: ThesisCell | None = found["worst"]
    if worst is None:
        return f"{text}."
    where = f"Table {worst.table}, {worst.row}, {THESIS_COLUMNS[worst.column].name}"
    return f"{text}; the worst that agrees: {worst.deviation_percent:+.2f} % ({where})."
