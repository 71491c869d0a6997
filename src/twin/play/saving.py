"""What was driven as a run folder: a run like any other, that says what a person did."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from controllers.arrays import Array
from twin.hal.rig import Entry
from twin.play.driven import LATER, Driven, Kept
from twin.run.finished import Run, save
from twin.run.loop import Outcome
from twin.run.record import Recorder
from twin.run.state import MOST, Snapshot


class Part(NamedTuple):
    """What was driven until now, as it is handed to whoever writes it.

    Attributes:
        driven: By the person.
        outcome: How it ended.
        rows: The record's columns by name, shape (K,) each.
        plant: Names of the plant's own columns.
        snapshots: States to go on from.
        journal: Conditions that were detected.
        factor: Simulated seconds a second of the clock.
    """

    driven: Driven
    outcome: Outcome
    rows: Mapping[str, Array]
    plant: tuple[str, ...]
    snapshots: tuple[Snapshot, ...]
    journal: tuple[Entry, ...]
    factor: float


Write = Callable[[Part, Path], None]


def rows_of(record: Recorder) -> dict[str, Array]:
    """A copy of what was recorded, column by column."""
    rows = {name: values.copy() for name, _, values in record.columns()}
    return {"time": record.time.copy(), **rows}


def worth_keeping(states: Sequence[Kept]) -> tuple[Snapshot, ...]:
    """The states that a record keeps: each since which it says all that was done, and some more."""
    acted = {each.time: each.rig for each in states if each.acted}
    calm = [each for each in states if each.time and not each.acted]
    apart = max(LATER, calm[-1].time / MOST) if calm else LATER
    last = 0.0
    for each in calm:
        if each.time >= last + apart - 1e-9:
            last = each.time
            acted[each.time] = each.rig
    return tuple(acted[time] for time in sorted(acted))


def save_driven(part: Part, folder: Path) -> None:
    """Write a run folder of what was driven.

    Raises:
        RecordError: If it cannot be written.
    """
    time = part.rows["time"]
    driven = part.driven
    period = driven.scenario.rig.period
    scenario = driven.recorded(period * round(float(time[-1]) / period + 1))
    record = Recorder(len(time), 1, period, part.plant)
    record.begin_with(part.rows)
    done = Run.of(
        scenario,
        record,
        part.outcome,
        real_time_factor=part.factor,
        journal=part.journal,
        snapshots=part.snapshots,
        driven=driven.as_dict(),
    )
    save(done, folder, {"driven by hand": done.motion})
