"""A run folder opened again: its rows, its scenario, its verdict."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from controllers.arrays import Array
from twin.data_file import DataError, parse_json
from twin.errors import RecordError, ScenarioError
from twin.hal.states import State
from twin.run.finished import Run
from twin.run.folders import STREAM, is_last, is_record, last, record_in, record_of, run_folders
from twin.run.loop import INTERRUPTED, KILLED, Ending, Outcome
from twin.run.metadata import classes_of
from twin.run.metrics import measure
from twin.run.record import CHANNELS
from twin.run.record_file import read_beside, read_run
from twin.scenario.load import recorded
from twin.scenario.schema import Scenario

_OPTIONAL = {"state", "age", "touched", "timing", "reference"}
NEEDED = (
    "time",
    *(name for key, each in CHANNELS.items() if key not in _OPTIONAL for name in each.columns),
)
"""Columns without which a table is no record of a run."""
SHAPES = dict.fromkeys(("metrics", "versions", "ledger", "branch", "driven", "classes"), dict) | {
    "events": list
}
"""What of a record's metadata is what, where it is there."""
TOGETHER = (CHANNELS["state"].columns, ("motor_phi_rad", "motor_theta_rad"))
"""Columns of which a record has all or none."""


def open_run(path: Path) -> list[Run]:
    """The run of a folder, or of the folder its ``run.parquet`` lies in.

    Args:
        path: Run folder or Parquet file.

    Raises:
        RecordError: If there is no record, or none of this program.
    """
    file = record_of(path)
    values, units, metadata = read_run(file)
    missing = [name for name in NEEDED if name not in values]
    for group in TOGETHER:
        if not values.keys().isdisjoint(group):
            missing += [name for name in group if name not in values]
    if missing or "scenario" not in metadata:
        raise RecordError(
            f"{file}: not a record of a run: no {', '.join(missing) or 'scenario in its metadata'}"
        )
    tables = metadata["scenario"]
    if isinstance(tables, dict) and isinstance(own := tables.get("controller"), dict):
        own.setdefault("model", "nominal")  # what controllers were designed on before it was a key
    try:
        scenario, absent = recorded(tables, str(file))
    except ScenarioError as error:
        raise RecordError(f"{error}; was it recorded by another version?") from error
    for key, kind in SHAPES.items():
        if not isinstance(metadata.get(key) or kind(), kind):
            raise RecordError(f"{file}: metadata 'ballplate': {key}: is damaged")
    if "reference" in absent and "reference_x" not in values:
        raise RecordError(f"{absent['reference']}; where it led is not in the record")
    _check_rows(values, str(file))
    run = Run(
        file.resolve().parent.name if is_record(file) else file.stem,
        scenario,
        values,
        units,
        metadata.get("metrics", {}),
        metadata.get("versions", {}),
        file.parent,
        tuple(metadata.get("events") or ()),
        metadata.get("ledger", {}),
        metadata.get("branch", {}),
        metadata.get("driven", {}),
        metadata.get("classes", {}),
        absent,
    )
    return [_killed(run) if file.name == STREAM else run]


def _killed(run: Run) -> Run:
    """A run that nobody could judge when it ended."""
    ended = Outcome(Ending.ABORTED, run.rows["time"][-1] + run.scenario.rig.period, KILLED)
    judged = run.scenario.metrics
    metrics = measure(run.motion, ended, start=judged.start, band_percent=judged.band_percent)
    return replace(run, metrics=metrics.as_dict())


def _check_rows(values: Mapping[str, Array], source: str) -> None:
    """Make sure that rows can be read as a run.

    Raises:
        RecordError: If there are none, or a time or state in them is none.
    """
    if len(values["time"]) == 0:
        raise RecordError(f"{source}: the run ended before its first period")
    if not np.isfinite(values["time"]).all():
        raise RecordError(f"{source}: time: must be a number in every row")
    if not (np.diff(values["time"]) > 0).all():
        raise RecordError(f"{source}: time: must rise from row to row")
    strange = set(values["supervisor"].tolist()).difference(State)
    if strange:
        known = f"{min(State)} to {max(State)}"
        raise RecordError(f"{source}: supervisor: no state {min(strange):g} (known: {known})")


def open_runs(
    paths: tuple[Path, ...],
    tell: Callable[[str], None] = lambda _: None,
) -> list[Run]:
    """Several runs with names of their own.

    Args:
        paths: Run folders, Parquet files, and folders of run folders, as ``compare`` writes them.
            Files of another kind beside them, as a pattern finds them, are passed over.
        tell: Is told which of several runs is passed over because it cannot be opened, and which
            is open without its law.

    Raises:
        RecordError: If none can be opened.
    """
    runs: list[Run] = []
    failed: list[RecordError] = []
    for path in _records(paths):
        try:
            opened = open_run(path)
        except RecordError as error:
            failed.append(error)
            continue
        for run in opened:
            taken = sum(other.name.partition("~")[0] == run.name for other in runs)
            name = f"{run.name}~{taken + 1}" if taken else run.name
            runs.append(replace(run, name=name) if taken else run)
    if not runs:
        raise failed[0]
    for each in failed:
        tell(f"{each}; passed over")
    told: set[tuple[str, str]] = set()
    for run in runs:
        new = {(table, getattr(run.scenario, table).kind) for table in run.absent} - told
        if new:
            tell(run.lacking)
        told |= new
    return runs


def holds_finished(folder: Path) -> bool:
    """Whether a folder holds a run that nobody interrupted."""
    metrics = _metadata(folder).get("metrics")
    return isinstance(metrics, dict) and metrics.get("reason") != INTERRUPTED


def of_other_class(folder: Path, scenario: Callable[[], Scenario]) -> bool:
    """Whether a folder's run had a law, observer or reference of other text than it is now.

    Args:
        folder: Run folder, there or not.
        scenario: Gives what is to run; asked only if there is a run with classes of its own.
    """
    was = _metadata(folder).get("classes")
    if not isinstance(was, dict):
        return False
    marks = {table: its["sha256"] for table, its in was.items() if its.get("sha256")}
    now = classes_of(scenario()) if marks else {}
    return any(mark != now[table].get("sha256", "") for table, mark in marks.items())


def _metadata(folder: Path) -> Mapping[str, Any]:
    """What lies beside the rows of a folder's record; empty if it cannot be read, or has none."""
    try:
        found = parse_json(read_beside(record_in(folder), "ballplate") or b"{}")
    except (RecordError, DataError):
        return {}
    return found if isinstance(found, dict) else {}


def _records(paths: tuple[Path, ...]) -> list[Path]:
    """The run folders and files that paths lead to, each once."""
    found: list[Path] = []
    for path in paths:
        folder = last() if is_last(path) else path
        inner = run_folders(folder)
        if inner:
            found += inner
        elif path.suffix == ".parquet" or is_record(path) or len(paths) == 1 or not path.exists():
            found.append(path)
    if not found:
        raise RecordError(f"{paths[0]}: not a run; give run folders, as in runs/circle")
    return list({path.resolve(): path for path in reversed(found)}.values())[::-1]
