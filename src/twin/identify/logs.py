"""Logs of runs, and of files with columns of the same names, as a rig measured them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array, Mask
from controllers.ballplate import BallPlate
from twin.base.data_file import read_tables
from twin.base.errors import LogError
from twin.base.shipped import shipped_in
from twin.identify.balls import ball_inertia
from twin.run.files import is_record, log_file
from twin.run.logs import COLUMN_UNITS, NEEDED_COLUMNS, SECOND_AXIS_COLUMNS, read_columns
from twin.sim.plant.rim import UNLIMITED_REACH, Reach

MORE_COLUMNS = ("age", "touched", "applied_phi_acc", "applied_theta_acc", "lateness")
RATE_COLUMNS = ("applied_phi_rate", "applied_theta_rate")
LOG_COLUMN_UNITS = {
    name: COLUMN_UNITS[name] for name in (*NEEDED_COLUMNS, *MORE_COLUMNS)
} | dict.fromkeys(RATE_COLUMNS, "rad/s")
"""Columns that are read from a run or a log, and their SI units; it may have more."""
MECHANISM_LAG = 0.0025
"""Lag in s of the mechanism's own servos: fitted to runs of it without a bandwidth limit."""
MECHANISM_GRIP = 0.0248
"""Time constant in s of its rolling contact, (d t) / 2 with solreffriction t = 0.05 s, d = 0.99."""
PLANT_GRIPS = {"mujoco": (MECHANISM_GRIP,), "lagrange": (0.0,)}
"""What is known of the twin's own plants; of a rig it is not."""


@dataclass(frozen=True, kw_only=True)
class Log:
    """A recorded run as it was measured, in SI units, one entry per row.

    Attributes:
        source: Its name in messages.
        time: Seconds, shape (K,).
        ball: Measured x and y in m, shape (K, 2).
        plate: Measured phi and theta in rad, shape (K, 2).
        age: Seconds since the ball's position arrived, shape (K,).
        touched: Whether the screen detected the ball, shape (K,).
        command: Commanded plate rates in rad/s from each row on, shape (K, 2); None if unknown.
        model: The ball, which is weighed and measured, not identified.
        own_lag: Lag in s of the twin's own drives without a bandwidth limit.
        grips: Times in s within which friction may stop a ball, see ``replay``; more than one
            where it is not known.
        late: How long after its time each row was taken, s, shape (K,); None if unknown.
        axes: Number of axes of the rig; of 1 the second is 0 everywhere.
        walls: How far walls let the ball go.
        scenario: What a run of this program was started with; empty for any other log.
    """

    source: str
    time: Array
    ball: Array
    plate: Array
    age: Array
    touched: Mask
    command: Array | None
    model: BallPlate
    own_lag: float
    grips: tuple[float, ...]
    late: Array | None = None
    axes: int = 2
    walls: Reach = UNLIMITED_REACH
    scenario: Mapping[str, Any] = field(default_factory=dict)

    def with_ball(self, factor: float) -> Log:
        """This log with a different ball, given by the share of gravity that accelerates it.

        Raises:
            LogError: If it is a run, which knows its ball.
        """
        if self.scenario:
            raise LogError(f"{self.source}: --ball: not allowed; a run states its ball")
        inertia = ball_inertia(self.model.mass, self.model.radius, factor)
        return replace(self, model=replace(self.model, inertia=inertia))

    @property
    def columns(self) -> dict[str, Array]:
        """Its columns by their names in ``LOG_COLUMN_UNITS``, shape (K,) each."""
        pairs = {
            NEEDED_COLUMNS[1::2]: self.ball,
            NEEDED_COLUMNS[2::2]: self.plate,
            RATE_COLUMNS: self.command,
        }
        found = {"time": self.time, "age": self.age, "touched": self.touched.astype(float)}
        for names, values in pairs.items():
            if values is not None:
                found |= dict(zip(names, values.T, strict=True))
        return found

    def rows(self, chosen: Mask | NDArray[np.intp] | slice) -> Log:
        """Some of its rows."""
        names = ("time", "ball", "plate", "age", "touched", "command", "late")
        every = {name: getattr(self, name) for name in names}
        return replace(self, **{k: v[chosen] for k, v in every.items() if v is not None})


def read(path: Path) -> Log:
    """Read a log: a run folder, a Parquet file or a CSV file.

    Raises:
        LogError: If the file cannot be read, lacks a column, or has a wrong unit or no numbers.
    """
    path = log_file(path)
    run = path.resolve().parent.name
    source = f"{run}/{path.name}" if is_record(path) else path.name
    return of_columns(*read_columns(path, LOG_COLUMN_UNITS, NEEDED_COLUMNS), source)


def of_columns(columns: Mapping[str, Array], metadata: dict[str, Any], source: str) -> Log:
    """A log of columns in SI units.

    Args:
        columns: Of ``LOG_COLUMN_UNITS``, shape (K,) each; those that are required are there.
            Without those of the second axis it is of a rig of one axis.
        metadata: Of the run, with its scenario; empty for a log that is no run.
        source: What the log is called.

    Raises:
        LogError: If the metadata are not those of a run.
    """

    def pair(first: str, second: str) -> Array | None:
        if first not in columns or (second not in columns and axes == 2):
            return None
        return np.stack((columns[first], columns.get(second, nothing)), axis=-1)

    time = columns["time"]
    nothing = np.zeros_like(time)
    try:
        rig = _rig(metadata)
    except (AttributeError, TypeError, ValueError):
        raise LogError(f"{source}: its metadata is not of a run") from None
    if SECOND_AXIS_COLUMNS[0] not in columns:
        rig["axes"] = 1
    axes = rig["axes"]
    ball, plate = pair("measured_x", "measured_y"), pair("measured_phi", "measured_theta")
    assert ball is not None
    assert plate is not None
    command = pair(*RATE_COLUMNS)
    acceleration = pair("applied_phi_acc", "applied_theta_acc")
    if command is None and acceleration is not None and len(time) > 1:
        period = float(np.nanmedian(np.diff(time)))
        command = period * np.cumsum(np.nan_to_num(acceleration), axis=0)
    touched = columns.get("touched", np.ones_like(time))
    return Log(
        source=source,
        time=time,
        ball=ball,
        plate=plate,
        age=np.nan_to_num(columns.get("age", np.zeros_like(time))),
        touched=np.nan_to_num(touched) > 0.5,
        command=command,
        late=columns.get("lateness"),
        scenario=metadata.get("scenario") or {},
        **rig,
    )


def _rig(metadata: dict[str, Any]) -> dict[str, Any]:
    """The ball in a run's metadata and, if it was simulated, the plant."""
    scenario = metadata.get("scenario", {})
    plant = scenario.get("plant", {})
    period = float(scenario.get("rig", {}).get("period", 0.0))
    ball = {key: plant.get("ball", {}).get(key) for key in ("mass", "radius", "inertia")}
    ball["height"] = plant.get("plate", {}).get("height")
    model = BallPlate(**{key: float(v) for key, v in ball.items() if v is not None})
    between = plant.get("rim", {}).get("size", (0.0, 0.0))
    return {
        "model": model,
        "axes": int(plant.get("axes", 2)),
        "walls": Reach.of(between, model.radius, plant.get("shape", "")),
        "own_lag": period / 2 if plant.get("kind") == "lagrange" else MECHANISM_LAG,
        "grips": PLANT_GRIPS.get(plant.get("kind"), (MECHANISM_GRIP, 0.0)),
    }


def rig_of(scenario: Mapping[str, Any]) -> str:
    """Name of the shipped rig with the plate and ball of a run; empty if there is none."""
    plant = scenario.get("plant", {})
    for name, path in shipped_in("rigs").items():
        own = read_tables(path, name)["plant"]
        ball = plant.get("ball", {})
        if own["size"] == plant.get("size") and own["ball"].items() <= ball.items():
            return name
    return ""
