"""The fault matrix: each fault done to an emulated rig that tracks a circle, in virtual time.

A case is a rig of its own and gives the same row on every machine.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.controller import Controller
from twin.base.data_file import read_packaged
from twin.base.errors import TwinError
from twin.base.jobs import results
from twin.devices.akd.conditions import STOP_IGNORED, DriveError
from twin.devices.akd.config import AkdConfig
from twin.devices.lumio.conditions import UNPLUGGED
from twin.devices.lumio.config import HID_PANELS, LumioConfig, ScreenError
from twin.devices.rig import StartRefusedError
from twin.emulator.drive import EmulatedDrive
from twin.emulator.lockstep import LockstepRig, MotionTrace
from twin.emulator.screen import FRAME_INTERVAL_S, SCREEN_DEAD_TIME_S
from twin.emulator.serve import Wiring
from twin.hal.interface import Severity
from twin.run.controller_building import build_controller
from twin.run.loop import drive
from twin.run.metrics import Ending, Outcome
from twin.run.record import Recorder
from twin.safety.fault_row import FaultRow
from twin.safety.faults import CASES
from twin.safety.limits import (
    AtFault,
    FaultCase,
    Stopper,
    ball_limit,
    standstill_limit,
    tilt_limit,
    torque_off_limit,
)
from twin.safety.reaction import Reaction, in_words, reaction
from twin.scenario.load import check
from twin.scenario.schema import Scenario


def tracking(duration: float, *, resting: bool) -> Scenario:
    """The circle, quickly under way, on the exact plant, with friction.

    Args:
        duration: In s.
        resting: Whether the ball is held in the middle instead.
    """
    tables = read_packaged("twin.safety", "tracking.toml") | {"duration": duration}
    if resting:
        tables["reference"] = {"kind": "hold"}
    return check(tables, "fault matrix")


FAULT_BEGIN_S = 2.0
"""When a fault begins, s: the ball runs at full speed by then."""
RUN_AFTER_S = 2.6
"""How long the rig runs from then on, s."""
WATCH_AFTER_S = 1.5
"""How long it is watched after a run that was ended, s: motors without torque run out."""
RECOVERY_RUN_S = 0.5
"""How long it runs after it has been recovered, s."""


_CURRENT_OBJECTS, _SPEED_OBJECTS, _PER_AMPERE = (0x356E, 0x356F), (0x207F, 0x3622, 0x3623), 0x3593
"""Objects of a drive: peak currents in 0.001 A, speeds in 0.001 rpm, torque in 0.001 N m/A."""
_UNIT_ROUNDING = 1.02
"""What the drives' units of current and speed may add to a limit."""


class TrialRun(NamedTuple):
    """How a run ended, its record, and the error with which switching on was refused."""

    outcome: Outcome
    record: Recorder
    refusal: TwinError | None


class Trial:
    """One rig, one case.

    Args:
        case: What is done, and what must come of it.
    """

    def __init__(self, case: FaultCase) -> None:
        self.case = case
        self.scenario = tracking(FAULT_BEGIN_S + RUN_AFTER_S, resting=case.resting)
        screen = LumioConfig(
            port="emulated",
            transport="hidraw" if case.protocol in HID_PANELS else "serial",
            protocol=str(case.protocol),
            gate=case.gate,
        )
        self.rig = LockstepRig(
            self.scenario,
            config=case.host,
            touch=screen,
            protocol=case.protocol,
            relaxed=(*case.host.relaxed, *screen.gate.relaxed),
        )
        self.trace = MotionTrace(self.rig)
        self.drives = list(self.rig.lockstep.drives)
        self.begun: float | None = None if not case.before else self.rig.now()
        """Bus time of the fault, s."""
        self._acted = case.before
        self._held = True
        self._state = np.zeros(8)
        """Of (5.5), when the fault began; zero before a run."""
        self.time_begun = 0.0
        """Time of the run at the fault, s."""
        self.last = self.rig.now()
        """Bus time of the newest period in the record, s."""

    def row(self, *, recover: bool = True) -> FaultRow:
        """Carry the case out and judge it; recover: whether the rig must run again, too."""
        case, expected = self.case, self.case.expected
        run = self._run(self.scenario.duration, act=True)
        refused_at = self.rig.now() if run.refusal else None
        allowed = self._allowed()
        x, x_rate, plate, plate_rate = np.abs(self._state).reshape(2, 4).T
        at = AtFault(float(plate.max()), float(plate_rate.max()), x, x_rate)
        seen, stop = self._seen(run, allowed, at)
        line = str(run.refusal) if run.refusal else run.outcome.reason
        return FaultRow(
            name=case.name,
            condition=expected.name if expected else "",
            severity=str(expected.severity) if expected else "",
            allowed=allowed,
            detected=self._detected(refused_at),
            ending="refused" if run.refusal else str(run.outcome.ending),
            line=line,
            says=case.required_text in line,
            whole=bool(run.refusal) or self._whole(run),
            recovered=not recover or self._recovers(),
            reason=self._reason(run),
            reason_expected=case.reason,
            stopped_by_expected=case.stoppers,
            state_expected=tuple(map(in_words, case.reached)),
            held=self._held,
            tilt_limit=tilt_limit(case, allowed, stop, at),
            ball_limit=ball_limit(case, allowed, stop, at),
            standstill_limit=stop,
            torque_off_limit=torque_off_limit(case, allowed, stop),
            **vars(seen) | {"standstill": seen.standstill if stop is not None else None},
        )

    def _run(self, duration: float, *, act: bool) -> TrialRun:
        controller: Controller = build_controller(self.scenario)
        record = Recorder(round(duration / self.rig.period), 1, self.rig.period)
        if act and self.case.before:
            self._act()
        if act:
            record.observers.append(self._observe)
        try:
            (outcome,) = drive(self.rig, controller, duration, record)
        except TwinError as error:
            return TrialRun(Outcome(Ending.FAULT, 0.0), record, error)
        return TrialRun(outcome, record, None)

    def _observe(self, time: float, _: Mapping[str, NDArray[Any]]) -> None:
        self.last = self.rig.now()
        if not self._acted and time >= FAULT_BEGIN_S:
            self._acted = True
            self._held = all(holds_limits(drive, self.case.host) for drive in self.drives)
            self._act()
        if self._acted and self.begun is None and self.case.begins(self.rig):
            self.begun, self.time_begun = self.last, time
            self._state = self.rig.plant.devices.state[0].copy()

    def _act(self) -> None:
        self.case.act(self.rig)
        self.trace.note_injection()

    def _allowed(self) -> float:
        """Longest time to the detection, s."""
        case = self.case
        if case.hangs:
            silence = case.host.silence if Stopper.HEARTBEAT in case.stoppers else 0.0
            return silence + self.rig.period
        late = SCREEN_DEAD_TIME_S + FRAME_INTERVAL_S + self.rig.period if case.of_screen else 0.0
        return case.expected.longest(self.rig.period) + late + case.wait if case.expected else 0.0

    def _seen(self, run: TrialRun, allowed: float, at: AtFault) -> tuple[Reaction, float | None]:
        """The reaction, and the longest time to standstill."""
        stop = standstill_limit(self.case, allowed, at) if not self.case.refused else None
        finished = run.outcome.ending is Ending.FINISHED and not run.refusal
        if not finished:
            self.rig.sleep(WATCH_AFTER_S)
        ended = not finished and not run.refusal
        begun = self.begun if self.begun is not None else self.last
        end = self.last if finished else self.rig.now()
        within = np.inf if stop is None else stop
        level = Stopper.LEVELLING in self.case.stoppers
        return reaction(self.trace, begun, end, within=within, ended=ended, level=level), stop

    def _detected(self, refused_at: float | None) -> float | None:
        if self.case.expected is None or self.begun is None:
            return None
        if refused_at is not None:
            return refused_at - self.begun
        if self.case.hangs:
            own = [each.time for each in self.trace.changes if each.time > self.begun]
            return own[0] - self.begun if own else None
        for time, note in self.rig.journal:
            if note.condition.name == self.case.expected.name and time >= self.time_begun:
                return time - self.time_begun
        return None

    def _reason(self, run: TrialRun) -> str:
        """Name of the condition that ended the run; empty if none did."""
        error = run.refusal
        if isinstance(error, StartRefusedError | DriveError):
            return error.fault.condition.name
        if error is not None:
            return UNPLUGGED.name if isinstance(error, ScreenError) else type(error).__name__
        for _, note in self.rig.journal:
            if note.condition.severity is not Severity.WARNING:
                return note.condition.name
        return ""

    def _whole(self, run: TrialRun) -> bool:
        record = run.record
        if not record.length:
            return False
        gaps = np.diff(record.time)
        kept = all(np.isfinite(record[name]).all() for name in ("measured", "estimate", "applied"))
        end = self.time_begun if self.case.hangs else run.outcome.time
        return kept and bool((gaps > 0).all()) and record.end >= end - self.rig.period

    def _recovers(self) -> bool:
        """Remove the cause, put the ball back, and run again on request."""
        rig = self.rig
        if self.case.stubborn and self._again().refusal is None:
            return False
        rig.lockstep.bus.drives[:] = self.drives
        rig.lockstep.bus.faults.clear()
        rig.lockstep.adapter.plugged = rig.port.plugged = rig.plant.present = True
        rig.line.clear()
        rig.stall = rig.uneven = 0.0
        rig.asked = None
        rig.line.protocol = self.case.protocol
        rig.replace_transmission(rig.plant.transmission)
        rig.plant.shoved = np.zeros(2)
        rig.plant.rewire(**Wiring()._asdict())
        rig.lockstep.bus.foreign_frames.clear()
        rig.lockstep.missing = None
        for each in self.drives:
            each.restore()
        rig.plant.restart()
        before = len(rig.journal)
        run = self._again()
        serious = [
            entry.note.condition.name
            for entry in rig.journal[before:]
            if entry.note.condition.severity is not Severity.WARNING
            and entry.note.condition != STOP_IGNORED
        ]
        return run.outcome.ending is Ending.FINISHED and run.refusal is None and not serious

    def _again(self) -> TrialRun:
        """Run once more, as a person does with ``--reset``."""
        self.rig.reset = True
        return self._run(RECOVERY_RUN_S, act=False)


def holds_limits(drive: EmulatedDrive, host: AkdConfig) -> bool:
    """Whether torque and speed that a drive allows are at most those the host is set to."""
    held = {
        key: abs(drive.store.get(key)) for key in (*_CURRENT_OBJECTS, *_SPEED_OBJECTS, _PER_AMPERE)
    }
    unit = drive.parameter_count
    torques = [held[key] * unit * held[_PER_AMPERE] * 1e-3 for key in _CURRENT_OBJECTS]
    speeds = [held[key] * unit * math.pi / 30 for key in _SPEED_OBJECTS]
    return (
        max(torques) <= host.torque_limit * _UNIT_ROUNDING
        and max(speeds) <= host.rate_limit * _UNIT_ROUNDING
    )


def run_case(index: int) -> FaultRow:
    """Carry out one case; index: in ``CASES``."""
    return Trial(CASES[index]).row()


def run_all(
    processes: int, progress: Callable[[float], None], indices: Sequence[int] = range(len(CASES))
) -> list[FaultRow]:
    """Carry out cases, in their order.

    Args:
        processes: How many to run at the same time.
        progress: Called with the number of cases done.
        indices: Of ``CASES``; all by default.
    """
    rows: dict[int, FaultRow] = {}
    for index, row in results(run_case, zip(indices, indices, strict=True), processes):
        rows[index] = row
        progress(len(rows))
    return [rows[index] for index in indices]
