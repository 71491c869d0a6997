"""What of a run has been simulated already: its rows, and states from which it can go on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from controllers.arrays import Array
from controllers.interfaces import Measurement
from controllers.stack import Controller
from twin.errors import RecordError
from twin.hal.rig import Rig
from twin.run.loop import INTERRUPTED
from twin.run.record_file import read_beside, read_run
from twin.run.replay import open_run
from twin.run.snapshot import Snapshot, unpacked
from twin.scenario.schema import Scenario

SNAPSHOTS = "ballplate_snapshots"
"""Metadata of a record that holds its snapshots."""


@dataclass(frozen=True)
class Past:
    """The beginning of a run.

    Attributes:
        columns: Its rows up to the last snapshot, by the names of the record.
        snapshots: Of it, in the order of time; at least one.
    """

    columns: Mapping[str, Array]
    snapshots: tuple[Snapshot, ...]

    def restore(self, rig: Rig, controller: Controller, _: Measurement) -> Measurement:
        """Put rig and controller into the last state; the measurement of that moment."""
        return self.snapshots[-1].restore(rig, controller)


def snapshots_of(file: Path) -> list[Snapshot]:
    """The snapshots that a record keeps; none if it has none.

    Raises:
        RecordError: If they are damaged, or there is no record.
    """
    content = read_beside(file, SNAPSHOTS)
    return unpacked(content, str(file)) if content else []


def interrupted(folder: Path, scenario: Scenario, versions: Mapping[str, str]) -> Past:
    """The beginning of a run that was interrupted.

    Args:
        folder: Its run folder.
        scenario: What is to go on.
        versions: Of this program and its libraries.

    Raises:
        RecordError: If there is no such run, it was not interrupted, is of another scenario or
            version, or had not come far enough.
    """
    (run,) = open_run(folder)
    file = folder / "run.parquet"
    if run.metrics.get("reason") != INTERRUPTED:
        raise RecordError(f"--resume: {file}: the run was not interrupted; there is nothing to do")
    if run.scenario != scenario:
        raise RecordError(f"--resume: {file}: the run is of another scenario or other settings")
    try:
        run.require()
    except RecordError as error:
        raise RecordError(f"--resume: {error}: it would not be one run") from None
    for name, version in versions.items():
        if run.versions.get(name) != version:
            raise RecordError(
                f"--resume: {file}: recorded with {name} {run.versions.get(name)}, this is "
                f"{version}: it would not be one run"
            )
    snapshots = snapshots_of(file)
    if not snapshots:
        raise RecordError(f"--resume: {file}: interrupted before its first snapshot; run it again")
    columns, _, _ = read_run(file)
    before = columns["time"] < snapshots[-1].time - snapshots[-1].period / 2
    return Past({name: values[before] for name, values in columns.items()}, tuple(snapshots))
