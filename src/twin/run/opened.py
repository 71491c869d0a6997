"""Runs opened again from their folders."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from os.path import realpath
from pathlib import Path
from typing import Any

import numpy as np

from controllers.arrays import Array
from twin.base.data_file import DataError, parse_json
from twin.base.errors import RecordError, ScenarioError, plural
from twin.base.parts import AbsentPartError
from twin.hal.supervisor import State
from twin.run import files
from twin.run.finished import Run
from twin.run.metrics import INTERRUPTED_REASON, KILLED_REASON, Ending, Outcome, measure
from twin.run.record import CHANNELS, classes_of, read_metadata, read_run
from twin.scenario.load import load_recorded
from twin.scenario.schema import Scenario

_OPTIONAL_CHANNELS = {
    "state",
    "age",
    "touched",
    "timing",
    "computing",
    "board",
    "reference",
    "laid",
}
RECORD_COLUMNS_NEEDED = (
    "time",
    *(
        name
        for key, each in CHANNELS.items()
        if key not in _OPTIONAL_CHANNELS
        for name in each.columns
    ),
)
"""Columns without which a table is no record of a run."""
METADATA_TYPES = dict.fromkeys(
    ("metrics", "versions", "ledger", "branch", "driven", "classes"), dict
) | {
    "events": list,
    "incomplete": list,
}
"""What of a record's metadata is what, where it is there."""
COLUMN_GROUPS = (CHANNELS["state"].columns, ("motor_phi_rad", "motor_theta_rad"))
"""Columns of which a record has all or none."""


def open_run(path: Path) -> list[Run]:
    """The run of a folder, or of the folder its ``run.parquet`` lies in.

    Args:
        path: Run folder or Parquet file.

    Raises:
        RecordError: If there is no record, or none of this program.
    """
    file = files.record_of(path)
    values, units, metadata = read_run(file)
    missing = [name for name in RECORD_COLUMNS_NEEDED if name not in values]
    for group in COLUMN_GROUPS:
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
        scenario, absent = load_recorded(tables, str(file))
    except ScenarioError as error:
        raise RecordError(f"{error}; was it recorded by a different version?") from error
    details = {key: metadata.get(key) or kind() for key, kind in METADATA_TYPES.items()}
    for key, kind in METADATA_TYPES.items():
        if not isinstance(details[key], kind):
            raise RecordError(f"{file}: metadata 'ballplate': {key}: is damaged")
    if "reference" in absent and "reference_x" not in values:
        raise RecordError(f"{absent['reference']}; the record does not contain its path")
    _check_rows(values, str(file))
    run = Run(
        file.resolve().parent.name if files.is_record(file) else file.stem,
        scenario,
        values,
        units,
        folder=file.parent,
        absent=absent,
        **details
        | {key: tuple(details[key]) for key, kind in METADATA_TYPES.items() if kind is list},
    )
    if file.name != files.STREAM_FILE:
        return [run]
    period = scenario.rig.period
    if lost := round(float((np.diff(values["time"]) / period - 1).sum())):
        lacks = f"{file.name}: {plural(lost, 'period')} not in it: begun too late, or not written"
        run = replace(run, incomplete=(*run.incomplete, lacks))
    end, reason = values["time"][-1] + period, KILLED_REASON
    stopped = np.isin(values["supervisor"], (State.HOLDING, State.FAULT))
    if stopped.any():
        end = float(values["time"][stopped.argmax()])
        reason = f"{KILLED_REASON}; the rig had been stopped before"
    return [judged_as(run, Outcome(Ending.ABORTED, end, reason))]


def judged_as(run: Run, ended: Outcome) -> Run:
    """A run that nobody could judge when it ended, as one that ended so."""
    axes, judging = run.scenario.plant.axes, dict(run.scenario.metrics)
    return replace(run, metrics=measure(run.motion, ended, axes=axes, **judging))


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
            Files of a different kind among them, as a pattern finds them, are passed over.
        tell: Receives a line for each of several runs that is passed over because it cannot be
            opened, and for each that is open without its law.

    Raises:
        RecordError: If none can be opened.
    """
    runs: list[Run] = []
    failed: list[RecordError] = []
    for path in _records(paths):
        try:
            (run,) = open_run(path)
        except RecordError as error:
            failed.append(error)
            continue
        name = files.read_manifest(path.parent).get(path.name, run.name)
        runs.append(replace(run, name=files.number_name(name, [other.name for other in runs])))
    if not runs:
        raise failed[0]
    for each in failed:
        tell(f"{each}; passed over")
    reported: set[tuple[str, str]] = set()
    for run in runs:
        new = {(table, getattr(run.scenario, table).kind) for table in run.absent} - reported
        if new:
            tell(run.lacking)
        reported |= new
    return runs


def holds_finished(folder: Path) -> bool:
    """Whether a folder holds a run that nobody interrupted."""
    metrics = _metadata(folder).get("metrics")
    return isinstance(metrics, dict) and metrics.get("reason") != INTERRUPTED_REASON


def incomplete_of(folder: Path) -> list[str]:
    """Remarks on missing parts in a folder's record or trace, a line each."""
    found = _metadata(folder).get("incomplete")
    return list(map(str, found)) if isinstance(found, list) else []


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
    """The metadata of a folder's record; empty if it cannot be read, or has none."""
    try:
        found = parse_json(read_metadata(files.record_in(folder)) or b"{}")
    except (RecordError, DataError, AbsentPartError):
        return {}
    return found if isinstance(found, dict) else {}


def _records(paths: tuple[Path, ...]) -> list[Path]:
    """The run folders and files that paths lead to, each once."""
    found: list[Path] = []
    for path in paths:
        folder = files.last() if files.is_last(path) else path
        inner = files.run_folders(folder)
        if inner:
            found += inner
        elif (
            path.suffix == ".parquet"
            or len(paths) == 1
            or not path.exists()
            or files.is_record(path)
        ):
            found.append(path)
    if not found:
        raise RecordError(f"{paths[0]}: not a run; give run folders, such as runs/circle")
    return list({realpath(path): path for path in reversed(found)}.values())[::-1]
