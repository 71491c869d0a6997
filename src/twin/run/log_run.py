"""A log of columns as a run under a scenario's reference, to lay over what the twin predicts."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from controllers.arrays import Array
from twin.errors import LogError
from twin.hal.interface import SCREEN
from twin.hal.states import State
from twin.run.csv_columns import read_csv
from twin.run.finished import Run
from twin.run.loop import Ending, Outcome
from twin.run.metrics import Motion, measure
from twin.run.record import CHANNELS
from twin.scenario.schema import Scenario

UNITS = {"time": "s"} | {
    column: unit
    for channel in CHANNELS.values()
    for column, unit in zip(channel.columns, channel.units, strict=True)
}
"""Columns of a run and their SI units; others of a log are left out."""
NEEDED = ("time", *CHANNELS["measured"].columns)
"""Columns that a log must have."""
AXES = ("phi", "theta")
FARTHEST = {
    ("measured_x", "m"): 0.55 * SCREEN[0],
    ("measured_y", "m"): 0.55 * SCREEN[1],
    ("measured_phi", "rad"): 0.26,
    ("measured_theta", "rad"): 0.26,
}
"""Where the screen and the plate's travel end, with a margin."""
NEAR = 1e-3
"""Distance in m up to which a ball starts where its scenario says."""


def read_log(path: Path) -> dict[str, Array]:
    """The columns of a CSV log in SI units.

    Raises:
        LogError: If it cannot be read, lacks a column or a row, or its time does not rise.
    """
    try:
        rows = read_csv(path, UNITS, lambda names: _require(names, path.name))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise LogError(f"{path}: cannot be read: {why}") from error
    kept = np.all([np.isfinite(rows[name]) for name in ("time", *NEEDED[2::2])], axis=0)
    rows = {name: values[kept] for name, values in rows.items()}
    if kept.sum() < 2:
        raise LogError(f"{path.name}: no two rows with a time and both plate angles")
    if not (np.diff(rows["time"]) > 0).all():
        raise LogError(f"{path.name}: time: must rise from row to row")
    if not np.isfinite(rows["measured_x"] + rows["measured_y"]).any():
        raise LogError(f"{path.name}: no row has a position of the ball")
    for (name, unit), most in FARTHEST.items():
        reach = float(np.nanpercentile(np.abs(rows[name]), 99))
        if reach > most:
            raise LogError(
                f"{path.name}: {name}: reaches {reach:.3g} where {most:.3g} {unit} is the end; "
                f"give {unit}, or the unit in the header"
            )
    return rows


def log_run(rows: dict[str, Array], scenario: Scenario, name: str) -> Run:
    """A log as a run.

    Without columns of an estimate the ball's position is the measured one, at the time it was
    there: the scenario's dead time and the log's age earlier, and in a straight line where the
    screen detected nothing. Accelerations that a log does not have are unknown, NaN.

    Args:
        rows: As ``read_log`` gives them.
        scenario: Whose reference it was to follow, in the log's own time, and how it is judged.
        name: What it is called.
    """
    late = scenario.sensors.touch.dead_time + np.nan_to_num(rows.get("age", 0 * rows["time"]))
    if "estimated_x" not in rows:  # nothing is known of the ball from its last frame on
        known = rows["time"] <= (rows["time"] - late)[np.isfinite(rows["measured_x"])][-1]
        rows, late = {name: values[known] for name, values in rows.items()}, late[known]
    time = rows["time"]
    when = time - late
    ball = {axis: _filled(when, rows[f"measured_{axis}"], time) for axis in ("x", "y")}
    state = {**ball, **{axis: rows[f"measured_{axis}"] for axis in AXES}}
    rates = {f"{key}_rate": np.gradient(values, time) for key, values in state.items()}
    seen = {f"estimated_{key}": values for key, values in (state | rates).items()}
    unknown = np.full(len(time), np.nan)
    applied = {f"applied_{axis}_acc": rows.get(f"applied_{axis}_acc", unknown) for axis in AXES}
    requested = {f"requested_{axis}_acc": unknown for axis in AXES}
    others = {
        "touched": np.isfinite(rows["measured_x"]).astype(float),
        "age": np.zeros(len(time)),
        "supervisor": np.full(len(time), float(State.RUNNING)),
    }
    known = {key: values for key, values in rows.items() if not key.startswith("true_")}
    if all(column in rows for column in CHANNELS["state"].columns):
        known = rows
    run = Run(name, scenario, {**seen, **applied, **requested, **others, **known}, UNITS)
    ended = Outcome(Ending.FINISHED, float(time[-1]))
    judged = scenario.metrics
    metrics = measure(run.motion, ended, start=judged.start, band_percent=judged.band_percent)
    return replace(run, metrics=metrics.as_dict())


def fitting(rows: dict[str, Array], scenario: Scenario) -> list[str]:
    """What a scenario is to be changed to, to predict a log: how long, and where the ball starts.

    Args:
        rows: As ``read_log`` gives them.
        scenario: As it is.
    """
    time, own = rows["time"], scenario.plant.start
    end = float(time[-1] + np.median(np.diff(time)))
    start = {axis: float(_filled(time, rows[f"measured_{axis}"], time)[0]) for axis in ("x", "y")}
    changes = [f"duration={end:.6g}"]
    if end < scenario.duration:
        changes.append(f"metrics.start={scenario.metrics.start * end / scenario.duration:.6g}")
    if np.hypot(start["x"] - own.x, start["y"] - own.y) > NEAR:
        changes += [f"plant.start.{axis}={at:.6g}" for axis, at in start.items()]
    return changes


def apart(log: Run, twin: Motion) -> float:
    """Root mean square distance in m of the ball in a log and in a prediction of it."""
    time = log.motion.time
    both = time <= twin.time[-1] + 1e-9
    predicted = [np.interp(time[both], twin.time, axis) for axis in twin.ball.T]
    distance = log.motion.ball[both] - np.stack(predicted, axis=1)
    return float(np.sqrt((distance**2).sum(axis=1).mean()))


def distances(logs: Mapping[str, Run], motions: Mapping[str, Motion]) -> list[str]:
    """How far logs and other runs are apart, in a sentence each.

    Args:
        logs: Name to those whose positions were measured.
        motions: Name to motion of all runs; those of the logs are among them.
    """
    return [
        f"{name} and {other} are {1000 * apart(log, motion):.3g} mm (RMS) apart over x and y."
        for name, log in logs.items()
        for other, motion in motions.items()
        if other not in logs
    ]


def _require(names: list[str], source: str) -> None:
    missing = [name for name in NEEDED if name not in names]
    if missing:
        has = ", ".join(names[:12]) or "none"
        raise LogError(f"{source}: no column {', '.join(missing)} (it has {has})")


def _filled(time: Array, values: Array, at: Array) -> Array:
    """Values at some times, with straight lines where there is none."""
    known = np.isfinite(values)
    filled: Array = np.interp(at, time[known], values[known])
    return filled
