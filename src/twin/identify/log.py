"""Reads a recorded run: the twin's own Parquet, or CSV with named columns."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from controllers.arrays import Array
from controllers.ballplate import BallPlate
from twin.identify.columns import COLUMNS, LogError, require, scale, split_unit


@dataclass(frozen=True, kw_only=True)
class Log:
    """A recorded run as it was measured, SI units, one entry a row.

    Attributes:
        source: What to call it.
        time: Seconds, shape (K,).
        ball: Measured x and y in m, shape (K, 2).
        plate: Measured phi and theta in rad, shape (K, 2).
        age: Seconds since the ball's position arrived, shape (K,).
        touched: Whether the screen felt the ball, shape (K,).
        command: Commanded plate rates in rad/s from each row on, shape (K, 2); None if unknown.
        model: The ball, which is weighed and measured, not identified.
        own_lag: What the twin's own drives lag behind before any bandwidth limit, s.
        grips: Times in s within which friction may stop a ball, see ``replay``; more than one
            where it is not known.
        true: True x and y in m of a simulated run, shape (K, 2); for checks, never for a fit.
    """

    source: str
    time: Array
    ball: Array
    plate: Array
    age: Array
    touched: NDArray[np.bool_]
    command: Array | None
    model: BallPlate
    own_lag: float
    grips: tuple[float, ...]
    true: Array | None = None


MECHANISM_LAG = 0.0025
"""Lag in s of the mechanism's own servos: fitted to runs of it without a bandwidth limit."""
MECHANISM_GRIP = 0.0248
"""Time constant in s of its rolling contact, (d t) / 2 with solreffriction t = 0.05 s, d = 0.99."""
GRIPS = {"mujoco": (MECHANISM_GRIP,), "lagrange": (0.0,)}
"""What is known of the twin's own plants; of a rig it is not."""


def read(path: Path) -> Log:
    """Read a log.

    Raises:
        LogError: If the file cannot be read, lacks a column, or holds another unit or no numbers.
    """
    if path.is_dir():
        path = path / "run.parquet"
    if not path.is_file():
        raise LogError(f"log {path}: not found; give a run.parquet, its folder, or a CSV file")
    try:
        columns, metadata = _parquet(path) if path.suffix == ".parquet" else _csv(path)
    except (OSError, pa.ArrowException, UnicodeDecodeError, csv.Error) as error:
        raise LogError(f"{path.name}: cannot be read: {error}") from error
    return _log(columns, metadata, path.name)


def _parquet(path: Path) -> tuple[dict[str, Array], dict[str, Any]]:
    table = pq.read_table(path)
    schema = table.schema
    names = [name for name in schema.names if name in COLUMNS or name in ("true_x", "true_y")]
    require(schema.names, path.name)
    if "rig" in schema.names:
        rigs = table["rig"].to_numpy()
        table = table.filter(pa.array(rigs == rigs[0]))
    columns: dict[str, Array] = {}
    for name in names:
        unit = (schema.field(name).metadata or {}).get(b"unit")
        factor = scale(name, unit.decode() if unit else None, path.name) if name in COLUMNS else 1.0
        columns[name] = factor * np.asarray(table[name].to_numpy(), dtype=float)
    raw = (schema.metadata or {}).get(b"ballplate", b"{}")
    return columns, json.loads(raw)


def _csv(path: Path) -> tuple[dict[str, Array], dict[str, Any]]:
    with path.open(newline="", encoding="utf-8-sig") as file:
        rows = csv.reader(file)
        header = [split_unit(cell) for cell in next(rows, [])]
        names = [name for name, _ in header]
        require(names, path.name)
        wanted = [(i, n, scale(n, u, path.name)) for i, (n, u) in enumerate(header) if n in COLUMNS]
        data = [
            [_number(row, i, path.name, name, rows.line_num) for i, name, _ in wanted]
            for row in rows
            if row
        ]
    values = np.array(data, dtype=float).reshape(len(data), len(wanted))
    return {name: values[:, k] * factor for k, (_, name, factor) in enumerate(wanted)}, {}


def _number(row: list[str], index: int, source: str, name: str, line: int) -> float:
    text = row[index].strip() if index < len(row) else ""
    try:
        return float(text) if text else np.nan
    except ValueError:
        raise LogError(f"{source}: line {line}: {name}: '{text}' is not a number") from None


def _log(columns: dict[str, Array], metadata: dict[str, Any], source: str) -> Log:
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
    plant = metadata.get("scenario", {}).get("plant", {})
    period = float(metadata.get("scenario", {}).get("rig", {}).get("period", 0.0))
    given = {key: plant.get("ball", {}).get(key) for key in ("mass", "radius", "inertia")}
    touched = columns.get("touched", np.ones_like(time))
    return Log(
        source=source,
        time=time,
        ball=ball,
        plate=plate,
        age=np.nan_to_num(columns.get("age", np.zeros_like(time))),
        touched=np.nan_to_num(touched) > 0.5,
        command=command,
        model=BallPlate(**{key: value for key, value in given.items() if value is not None}),
        own_lag=period / 2 if plant.get("kind") == "lagrange" else MECHANISM_LAG,
        grips=GRIPS.get(plant.get("kind"), (MECHANISM_GRIP, 0.0)),
        true=pair("true_x", "true_y"),
    )
