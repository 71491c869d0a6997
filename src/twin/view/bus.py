"""What was said on the bus of a run, on the time line of its record."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import rerun as rr

from controllers.arrays import Array
from twin.devices.akd import TRACE
from twin.devices.akd.decoding import TARGET, Conversation
from twin.devices.akd.traces import read_trace
from twin.run.finished import Run
from twin.view.streams import RUNS, Batch, line

UNITS = {"rad/s": "bus_rad_per_s", "rad": "bus_rad"}
"""Plots of what PDOs carry, by its unit."""
PAUSED = 1.0
"""Time in s by which pauses may part trace and record; from there on more is missing in it."""


def conversation(run: Run) -> Conversation | None:
    """What was said in a run; None where no trace lies in its folder."""
    trace = run.folder and run.folder / TRACE
    return Conversation(read_trace(trace).frames) if trace and trace.is_file() else None


def on_record(said: Conversation, run: Run, time: Array) -> Array:
    """Times of a trace as times of its record, both in s.

    The first command that is not zero is the same in both, and each row has a SYNC.
    """
    begun = [s.time[k] for (_, key), s in said.series.items() if key[0] == TARGET
             for k in np.flatnonzero(s.counts)[:1]]  # fmt: skip
    moves = [np.flatnonzero(run.rows[f"applied_{axis}_acc"])[:1] for axis in ("phi", "theta")]
    first = min((int(each[0]) for each in moves if len(each)), default=0)
    rows, sync = run.rows["time"][first:], np.asarray(said.sync)
    sync = sync[np.searchsorted(sync, min(begun, default=0.0)) :][: len(rows)]
    if not len(sync):
        return time
    rows = rows[: len(sync)]
    alike = np.abs(rows - rows[0] - (sync - sync[0])) < PAUSED
    last = len(rows) if alike.all() else int(np.argmin(alike))
    at = np.clip(np.searchsorted(sync, time, side="right") - 1, 0, last - 1)
    found: Array = rows[at] + time - sync[at]
    return found


def batches(
    root: str, run: Run, said: Conversation
) -> Iterator[tuple[Batch, rr.AsComponents | None]]:
    """What PDOs carried of the motors, in SI units, and what was said, with how it is drawn."""
    for number, ((node, key), series) in enumerate(sorted(said.series.items())):
        factor, unit = said.scale(node, key)
        if unit in UNITS:
            entity = f"{root}/{UNITS[unit]}/node_{node}_{key[0]:04X}"
            shown = rr.Scalars.columns(scalars=factor * np.asarray(series.counts))
            style = line(
                RUNS[number % len(RUNS)], 1.0, f"{said.called(node)} {said.object_name(key)}"
            )
            yield Batch(entity, on_record(said, run, np.asarray(series.time)), shown), style
    times = on_record(said, run, np.array([each.time for each in said.events]))
    lines = rr.TextLog.columns(
        text=[f"{each.who}, {each.kind}: {each.text}" for each in said.events],
        level=["ERROR" if each.kind == "EMCY" else "INFO" for each in said.events],
    )
    yield Batch(f"{root}/bus", times, lines), None
