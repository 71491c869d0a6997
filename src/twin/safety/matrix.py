"""The fault matrix: every case done to an emulated rig that tracks a circle, and judged.

It runs in virtual time: the same on every machine.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.stack import Controller
from twin.devices.akd.conditions import STOP_IGNORED
from twin.emulator.lockstep import LockstepRig
from twin.emulator.screen import DEAD_TIME, FRAME
from twin.emulator.virtual import EmulatedPlant
from twin.errors import TwinError
from twin.hal.faults import Severity
from twin.jobs import results
from twin.run.assemble import build_limits
from twin.run.control import build_controller
from twin.run.loop import Ending, Outcome, drive
from twin.run.record import Recorder
from twin.safety.cases import CASES, FaultCase
from twin.scenario.load import check
from twin.scenario.schema import Scenario

BEGIN = 2.0
"""When a fault begins, s: the ball runs at full speed by then."""
AFTER = 2.6
"""How long the rig is watched from then on, s."""
AGAIN = 0.5
"""How long it runs after it has been recovered, s."""
STILL = 0.02
"""Motor rate in rad/s that counts as standstill."""
LEVEL = np.radians(0.3)
"""Plate angle that counts as level: quantisation and noise of the angle, and friction."""


@dataclass(frozen=True)
class FaultRow:
    """What came of one case.

    Attributes:
        name: What was done.
        condition: The condition that had to be reported; empty if none.
        severity: Its severity.
        allowed: Longest time to its detection, s.
        detected: Time to its detection, s; None if it was not.
        ending: How the run ended.
        line: The one line that a person reads; empty if the run finished.
        safe: Whether the plate was safe: motors at rest after a stop, level after a level, and the
            run unharmed by a warning.
        whole: Whether every period up to the end is in the record, without gaps.
        recovered: Whether it runs again when the cause is gone and a person asks for it.
    """

    name: str
    condition: str
    severity: str
    allowed: float
    detected: float | None
    ending: str
    line: str
    safe: bool
    whole: bool
    recovered: bool

    @property
    def good(self) -> bool:
        """Whether the fault was detected in time, safe, recorded and recovered from."""
        in_time = not self.condition or (
            self.detected is not None and self.detected <= self.allowed + 1e-6
        )
        return in_time and self.safe and self.whole and self.recovered

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``."""
        return {**asdict(self), "good": self.good}


def scenario(*, resting: bool = False) -> Scenario:
    """The circle that is tracked: quickly under way, on the exact plant, with friction."""
    circle = {"kind": "circle", "amplitude": 0.1, "omega": 1.5, "start": 1.0}
    return check(
        {
            "title": "fault matrix",
            "duration": BEGIN + AFTER,
            "seed": 1,
            "plant": {"kind": "lagrange", "friction": {"rolling_mm": 0.1765}},
            "controller": {"kind": "afl"},
            "predictor": {},
            "reference": {"kind": "hold"} if resting else circle,
        },
        "fault matrix",
    )


def run_case(index: int) -> FaultRow:
    """Carry out one case; index: in ``CASES``."""
    return _Trial(CASES[index]).row()


def run_all(processes: int, progress: Callable[[float], None]) -> list[FaultRow]:
    """Carry out every case.

    Args:
        processes: How many to run at the same time.
        progress: Called with the number of cases done.
    """
    rows: dict[int, FaultRow] = {}
    for index, row in results(run_case, enumerate(range(len(CASES))), processes):
        rows[index] = row
        progress(len(rows))
    return [rows[index] for index in range(len(CASES))]


class _Trial:
    """One rig, one case."""

    def __init__(self, case: FaultCase) -> None:
        self.case = case
        self.scenario = scenario(resting=case.resting)
        plant = EmulatedPlant(self.scenario)
        self.rig = LockstepRig(
            plant,
            transmission=plant.transmission,
            limits=build_limits(self.scenario.rig.limits),
            protocol=case.protocol,
            seed=self.scenario.seed,
        )
        self.begun: float | None = None
        self.drives = list(self.rig.lockstep.drives)

    def row(self) -> FaultRow:
        case, expected = self.case, self.case.expected
        late = DEAD_TIME + FRAME + self.rig.period if case.of_screen else 0.0
        outcome, record, refused = self._run(self.scenario.duration, act=True)
        return FaultRow(
            name=case.name,
            condition=expected.name if expected else "",
            severity=str(expected.severity) if expected else "",
            allowed=expected.within + late if expected else 0.0,
            detected=0.0 if refused else self._detected(),
            ending="refused" if refused else str(outcome.ending),
            line=refused or outcome.reason,
            safe=self._safe(outcome, refused),
            whole=self._whole(record, outcome) or bool(refused),
            recovered=self._recovers(),
        )

    def _run(self, duration: float, *, act: bool) -> tuple[Outcome, Recorder, str]:
        """The outcome, the record, and the line with which switching on was refused."""
        controller: Controller = build_controller(self.scenario)
        record = Recorder(round(duration / self.rig.period), 1, self.rig.period)
        if act and self.case.before:
            self.case.act(self.rig)
        elif act:
            record.observers.append(self._observe)
        try:
            (outcome,) = drive(self.rig, controller, duration, record)
        except TwinError as error:
            return Outcome(Ending.FAULT, 0.0), record, str(error)
        return outcome, record, ""

    def _observe(self, time: float, _: Mapping[str, NDArray[Any]]) -> None:
        if self.begun is None and time >= BEGIN:
            self.begun = self.rig.now()
            self.time_begun = time
            self.case.act(self.rig)

    def _detected(self) -> float | None:
        if self.case.expected is None or self.begun is None:
            return None
        for time, note in self.rig.journal:
            if note.condition.name == self.case.expected.name:
                return time - self.time_begun
        return None

    def _safe(self, outcome: Outcome, refused: str) -> bool:
        expected = self.case.expected
        severity = expected.severity if expected else Severity.WARNING
        if severity is Severity.WARNING:
            return outcome.ending is Ending.FINISHED and not refused
        # The rig has been left: whatever torque there was is gone, and the motors run out.
        self.rig.sleep(1.5)
        resting = all(abs(drive.rate) < STILL for drive in self.drives)
        if severity is Severity.STOP or refused:
            return resting
        plate = self.rig.plant.devices.state[0, 2::4]
        return resting and bool(np.abs(plate).max() < LEVEL)

    def _whole(self, record: Recorder, outcome: Outcome) -> bool:
        if not record.length:
            return False
        gaps = np.diff(record.time)
        kept = all(np.isfinite(record[name]).all() for name in ("measured", "estimate", "applied"))
        return kept and bool((gaps > 0).all()) and record.end >= outcome.time - self.rig.period

    def _recovers(self) -> bool:
        """Remove the cause, put the ball back, and run again on request."""
        rig = self.rig
        rig.ask_reset()
        if self.case.stubborn and not self._run(AGAIN, act=False)[2]:
            return False
        rig.lockstep.bus.drives[:] = self.drives
        rig.lockstep.bus.faults.clear()
        rig.lockstep.adapter.plugged = rig.port.plugged = rig.plant.present = True
        rig.line.damage.clear()
        rig.stall = 0.0
        for each in self.drives:
            each.restore()
        rig.plant.restart()
        before = len(rig.journal)
        outcome, _, refused = self._run(AGAIN, act=False)
        serious = [
            entry.note.condition.name
            for entry in rig.journal[before:]
            if entry.note.condition.severity is not Severity.WARNING
            and entry.note.condition != STOP_IGNORED
        ]
        return outcome.ending is Ending.FINISHED and not refused and not serious
