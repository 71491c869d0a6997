"""A future: the twin goes on from a moment with what a branch changes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from controllers.interfaces import Measurement
from twin.run.assemble import assemble
from twin.run.files import short_key, slug
from twin.run.finished import Run, record_run
from twin.run.loop import drive
from twin.run.metrics import Motion
from twin.run.record import Recorder
from twin.scenario.schema import Scenario
from twin.whatif.moment import Moment, Recorded, take_over


@dataclass(frozen=True)
class Future:
    """What would have happened.

    Attributes:
        settings: What was changed, ``key=value`` each; none for nothing.
        run: The run from the moment on.
        max_difference: Largest distance in m of its ball from the recorded one, where the record
            goes on; None if it does not.
    """

    settings: tuple[str, ...]
    run: Run
    max_difference: float | None

    @property
    def label(self) -> str:
        """What it is called in pictures and tables."""
        return ", ".join(self.settings) or "unchanged"

    @property
    def name(self) -> str:
        """The label in its shortest form, as the name of its folder."""
        pairs = (text.partition("=") for text in self.settings)
        return slug("-".join(f"{short_key(key)}={value}" for key, _, value in pairs) or self.label)

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "set": [*self.settings],
            **self.run.metrics,
            "max_difference_m": self.max_difference,
        }


def future(moment: Moment, scenario: Scenario, settings: tuple[str, ...]) -> Future:
    """Go on from a moment.

    Args:
        moment: The moment.
        scenario: Of the branch.
        settings: What it changes.

    Raises:
        TwinError: If the branch cannot be assembled.
    """
    rig, controller = assemble(scenario)
    rig.LEVELLING_TIME = 0.0
    period = scenario.rig.period

    def begin(_: Measurement) -> Measurement:
        take_over(controller, moment.controller(), moment.scenario, scenario)
        return moment.put(rig)

    ticks = round(scenario.duration / period) - round(moment.at / period)
    record = Recorder(ticks, 1, period, rig.channels, controller.observer.knows)
    (outcome,) = drive(rig, controller, scenario.duration, record, begin=begin)
    run = Run.of(
        scenario,
        record,
        outcome,
        controller.reference,
        real_time_factor=float("nan"),
        journal=rig.journal,
    )
    return Future(settings, run, difference(moment.recorded, run.motion, period))


def difference(recorded: Recorded, motion: Motion, period: float) -> float | None:
    """Largest distance in m of a motion's ball from the recorded one at the periods of both."""
    ticks = [np.rint(time / period).astype(int) for time in (recorded.time, motion.time)]
    _, known, own = np.intersect1d(*ticks, return_indices=True)
    apart = np.hypot(*(recorded.ball[known] - motion.ball[own]).T)
    apart = apart[np.isfinite(apart)]
    return float(apart.max()) if len(apart) else None


def save(each: Future, moment: Moment, folder: Path) -> None:
    """Write the run folder of a future.

    Raises:
        RecordError: If it cannot be written.
    """
    origin = {"of": moment.name, "at": moment.at, "exact": moment.exact, "set": [*each.settings]}
    record_run(each.run, folder, {"branch": origin})
