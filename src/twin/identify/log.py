"""Reads a recorded run: the twin's own Parquet, or CSV with named columns.

A header may give a column's unit, as ``measured_x [mm]``; without one it is the SI unit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array, Mask
from controllers.ballplate import BallPlate
from twin.data_file import read_toml
from twin.errors import LogError
from twin.run.files import is_record, log_file
from twin.run.logs import read_columns


@dataclass(frozen=True)
class LogColumn:
    """A column that a log may have.

    Attributes:
        unit: Its SI unit.
        meaning: What it holds.
        required: Whether a log must have it.
    """

    unit: str
    meaning: str
    required: bool = False


_TABLES = read_toml(Path(__file__).with_suffix(".toml"))
COLUMNS = {name: LogColumn(**about) for name, about in _TABLES.items()}
"""What ``identify`` reads; a log may have more columns."""
UNITS = {name: column.unit for name, column in COLUMNS.items()}
NEEDED = tuple(name for name, column in COLUMNS.items() if column.required)

MECHANISM_LAG = 0.0025
"""Lag in s of the mechanism's own servos: fitted to runs of it without a bandwidth limit."""
MECHANISM_GRIP = 0.0248
"""Time constant in s of its rolling contact, (d t) / 2 with solreffriction t = 0.05 s, d = 0.99."""
GRIPS = {"mujoco": (MECHANISM_GRIP,), "lagrange": (0.0,)}
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
    scenario: Mapping[str, Any] = field(default_factory=dict)

    def with_ball(self, factor: float) -> Log:
        """That of another ball, by the share of gravity that accelerates it.

        Raises:
            LogError: If it is a run, which knows its ball.
        """
        if self.scenario:
            raise LogError(f"{self.source}: --ball: a run knows its ball")
        inertia = self.model.mass * self.model.radius**2 * (1 / factor - 1)
        return replace(self, model=replace(self.model, inertia=inertia))

    def rows(self, chosen: Mask | NDArray[np.intp] | slice) -> Log:
        """Some of its rows."""
        names = ("time", "ball", "plate", "age", "touched", "command", "late")
        every = {name: getattr(self, name) for name in names}
        return replace(self, **{k: v[chosen] for k, v in every.items() if v is not None})


def read(path: Path) -> Log:
    """Read a log: a run folder, a Parquet file or a CSV file.

    Raises:
        LogError: If the file cannot be read, lacks a column, or holds another unit or no numbers.
    """
    path = log_file(path)
    run = path.resolve().parent.name
    source = f"{run}/{path.name}" if is_record(path) else path.name
    return of_columns(*read_columns(path, UNITS, NEEDED), source)


def of_columns(columns: Mapping[str, Array], metadata: dict[str, Any], source: str) -> Log:
    """A log of columns in SI units.

    Args:
        columns: Of ``COLUMNS``, shape (K,) each; those that are required are there.
        metadata: Of the run, with its scenario; empty for another log.
        source: What the log is called.

    Raises:
        LogError: If the metadata are not those of a run.
    """

    def pair(first: str, second: str) -> Array | None:
        if first not in columns or second not in columns:
            return None
        return np.stack((columns[first], columns[second]), axis=-1)

    time = columns["time"]
    ball, plate = pair("measured_x", "measured_y"), pair("measured_phi", "measured_theta")
    assert ball is not None
    assert plate is not None
    command = pair("applied_phi_rate", "applied_theta_rate")
    acceleration = pair("applied_phi_acc", "applied_theta_acc")
    if command is None and acceleration is not None and len(time) > 1:
        period = float(np.nanmedian(np.diff(time)))
        command = period * np.cumsum(np.nan_to_num(acceleration), axis=0)
    touched = columns.get("touched", np.ones_like(time))
    try:
        rig = _rig(metadata)
    except (AttributeError, TypeError, ValueError):
        raise LogError(f"{source}: its metadata is not that of a run") from None
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
    """What a run's metadata say of its ball and, if it was simulated, of its plant."""
    scenario = metadata.get("scenario", {})
    plant = scenario.get("plant", {})
    period = float(scenario.get("rig", {}).get("period", 0.0))
    ball = {key: plant.get("ball", {}).get(key) for key in ("mass", "radius", "inertia")}
    return {
        "model": BallPlate(**{key: float(v) for key, v in ball.items() if v is not None}),
        "own_lag": period / 2 if plant.get("kind") == "lagrange" else MECHANISM_LAG,
        "grips": GRIPS.get(plant.get("kind"), (MECHANISM_GRIP, 0.0)),
    }
