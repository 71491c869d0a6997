"""Reads logs: a CSV file with named columns, their units in the header or in SI, or a run.

A log of columns as a run under a scenario's reference, to lay over what the twin predicts.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from controllers.arrays import Array
from twin.base.errors import LogError, one_line, plural, shorten
from twin.base.foreign import decode_text
from twin.hal.interface import AXIS_NAMES, SCREEN_SIZE_M
from twin.hal.supervisor import State
from twin.run.controller_building import build_reference
from twin.run.exporters import METADATA_KEY
from twin.run.files import is_record
from twin.run.finished import Run
from twin.run.foreign_logs import foreign_table, refuse_foreign
from twin.run.metrics import Ending, Motion, Outcome
from twin.run.opened import judged_as
from twin.run.readers import ForeignTable
from twin.run.record import CHANNELS, is_number, read_table
from twin.run.units import UNIT_SCALES, plain_unit, split_unit
from twin.scenario.schema import Scenario

if TYPE_CHECKING:
    import pyarrow as pa

OTHER_SEPARATORS = {
    ";": "';', as where a comma is the decimal point",
    "\t": "tabs",
    "|": "'|'",
}
"""What separates the columns of other programs, and what it is called."""


def read_csv(path: Path, units: Mapping[str, str], needed: Sequence[str] = ()) -> dict[str, Array]:
    """The columns of known names in SI units, shape (K,) each; NaN where a cell is empty.

    Args:
        path: The file; its first line names the columns, as ``measured_x [mm]``.
        units: Name to SI unit; columns of other names are left out.
        needed: Names that have to be there.

    Raises:
        LogError: If a column is missing, a unit is unknown, a cell is no number, two columns have
            one name, rows have more cells than the header or the first has fewer, columns are not
            separated by commas, there is no row, or the file is no text.
        OSError: If the file cannot be read.
    """
    refuse_foreign(path)
    text = decode_text(path.read_bytes())
    if not text.strip():
        raise LogError(f"{path.name}: is empty")
    with io.StringIO(text, newline="") as file:
        rows = csv.reader(file)
        first = next(rows, [])
        other = [mark for mark in OTHER_SEPARATORS if len(first) == 1 and mark in first[0]]
        if other:
            raise LogError(
                f"{path.name}: columns are separated by {OTHER_SEPARATORS[other[0]]}; write ',' "
                "between columns and '.' in numbers"
            )
        header = [split_unit(cell) for cell in first]
        names = [name for name, _ in header]
        if twice := [name for name in units if names.count(name) > 1]:
            raise LogError(f"{path.name}: {twice[0]}: two columns have this name")
        _require(names, needed, path.name)
        used = [
            (i, name, scale(name, unit, units[name], path.name))
            for i, (name, unit) in enumerate(header)
            if name in units
        ]
        lines = [(rows.line_num, row) for row in rows if row]
    if not lines:
        raise LogError(f"{path.name}: has no row below its header")
    _check_lengths(path.name, len(first), lines)
    data = [[_number(row, i, path.name, name, line) for i, name, _ in used] for line, row in lines]
    values = np.array(data, dtype=float).reshape(len(data), len(used))
    return {name: values[:, k] * factor for k, (_, name, factor) in enumerate(used)}


def _check_lengths(source: str, named: int, lines: Sequence[tuple[int, list[str]]]) -> None:
    """Make sure that no row has more cells than the header, and the first no fewer.

    Args:
        source: What to call the file in messages.
        named: How many columns the header names.
        lines: Number of a line, and its cells.
    """
    usual = max((len(row) for _, row in lines[1:]), default=0)
    for number, row in lines:
        cut = number == lines[0][0] and len(row) < named <= usual
        if cut or any(map(str.strip, row[named:])):
            why = ": its front may be cut off; take the line out" if cut else ""
            raise LogError(
                f"{source}: line {number}: has {plural(len(row), 'cell')}, the header names "
                f"{plural(named, 'column')}{why}"
            )


def read_columns(
    path: Path, units: Mapping[str, str], needed: Sequence[str]
) -> tuple[dict[str, Array], dict[str, Any]]:
    """The columns of a log or a run in SI units, shape (K,) each, and the run's metadata.

    Args:
        path: A CSV file, which has no metadata, or a Parquet file.
        units: Name to SI unit; columns of other names are left out.
        needed: Names that have to be there.

    Raises:
        LogError: If it cannot be read, lacks a column, or has a different unit or no numbers.
    """
    try:
        if path.suffix == ".parquet" or is_record(path):
            return _read_table(path, units, needed)
        if (table := foreign_table(path)) is not None:
            return _chosen(path.name, table, units, needed), table.metadata
        return read_csv(path, units, needed), {}
    except (OSError, UnicodeDecodeError, MemoryError, csv.Error) as error:
        why = (isinstance(error, OSError) and error.strerror) or one_line(error)
        raise LogError(f"{path.name}: cannot be read: {why}") from error


def _chosen(
    source: str, table: ForeignTable, units: Mapping[str, str], needed: Sequence[str]
) -> dict[str, Array]:
    """The columns of a file that is no text, in SI units; a header may hold the unit."""
    found = {split_unit(header)[0]: header for header in table.columns}
    _require(list(found), needed, source)
    columns: dict[str, Array] = {}
    for name in filter(found.__contains__, units):
        header = found[name]
        values = table.columns[header]
        if isinstance(values, list):
            raise LogError(f"{source}: {name}: is not one column of numbers")
        unit = table.units.get(header) or split_unit(header)[1]
        columns[name] = values * scale(name, unit, units[name], source)
    if len({len(values) for values in columns.values()}) > 1:
        lengths = ", ".join(f"{name} {len(values)}" for name, values in columns.items())
        raise LogError(f"{source}: columns have different numbers of rows: {lengths}")
    return columns


def _read_table(
    path: Path, units: Mapping[str, str], needed: Sequence[str]
) -> tuple[dict[str, Array], dict[str, Any]]:
    import pyarrow as pa  # noqa: PLC0415  heavy: a CSV file does without

    def wanted(schema: pa.Schema) -> list[str]:
        _require(schema.names, needed, path.name)
        known = [name for name in units if name in schema.names]
        for name in known:
            if schema.names.count(name) > 1 or not is_number(schema.field(name).type):
                raise LogError(f"{path.name}: {name}: is not one column of numbers")
        return known

    try:
        table = read_table(path, wanted)
    except pa.ArrowException as error:
        raise LogError(f"{path.name}: cannot be read: {error}") from error
    schema = table.schema
    columns: dict[str, Array] = {}
    for name in schema.names:
        values = np.asarray(table[name].to_numpy(), dtype=float)
        unit = (schema.field(name).metadata or {}).get(b"unit")
        columns[name] = values * scale(
            name, unit.decode() if unit else None, units[name], path.name
        )
    try:
        return columns, json.loads((schema.metadata or {}).get(METADATA_KEY, b"{}"))
    except (ValueError, RecursionError):
        raise LogError(f"{path.name}: its metadata does not describe a run") from None


def scale(name: str, unit: str | None, known: str, source: str) -> float:
    """Factor from a column's unit to SI.

    Args:
        name: The column.
        unit: Its unit; None for that in SI.
        known: Its unit in SI.
        source: What to call the file in messages.

    Raises:
        LogError: If the unit is none of that quantity.
    """
    if unit is None:
        return 1.0
    allowed = UNIT_SCALES[known]
    if plain_unit(unit) not in allowed:
        listed = ", ".join(filter(None, allowed))
        raise LogError(f"{source}: {name}: unit '{shorten(unit)}'; known: {listed}")
    return allowed[plain_unit(unit)]


def _number(row: list[str], index: int, source: str, name: str, line: int) -> float:
    text = row[index].strip() if index < len(row) else ""
    try:
        return float(text) if text else np.nan
    except ValueError:
        raise LogError(
            f"{source}: line {line}: {name}: '{shorten(text)}' is not a number"
        ) from None


COLUMN_UNITS = {"time": "s"} | {
    column: unit
    for channel in CHANNELS.values()
    for column, unit in zip(channel.columns, channel.units, strict=True)
}
"""Columns of a run and their SI units; others of a log are left out."""
NEEDED_COLUMNS = ("time", *CHANNELS["measured"].columns)
"""Columns that a log must have."""
SECOND_AXIS_COLUMNS = ("measured_y", "measured_theta")
"""Those of them that a log of a rig of one axis lacks."""
MAX_MEASURED = {
    "measured_x": 0.55 * SCREEN_SIZE_M[0],
    "measured_y": 0.55 * SCREEN_SIZE_M[1],
    "measured_phi": 0.26,
    "measured_theta": 0.26,
}
"""Where the screen and the plate's travel end, with a margin, m and rad."""
MAX_ONE_AXIS_TILT_RAD = 0.6
"""Where the travel of a tube or beam ends, with a margin, rad."""
START_TOLERANCE_M = 1e-3
"""Distance in m up to which a ball starts at the place of its scenario."""


def read_log(path: Path) -> dict[str, Array]:
    """The columns of a CSV log in SI units; of a rig of one axis the second is 0.

    Raises:
        LogError: If it cannot be read, lacks a column or a row, or its time does not rise.
    """
    rows, _ = read_columns(path, COLUMN_UNITS, NEEDED_COLUMNS)
    axes = 1 if SECOND_AXIS_COLUMNS[0] not in rows else 2
    rows = dict.fromkeys(SECOND_AXIS_COLUMNS, np.zeros_like(rows["time"])) | rows
    kept = np.all([np.isfinite(rows[name]) for name in ("time", *NEEDED_COLUMNS[2::2])], axis=0)
    rows = {name: values[kept] for name, values in rows.items()}
    if kept.sum() < 2:
        raise LogError(f"{path.name}: no two rows with a time and both plate angles")
    if not (np.diff(rows["time"]) > 0).all():
        raise LogError(f"{path.name}: time: must rise from row to row")
    if not np.isfinite(rows["measured_x"] + rows["measured_y"]).any():
        raise LogError(f"{path.name}: no row has a position of the ball")
    for name in MAX_MEASURED:
        check_reach(path.name, name, rows[name], axes=axes)
    return rows


def check_reach(source: str, name: str, values: Array, *, axes: int = 2) -> None:
    """Make sure that a column is not beyond what the rig can do.

    Args:
        source: What to call the log in messages.
        name: The column, one of ``MAX_MEASURED``.
        values: In SI units, NaN where there is none.
        axes: Number of axes of the rig.

    Raises:
        LogError: Naming the column, and the unit its numbers look like.
    """
    reach, most, unit = (
        float(np.nanpercentile(np.abs(values), 99)),
        MAX_MEASURED[name],
        COLUMN_UNITS[name],
    )
    most = MAX_ONE_AXIS_TILT_RAD if axes == 1 and unit == "rad" else most
    if reach > most:
        lengths = {100: "millimetres", 4: "centimetres", 0: "a different unit"}
        like = next(word for factor, word in lengths.items() if reach > factor * most)
        raise LogError(
            f"{source}: {name}: reaches {reach:.3g} where {most:.3g} {unit} is the end: "
            f"{like if unit == 'm' else 'degrees'}? give {unit}, or the unit in the header"
        )


def log_run(rows: dict[str, Array], scenario: Scenario, name: str) -> Run:
    """A log as a run.

    Without columns of an estimate the ball's position is the measured one, at the time it was
    there: the scenario's dead time and the log's age earlier, and in a straight line where the
    screen detected nothing. Accelerations that a log does not have are unknown, NaN.

    Args:
        rows: As ``read_log`` gives them.
        scenario: Its reference, in the log's own time, and its indicators are used.
        name: Its name.
    """
    late = scenario.sensors.touch.dead_time + np.nan_to_num(rows.get("age", 0 * rows["time"]))
    if "estimated_x" not in rows:  # nothing is known of the ball from its last frame on
        known = rows["time"] <= (rows["time"] - late)[np.isfinite(rows["measured_x"])][-1]
        rows, late = {name: values[known] for name, values in rows.items()}, late[known]
    time = rows["time"]
    when = time - late
    ball = {axis: _fill_gaps(when, rows[f"measured_{axis}"], time) for axis in ("x", "y")}
    state = {**ball, **{axis: rows[f"measured_{axis}"] for axis in AXIS_NAMES}}
    rates = {f"{key}_rate": np.gradient(values, time) for key, values in state.items()}
    seen = {f"estimated_{key}": values for key, values in (state | rates).items()}
    unknown = np.full(len(time), np.nan)
    applied = {
        f"applied_{axis}_acc": rows.get(f"applied_{axis}_acc", unknown) for axis in AXIS_NAMES
    }
    requested = {f"requested_{axis}_acc": unknown for axis in AXIS_NAMES}
    others = {
        "touched": np.isfinite(rows["measured_x"]).astype(float),
        "age": np.zeros(len(time)),
        "supervisor": np.full(len(time), float(State.RUNNING)),
    }
    known = {key: values for key, values in rows.items() if not key.startswith("true_")}
    if all(column in rows for column in CHANNELS["state"].columns):
        known = rows
    run = Run(name, scenario, {**seen, **applied, **requested, **others, **known}, COLUMN_UNITS)
    return judged_as(run, Outcome(Ending.FINISHED, float(time[-1])))


def fitting(rows: dict[str, Array], scenario: Scenario) -> list[str]:
    """Changes of a scenario to predict a log: its duration, and the start of the ball.

    Args:
        rows: As ``read_log`` gives them.
        scenario: As it is.
    """
    time, own = rows["time"], scenario.plant.start
    end = float(time[-1] + np.median(np.diff(time)))
    start = {
        axis: float(_fill_gaps(time, rows[f"measured_{axis}"], time)[0]) for axis in ("x", "y")
    }
    changes = [f"duration={end:.6g}"]
    if end < scenario.duration:
        changes.append(f"metrics.start={scenario.metrics.start * end / scenario.duration:.6g}")
    if np.hypot(start["x"] - own.x, start["y"] - own.y) > START_TOLERANCE_M:
        changes += [f"plant.start.{axis}={at:.6g}" for axis, at in start.items()]
    return changes


def check_second_axis(source: str, y: Array, scenario: Scenario) -> None:
    """Make sure that a log of x alone is not compared with a reference that moves along y.

    Args:
        source: What to call the log in messages.
        y: Measured positions along y in m, shape (K,); all 0 in a log without them.
        scenario: What is said to have run.

    Raises:
        LogError: If it is.
    """
    if scenario.plant.axes == 1 or np.nan_to_num(y).any():
        return
    if build_reference(scenario)(np.linspace(0, scenario.duration, 201))[0][..., 1].any():
        raise LogError(
            f"{source}: has no positions along y, where the scenario's reference moves, too; name "
            "them, or a scenario along x, such as line; of a rig of one axis add "
            "--set plant.axes=1 --set plant.kind=lagrange"
        )


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
        logs: Logs with measured positions, by name.
        motions: Name to motion of all runs; those of the logs are among them.
    """
    return [
        f"{name} and {other} are {1000 * apart(log, motion):.3g} mm (RMS) apart over "
        f"{'x' if log.scenario.plant.axes == 1 else 'x and y'}."
        for name, log in logs.items()
        for other, motion in motions.items()
        if other not in logs
    ]


def _require(names: list[str], needed: Sequence[str], source: str) -> None:
    """Make sure that a log has its columns; those of the second axis may be missing together."""
    missing = [name for name in needed if name not in names]
    if set(SECOND_AXIS_COLUMNS) <= set(missing):
        missing = [name for name in missing if name not in SECOND_AXIS_COLUMNS]
    if missing:
        has = ", ".join(name[:60] for name in names[:12]) + (", ..." if len(names) > 12 else "")
        raise LogError(
            f"{source}: no column {', '.join(missing)} (it has {has or 'none'}); identify takes "
            "others by --columns"
        )


def _fill_gaps(time: Array, values: Array, at: Array) -> Array:
    """Values at some times, with straight lines where there is none."""
    known = np.isfinite(values)
    return np.interp(at, time[known], values[known])
