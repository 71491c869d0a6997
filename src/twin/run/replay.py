"""A run folder opened again: its rows, its scenario, its verdict."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from controllers.arrays import Array
from controllers.interfaces import Reference
from twin.errors import RecordError, ScenarioError
from twin.hal.limits import Limits
from twin.hal.states import State
from twin.run.assemble import build_limits
from twin.run.control import build_reference
from twin.run.finished import Run
from twin.run.folders import is_last, last, record_of, run_folders
from twin.run.metadata import check_metadata
from twin.run.metrics import Motion, held
from twin.run.record import CHANNELS
from twin.run.record_file import read_run
from twin.scenario.changing import always_friction
from twin.scenario.load import check
from twin.scenario.schema import Scenario

_OPTIONAL = {"state", "age", "touched", "timing"}
NEEDED = (
    "time",
    *(name for key, each in CHANNELS.items() if key not in _OPTIONAL for name in each.columns),
)
"""Columns without which a table is no record of a run."""
TOGETHER = (CHANNELS["state"].columns, ("motor_phi_rad", "motor_theta_rad"))
"""Columns of which a record has all or none."""


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

    @cached_property
    def reference(self) -> Reference:
        """The reference the run was to follow."""
        return build_reference(self.scenario)

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
        scenario = check(metadata["scenario"], str(file))
    except ScenarioError as error:
        raise RecordError(f"{error}; was it recorded by another version?") from error
    check_metadata(metadata, str(file))
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


def open_runs(paths: tuple[Path, ...], rigs: tuple[int, ...] = ()) -> list[Replay]:
    """Several runs with names of their own.

    Args:
        paths: Run folders, Parquet files, and folders of run folders, as ``compare`` writes them.
            Files of another kind beside them, as a pattern finds them, are passed over.
        rigs: Which rigs of a record of several; empty for the first.

    Raises:
        RecordError: If one cannot be opened.
    """
    runs: list[Replay] = []
    for path in _records(paths):
        for run in open_run(path, rigs):
            taken = sum(other.name.partition("~")[0] == run.name for other in runs)
            name = f"{run.name}~{taken + 1}" if taken else run.name
            runs.append(replace(run, name=name) if taken else run)
    return runs


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
