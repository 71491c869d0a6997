"""A run folder opened again: its rows, its scenario, its verdict."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from controllers.arrays import Array
from controllers.interfaces import Reference
from twin.data_file import DataError, parse_json
from twin.errors import RecordError, ScenarioError
from twin.hal.limits import Limits
from twin.hal.states import State
from twin.run.assemble import build_limits
from twin.run.control import build_reference
from twin.run.finished import Run
from twin.run.folders import is_last, last, listed, record_of, run_folders
from twin.run.loop import INTERRUPTED
from twin.run.metadata import check_metadata, classes_of
from twin.run.metrics import Motion, held
from twin.run.record import CHANNELS
from twin.run.record_file import read_beside, read_run
from twin.scenario.changing import always_friction
from twin.scenario.load import check, recorded
from twin.scenario.schema import Scenario, choices

_OPTIONAL = {"state", "age", "touched", "timing", "reference"}
NEEDED = (
    "time",
    *(name for key, each in CHANNELS.items() if key not in _OPTIONAL for name in each.columns),
)
"""Columns without which a table is no record of a run."""
TOGETHER = (CHANNELS["state"].columns, ("motor_phi_rad", "motor_theta_rad"))
"""Columns of which a record has all or none."""


class RecordedReference(Reference):
    """Where a reference led, as recorded; its derivatives are differences of that.

    Args:
        time: In s, shape (K,).
        path: Desired ball position in m, shape (K, 2).
    """

    def __init__(self, time: Array, path: Array) -> None:
        self._time = time
        self._motion = [path]
        for _ in range(4):
            known = len(time) > 1
            self._motion.append(np.gradient(self._motion[-1], time, axis=0) if known else 0 * path)

    def __call__(self, t: float | Array) -> Array:
        """Position and four derivatives, shape (5, *shape(t), 2), between what was recorded."""
        each = [[np.interp(t, self._time, axis) for axis in of.T] for of in self._motion]
        return np.moveaxis(np.array(each), 1, -1)


@dataclass(frozen=True)
class Replay:
    """One rig's recorded run.

    Attributes:
        name: What it is called in plots and tables.
        scenario: What was asked for.
        rows: Column name to values, shape (K,).
        units: Column name to unit.
        metrics: Its indicators, as ``metrics.json`` has them.
        versions: What produced it.
        folder: Where it lies; None for a run that is not on disk.
        events: Conditions that were detected: time in s, severity, text.
        ledger: Of a run in real time, ``TimingLog.as_dict``; else empty.
        branch: Of another future of a run, which run, when and what was changed; else empty.
        driven: Of a run that a person drove, what they did beyond what the scenario says, see
            ``controlled``; else empty.
        classes: What law, observer and reference were, see ``metadata.classes_of``; of records of
            earlier versions empty.
        absent: Of those of controller, observer and reference that are not here, why.
    """

    name: str
    scenario: Scenario
    rows: Mapping[str, Array]
    units: Mapping[str, str] = field(default_factory=dict)
    metrics: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    folder: Path | None = None
    events: tuple[Mapping[str, Any], ...] = ()
    ledger: Mapping[str, Any] = field(default_factory=dict)
    branch: Mapping[str, Any] = field(default_factory=dict)
    driven: Mapping[str, Any] = field(default_factory=dict)
    classes: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    absent: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def reference(self) -> Reference:
        """The reference the run was to follow."""
        if CHANNELS["reference"].columns[0] in self.rows:
            path = np.stack([self.rows[name] for name in CHANNELS["reference"].columns], axis=1)
            return RecordedReference(self.rows["time"], path)
        return build_reference(self.scenario)

    @property
    def settings(self) -> dict[str, Any]:
        """The tables of the scenario, with all settings of law, observer and reference."""
        tables = self.scenario.model_dump(mode="json")
        for table, its in self.classes.items():
            tables[table] |= its["settings"]
            tables[table] |= {key: its[key] for key in ("file", "sha256") if its.get(key)}
        return tables

    @property
    def lacking(self) -> str:
        """What the record can be drawn without, but not gone on from; empty if all is here."""
        for table, line in self.absent.items():
            kind = getattr(self.scenario, table).kind
            file = self.classes.get(table, {}).get("file", "")
            was = f" (it was in {file})" if file else ""
            wrong = f"does not take its settings: {line}" if kind in choices(table) else "not here"
            return (
                f"{self.name}: {table} '{kind}'{was}: {wrong}; the record is shown, but replay "
                "and what-if need it: --law FILE"
            )
        return ""

    def require(self) -> None:
        """Make sure that the run can be gone on with.

        Raises:
            RecordError: If its law, observer or reference is not here, or is another than it was.
        """
        if self.lacking:
            raise RecordError(self.lacking)
        now = classes_of(self.scenario)
        for table, was in self.classes.items():
            if was.get("sha256", "") != now[table].get("sha256", ""):
                kind = getattr(self.scenario, table).kind
                raise RecordError(
                    f"{self.name}: {table} '{kind}' is another than in the run: "
                    f"{was.get('file')} has changed since"
                )

    def controlled(self, at: float) -> Scenario:
        """The scenario with the controller that a person had chosen by a time in s."""
        found = self.scenario
        for each in self.driven.get("controllers", ()):
            if each["since"] < at + 1e-9:
                tables = self.scenario.model_dump(mode="json")
                tables |= {name: table for name, table in each.items() if name != "since"}
                found = check(tables, self.name)
        return found

    @property
    def limits(self) -> Limits:
        """Limits of what might be commanded of the rig."""
        return build_limits(self.scenario.rig.limits)

    @cached_property
    def motion(self) -> Motion:
        """What ball and plate did."""
        state = states_of(self.rows)
        applied = np.stack([self.rows[f"applied_{axis}_acc"] for axis in ("phi", "theta")], axis=1)
        time = self.rows["time"]
        known = "true_x" in self.rows and always_friction(self.scenario)
        return Motion(
            time=time,
            ball=state[:, 0::4],
            plate=state[:, 2::4],
            u=applied,
            reference=self.reference(time)[0],
            held=held(time, state[:, 1::4]) if known else None,
        )


def columns(rows: Mapping[str, Array], kind: str) -> Array:
    """The state columns ``true_...`` or ``estimated_...`` as states of (5.5), shape (K, 8)."""
    names = ("x", "x_rate", "phi", "phi_rate", "y", "y_rate", "theta", "theta_rate")
    return np.stack([rows[f"{kind}_{name}"] for name in names], axis=1)


def states_of(rows: Mapping[str, Array]) -> Array:
    """The true states (K, 8); of a real rig, where nobody knows them, the estimated ones."""
    return columns(rows, "true" if "true_x" in rows else "estimated")


def replay_of(run: Run, name: str) -> Replay:
    """A run that was just made, as if it had been kept and opened again.

    Args:
        run: The run of one rig.
        name: What it is called in plots and tables.
    """
    columns = list(run.record.columns())
    return Replay(
        name,
        run.scenario,
        {"time": run.record.time, **{column: values for column, _, values in columns}},
        {"time": "s", **{column: unit for column, unit, _ in columns}},
        run.metrics.as_dict(),
        ledger=run.account.get("ledger", {}),
        classes=classes_of(run.scenario),
    )


def open_run(path: Path, rigs: tuple[int, ...] = ()) -> list[Replay]:
    """The runs of a folder, or of the folder its ``run.parquet`` lies in.

    Args:
        path: Run folder or Parquet file.
        rigs: Which rigs of a record of several; empty for the first.

    Raises:
        RecordError: If there is no record, or none of this program, or not of such rigs.
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
    try:
        scenario, absent = recorded(metadata["scenario"], str(file))
    except ScenarioError as error:
        raise RecordError(f"{error}; was it recorded by another version?") from error
    check_metadata(metadata, str(file))
    if "reference" in absent and "reference_x" not in values:
        raise RecordError(f"{absent['reference']}; where it led is not in the record")
    _check_rows(values, str(file))
    present = np.unique(values["rig"]).astype(int).tolist() if "rig" in values else [0]
    wrong = [rig for rig in rigs if rig not in present]
    if wrong:
        raise RecordError(f"{file}: no rig {wrong[0]} (recorded: {present[0]} to {present[-1]})")
    name = file.resolve().parent.name if file.name == "run.parquet" else file.stem
    found = []
    for rig in rigs or present[:1]:
        chosen = values["rig"] == rig if "rig" in values else slice(None)
        label = name if len(present) == 1 else f"{name}-rig-{rig}"
        rows = {key: column[chosen] for key, column in values.items() if key != "rig"}
        if not (np.diff(rows["time"]) > 0).all():
            raise RecordError(f"{file}: time: must rise from row to row")
        found.append(
            Replay(
                label,
                scenario,
                rows,
                units,
                metadata.get("metrics", {}),
                metadata.get("versions", {}),
                file.parent,
                tuple(metadata.get("events", ())),
                metadata.get("ledger", {}),
                metadata.get("branch", {}),
                metadata.get("driven", {}),
                metadata.get("classes", {}),
                absent,
            )
        )
    return found


def _check_rows(values: Mapping[str, Array], source: str) -> None:
    """Make sure that rows, of one rig or several, can be read as a run.

    Raises:
        RecordError: If there are none, or a time, rig or state in them is none.
    """
    if len(values["time"]) == 0:
        raise RecordError(f"{source}: the run ended before its first period")
    if not np.isfinite(values["time"]).all():
        raise RecordError(f"{source}: time: must be a number in every row")
    rigs = values.get("rig", np.zeros(1))
    if not (np.isin(rigs, np.arange(len(values["time"])))).all():
        raise RecordError(f"{source}: rig: must be the number of a rig in every row")
    strange = set(values["supervisor"].tolist()).difference(State)
    if strange:
        known = f"{min(State)} to {max(State)}"
        raise RecordError(f"{source}: supervisor: no state {min(strange):g} (known: {known})")


def open_runs(
    paths: tuple[Path, ...],
    rigs: tuple[int, ...] = (),
    tell: Callable[[str], None] = lambda _: None,
) -> list[Replay]:
    """Several runs with names of their own.

    Args:
        paths: Run folders, Parquet files, and folders of run folders, as ``compare`` writes them.
            Files of another kind beside them, as a pattern finds them, are passed over.
        rigs: Which rigs of a record of several; empty for the first.
        tell: Is told which of several runs is passed over because it cannot be opened, and which
            is open without its law.

    Raises:
        RecordError: If none can be opened.
    """
    runs: list[Replay] = []
    failed: list[RecordError] = []
    for path in _records(paths):
        try:
            opened = open_run(path, rigs)
        except RecordError as error:
            failed.append(error)
            continue
        if len(opened) == 1:
            (run,) = opened
            opened = [replace(run, name=listed(path.parent).get(path.name, run.name))]
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
        found = parse_json(read_beside(folder / "run.parquet", "ballplate") or b"{}")
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
        elif path.suffix == ".parquet" or len(paths) == 1 or not path.exists():
            found.append(path)
    if not found:
        raise RecordError(f"{paths[0]}: not a run; give run folders, as in runs/circle")
    return list({path.resolve(): path for path in reversed(found)}.values())[::-1]
