"""What a finished run is: what was asked for, all that was recorded, and how it ended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from twin.hal.rig import Entry
from twin.run.indicators import UNITS
from twin.run.loop import Outcome
from twin.run.metrics import Metrics, Motion
from twin.run.record import Recorder
from twin.run.snapshot import Snapshot
from twin.scenario.schema import Scenario


@dataclass(frozen=True)
class Run:
    """A finished run of one rig.

    Attributes:
        scenario: What was asked for.
        record: All channels.
        outcome: How it ended.
        metrics: Its indicators.
        motion: What ball and plate did.
        real_time_factor: Simulated seconds per second of the loop.
        journal: Every condition that was detected.
        account: Timing statistics of a rig in real time.
        snapshots: States of a simulated rig and its controller now and then.
        driven: What a person did that drove it; empty of a run that went by itself.
    """

    scenario: Scenario
    record: Recorder
    outcome: Outcome
    metrics: Metrics
    motion: Motion
    real_time_factor: float
    journal: tuple[Entry, ...] = ()
    account: Mapping[str, Any] = field(default_factory=dict)
    snapshots: tuple[Snapshot, ...] = ()
    driven: Mapping[str, Any] = field(default_factory=dict)

    def summary(self) -> dict[str, Any]:
        """What ``--json`` prints: the indicators and the speed."""
        return {
            "scenario": self.scenario.title,
            **self.metrics.as_dict(),
            "judged_from": self.scenario.metrics.start,
            "real_time_factor": self.real_time_factor,
            "units": UNITS,
            **self.account,
            **({"driven": self.driven} if self.driven else {}),
        }
