"""What a finished run is, just made or opened again: what was asked for, its rows, its verdict."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np

from controllers.arrays import Array
from controllers.catalog import origin
from controllers.interfaces import Reference
from twin.errors import RecordError
from twin.hal.limits import Limits
from twin.hal.rig import Entry
from twin.run.assemble import build_limits
from twin.run.control import build_reference
from twin.run.indicators import UNITS
from twin.run.loop import INTERRUPTED, Outcome
from twin.run.metadata import classes_of
from twin.run.metrics import Motion, held, measure
from twin.run.record import CHANNELS, Recorder
from twin.run.signals import Signals
from twin.run.snapshot import Snapshot
from twin.scenario.changing import always_friction
from twin.scenario.load import check
from twin.scenario.schema import Scenario, choices


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


@dataclass(eq=False, repr=False)
class Run(Signals):
    """A finished run of one rig: a mapping from column to values, and what can be said of them.

    Attributes:
        name: What it is called in plots and tables.
        scenario: What was asked for.
        rows: Column name to values, shape (K,).
        units: Column name to unit.
        metrics: Its indicators by name, as ``metrics.json`` has them, in SI units but for those
            that say percent or deg; None for one that does not apply.
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
        record: All channels of a run that was just made; None for one that was opened.
        real_time_factor: Simulated seconds per second of the loop, of a run that was just made.
        account: Timing statistics of one in real time.
        snapshots: States of a simulated rig and its controller now and then.
    """

    name: str
    scenario: Scenario
    rows: Mapping[str, Array]
    units: Mapping[str, str] = field(default_factory=dict)
    metrics: dict[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    folder: Path | None = None
    events: tuple[Mapping[str, Any], ...] = ()
    ledger: Mapping[str, Any] = field(default_factory=dict)
    branch: Mapping[str, Any] = field(default_factory=dict)
    driven: Mapping[str, Any] = field(default_factory=dict)
    classes: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    absent: Mapping[str, str] = field(default_factory=dict)
    record: Recorder | None = None
    real_time_factor: float | None = None
    account: Mapping[str, Any] = field(default_factory=dict)
    snapshots: tuple[Snapshot, ...] = ()

    @classmethod
    def of(
        cls,
        scenario: Scenario,
        record: Recorder,
        outcome: Outcome,
        reference: Reference | None = None,
        *,
        journal: Iterable[Entry] = (),
        account: Mapping[str, Any] | None = None,
        **more: Any,
    ) -> Self:
        """A run that was just made, judged from its scenario's start and band.

        Args:
            scenario: What was asked for.
            record: All channels.
            outcome: How it ended.
            reference: What it followed, as it was sampled; that of the scenario by default.
            journal: Every condition that was detected.
            account: Timing statistics of a rig in real time.
            more: Further attributes.
        """
        desired = (reference or build_reference(scenario))(record.time)[0]
        if origin(choices("reference")[scenario.reference.kind]) is not None:
            record.add("reference", desired[:, None])  # who draws the record may lack the class
        motion = Motion.of(record, desired, friction=always_friction(scenario))
        judged = scenario.metrics
        found = measure(motion, outcome, start=judged.start, band_percent=judged.band_percent)
        columns = list(record.columns())
        run = cls(
            "run",
            scenario,
            {"time": record.time, **{column: values for column, _, values in columns}},
            {"time": "s", **{column: unit for column, unit, _ in columns}},
            found.as_dict(),
            events=tuple(
                {"time": time, "severity": str(note.condition.severity), "text": note.text}
                for time, note in journal
            ),
            ledger=(account or {}).get("ledger", {}),
            classes=classes_of(scenario),
            record=record,
            account=account or {},
            **more,
        )
        vars(run)["motion"] = motion
        return run

    @property
    def outcome(self) -> str:
        """How it ended: finished, fell, lost, fault, aborted, diverged, or unknown."""
        return str(self.metrics.get("outcome") or "unknown")

    @property
    def interrupted(self) -> bool:
        """Whether a person ended it."""
        return self.metrics.get("reason") == INTERRUPTED

    def summary(self) -> dict[str, Any]:
        """What ``--json`` prints: the indicators, and of a run just made the speed."""
        made: dict[str, Any] = {}
        if self.record is not None:
            speed = self.real_time_factor
            made = {"judged_from": self.scenario.metrics.start, "real_time_factor": speed}
        driven = {"driven": self.driven} if made and self.driven else {}
        title = self.scenario.title
        return {"scenario": title, **self.metrics, **made, "units": UNITS, **self.account, **driven}

    @cached_property
    def followed(self) -> Reference:
        """The reference that the run was to follow."""
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
            reference=self.followed(time)[0],
            held=held(time, state[:, 1::4]) if known else None,
        )


def columns(rows: Mapping[str, Array], kind: str) -> Array:
    """The state columns ``true_...`` or ``estimated_...`` as states of (5.5), shape (K, 8)."""
    names = CHANNELS["state" if kind == "true" else "estimate"].columns
    return np.stack([rows[name] for name in names], axis=1)


def states_of(rows: Mapping[str, Array]) -> Array:
    """The true states (K, 8); of a real rig, where nobody knows them, the estimated ones."""
    return columns(rows, "true" if "true_x" in rows else "estimated")
