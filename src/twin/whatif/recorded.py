"""What really happened about a moment, as a run folder beside those of the futures."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from controllers.arrays import Array
from twin.hal.supervisor import State
from twin.run.finished import versions
from twin.run.record import CHANNELS, Recorder, write_run
from twin.whatif.judge import Usable
from twin.whatif.moment import Moment
from twin.whatif.smooth import path


def columns_of(log: Usable) -> dict[str, Array]:
    """A log as the columns of a record.

    The estimate is the smoothed path, with the encoders' angles and the commanded rates; what was
    requested before the clamps nobody knows.
    """
    ball, velocity = path(log.time, log.samples)
    period = float(np.median(np.diff(log.time)))
    applied = np.diff(log.command, axis=0, prepend=log.command[:1]) / period
    known = {
        "measured": np.stack(
            (log.ball[:, 0], log.plate[:, 0], log.ball[:, 1], log.plate[:, 1]), axis=1
        ),
        "age": log.age[:, None],
        "touched": log.touched[:, None],
        "estimate": np.stack(
            [
                values[:, axis]
                for axis in (0, 1)
                for values in (ball, velocity, log.plate, log.command)
            ],
            axis=1,
        ),
        "requested": np.full_like(applied, np.nan),
        "applied": applied,
        "supervisor": np.full((len(log.time), 1), float(State.RUNNING)),
    }
    found = {"time": log.time}
    for name, values in known.items():
        found |= dict(zip(CHANNELS[name].columns, values.T, strict=True))
    return found


def save_recorded(moment: Moment, begin: float, end: float, folder: Path) -> None:
    """Write what was recorded from one time in s to another as a run folder.

    Raises:
        RecordError: If it cannot be written.
    """
    time = moment.columns["time"]
    shown = (time > begin - 1e-9) & (time < end + 1e-9)
    rows = {name: values[shown] for name, values in moment.columns.items()}
    state = [name for each in CHANNELS.values() for name in each.columns]
    plant = tuple(name for name in rows if name not in {"time", "rig", *state})
    record = Recorder(int(shown.sum()), 1, moment.scenario.rig.period, plant)
    record.begin_with(rows)
    part = {"of": moment.name, "at": moment.at, "recorded": True}
    scenario = moment.scenario.model_dump(mode="json")
    metadata = {"scenario": scenario, "versions": versions(), "branch": part}
    write_run(folder, record, metadata)
