"""The fault matrix: each fault done to an emulated rig that tracks a circle, and its evaluation.

The outcome is how the rig came to rest; a row states it in words. It runs in virtual time:
the same on every machine.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array, Mask
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
from twin.emulator.lockstep import LockstepRig, MotionTrace, PowerChange
from twin.emulator.power_stage import (
    MASTER_SILENT,
    NO_VOLTAGE,
    STO_FAULT,
    UNDERVOLTAGE_FAULT,
    Power,
)
from twin.emulator.screen import FRAME_INTERVAL_S, SCREEN_DEAD_TIME_S
from twin.emulator.serve import Wiring
from twin.hal.interface import Severity
from twin.run.controller_building import build_controller
from twin.run.loop import drive
from twin.run.metrics import Ending, Outcome
from twin.run.record import Recorder
from twin.safety.faults import CASES
from twin.safety.limits import (
    LEVEL_RAD,
    STANDSTILL_RAD_S,
    AtFault,
    FaultCase,
    Stopper,
    ball_limit,
    standstill_limit,
    tilt_limit,
    torque_off_limit,
)
from twin.scenario.load import check
from twin.scenario.schema import Scenario


@dataclass(frozen=True, kw_only=True)
class Reaction:
    """Observation of a rig between a fault and the end; times from the fault.

    Attributes:
        stopped_by: Who stopped phi and theta: a ``Stopper``, or of other hardware its own word.
        state: The states that were reached: with torque where the plate was levelled or goes on,
            else the first without.
        standstill: From when on, in s, the plate stands (and is level if it must be); None if it
            does not.
        torque_off: When the last drive lost its torque, s; None if one never did.
        torque: Whether a drive has torque at the end.
        tilt: Largest plate angle, rad.
        ball: Largest distance of the ball from the plate's centre along x and y until the plate
            must stand, m.
        ball_later: The same over the whole observation.
    """

    stopped_by: tuple[str, str]
    state: tuple[str, str]
    standstill: float | None
    torque_off: float | None
    torque: bool
    tilt: float
    ball: tuple[float, float]
    ball_later: tuple[float, float]


def reaction(
    trace: MotionTrace, begin: float, end: float, *, within: float, ended: bool, level: bool
) -> Reaction:
    """The reaction to a fault.

    Args:
        trace: What was seen.
        begin: Bus time of the fault, s.
        end: Bus time up to which it is evaluated, s.
        within: Time in s from the fault to which the ball is followed in ``Reaction.ball``.
        ended: Whether a run was ended; else the states at the end are those reached, and nobody
            has levelled.
        level: Whether a plate must be level to count as standing.
    """
    motion = trace.between(begin, end)
    settled = _lasting(motion.time, motion.tilt < LEVEL_RAD) if ended else None
    still = _lasting(motion.time, motion.speed < STANDSTILL_RAD_S)
    changes = [each for each in trace.changes if begin <= each.time <= end]
    axes = [_axis([each for each in changes if each.axis == axis], settled) for axis in (0, 1)]
    stoppers, reached, offs = zip(*axes, strict=True)
    states = [(each if ended else None) or trace.state(n, end) for n, each in enumerate(reached)]
    rest = _latest(still, settled) if level else still
    off = _latest(*offs)
    early = np.asarray(motion.time <= begin + within)
    return Reaction(
        stopped_by=stoppers,
        state=(in_words(states[0]), in_words(states[1])),
        standstill=None if rest is None else rest - begin,
        torque_off=None if off is None else off - begin,
        torque=trace.live,
        tilt=float(motion.tilt.max(initial=0.0)),
        ball=_farthest(motion.ball[early]),
        ball_later=_farthest(motion.ball),
    )


def in_words(state: Power) -> str:
    """A state as CiA 402 calls it."""
    return state.name.lower().replace("_", " ")


def _axis(
    changes: list[PowerChange], settled: float | None
) -> tuple[Stopper, Power | None, float | None]:
    """Who stopped an axis, the state it reached if not only at the end, when its torque went.

    Args:
        changes: Those of its drive since the fault.
        settled: From when on the plate was level, bus time in s; None if it was not.
    """
    left = next((each for each in changes if each.before is Power.OPERATION_ENABLED), None)
    off = next((each for each in changes if each.lost), None)
    time = off.time if off else None
    if settled is not None and (left is None or settled <= left.time):
        return Stopper.LEVELLING, Power.OPERATION_ENABLED, time
    return _who(left), off.after if off else None, time


def _who(left: PowerChange | None) -> Stopper:
    """Who took a drive out of operation."""
    if left is None:
        return Stopper.NOBODY
    if left.fault == MASTER_SILENT:
        return Stopper.HEARTBEAT
    if left.fault == STO_FAULT:
        return Stopper.STO
    lost = left.fault in {UNDERVOLTAGE_FAULT, NO_VOLTAGE} or (left.lost and not left.fault)
    if left.injected or left.fault:
        return Stopper.LOST_TORQUE if lost else Stopper.DRIVE
    return Stopper.QUICK_STOP if left.after is Power.QUICK_STOP else Stopper.LOST_TORQUE


def _lasting(time: Array, holds: Mask) -> float | None:
    """From when on something holds to the end; None if it does not."""
    failing = np.flatnonzero(~holds)
    if not failing.size:
        return float(time[0]) if time.size else None
    after = int(failing[-1]) + 1
    return float(time[after]) if after < time.size else None


def _latest(one: float | None, other: float | None) -> float | None:
    return None if one is None or other is None else max(one, other)


def _farthest(ball: Array) -> tuple[float, float]:
    x, y = np.abs(ball).max(axis=0, initial=0.0).tolist()
    return x, y


FAULT_HEADINGS = (
    "fault",
    "reported",
    "detected [ms]",
    "standstill [ms]",
    "tilt [deg]",
    "ball x, y [mm]",
    "stopped by",
    "reached",
    "run",
)
"""Headings of the cells of a row; a value is followed by its limit."""


def failure_sheet(rows: Sequence[FaultRow]) -> tuple[tuple[str, ...], list[tuple[Any, ...]]]:
    """Headings and rows of a failure mode and effects sheet; times in s, angles in deg, ways in m.

    The effect of a fault is the motion of plate and ball until the rig stood still.
    """
    headings = (
        *("fault", "effect: largest tilt [deg]", "effect: way of the ball x [m]"),
        *("effect: way of the ball y [m]", "detection: condition", "detection: time [s]"),
        *("detection: limit [s]", "reaction: severity", "reaction: stopped by", "reaction: state"),
        *("reaction: standstill [s]", "end of the run", "verdict"),
    )
    lines = [
        (
            row.name,
            round(math.degrees(row.tilt), 3),
            *(round(way, 5) for way in row.ball),
            row.condition or "none",
            _seconds(row.detected),
            _seconds(row.allowed) if row.condition else None,
            row.severity,
            both(row.stopped_by),
            both(row.state),
            _seconds(row.standstill),
            row.ending,
            "good" if row.good else f"BAD: {', '.join(row.failures)}",
        )
        for row in rows
    ]
    return headings, lines


def _seconds(value: float | None) -> float | None:
    return None if value is None else round(value, 4)


def cells(row: FaultRow) -> tuple[str, ...]:
    """The cells of a row."""
    reported = row.condition or "none"
    if row.reason not in {"", row.condition}:
        reported += f" (ended by: {row.reason})"
    return (
        row.name,
        reported,
        _of(row.detected, row.allowed, 1e3) if row.condition else "-",
        _of(row.standstill, row.standstill_limit, 1e3) if row.standstill_limit else "-",
        _of(row.tilt, row.tilt_limit, math.degrees(1), 2),
        f"{_pair(row.ball)} of {_pair(row.ball_limit)}",
        both(row.stopped_by),
        both(row.state),
        row.ending,
    )


def both(names: Sequence[str]) -> str:
    """What holds for phi and theta, in one word where it is the same."""
    phi, theta = names
    return phi if phi == theta else f"phi: {phi}, theta: {theta}"


def _of(value: float | None, limit: float | None, factor: float, digits: int = 0) -> str:
    seen = "not" if value is None else f"{factor * value:.{digits}f}"
    return seen if limit is None else f"{seen} of {factor * limit:.{digits}f}"


def _pair(ways: tuple[float, float]) -> str:
    return ", ".join(f"{1e3 * way:.0f}" for way in ways)


Pair = tuple[float, float]
Names = tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class FaultRow(Reaction):
    """Result of one case; the keys of ``--json``.

    Times are in s from the injection, or from switching on; angles in rad, ways in m. Pairs are
    those of phi and theta, or of x and y. A key that ends in ``_limit`` or ``_expected`` is the
    bound or value with which the key before it is compared.

    Attributes:
        name: What was done.
        condition: The condition that had to be reported; empty if none.
        severity: Its severity.
        allowed: Longest time to its detection.
        detected: Time to its detection; None if it was not. Where the host hangs, the time to
            the first drive that stops by itself.
        ending: How the run ended.
        line: The one line that a person reads; empty if the run finished.
        safe: Whether the plate was safe: every key checked below is as it must be, and no drive has
            torque at the end.
        whole: Whether every period up to the end is in the record, without gaps.
        recovered: Whether it runs again after the cause was removed and a person asks for it.
        reason: The condition that ended the run; empty if none did.
        reason_expected: The one that had to.
        stopped_by: Who stopped the axes.
        stopped_by_expected: Who had to.
        state: The drives' states that were reached: with torque where the plate was levelled or
            the run went on, else the first without.
        state_expected: Those that had to be.
        standstill: From when on the plate stood, and was level if it had to be levelled; None if it
            did not, or did not have to.
        standstill_limit: None where nothing has to stop.
        torque_off: When the last drive lost its torque; None if one did not.
        torque_off_limit: None where the plate is held.
        tilt: Largest plate angle after the fault.
        tilt_limit: Its limit.
        ball: Largest distances of the ball from the plate's centre after the fault, until the
            plate has to stand; on a plate that is left tilted it rolls on.
        ball_limit: Their limits.
        ball_later: The same over the whole observation; not evaluated.
        torque: Whether a drive has torque at the end of the observation.
        held: Whether the drives held the limits of torque and speed when the fault began.
        says: Whether the line contains the required text.
        failures: The keys that are not as they must be.
        good: Whether there are none.
    """

    name: str
    condition: str
    severity: str
    allowed: float
    detected: float | None
    ending: str
    line: str
    whole: bool
    recovered: bool
    reason: str
    reason_expected: str
    stopped_by_expected: Names
    state_expected: Names
    standstill_limit: float | None
    torque_off_limit: float | None
    tilt_limit: float
    ball_limit: Pair
    held: bool
    says: bool

    @property
    def _safe_by_key(self) -> dict[str, bool]:
        stop, off = self.standstill_limit, self.torque_off_limit
        return {
            "stopped_by": self.stopped_by == self.stopped_by_expected,
            "state": self.state == self.state_expected,
            "standstill": stop is None or _within(self.standstill, stop),
            "torque_off": off is None or _within(self.torque_off, off),
            "tilt": _within(self.tilt, self.tilt_limit),
            "ball": all(map(_within, self.ball, self.ball_limit)),
            "torque": not self.torque,
            "held": self.held,
        }

    @property
    def safe(self) -> bool:
        """Whether the plate was safe."""
        return all(self._safe_by_key.values())

    @property
    def failures(self) -> Names:
        """Keys of what is not as it must be."""
        right_by_key = {
            "detected": not self.condition or _within(self.detected, self.allowed),
            "reason": self.reason == self.reason_expected,
            "line": self.says,
            **self._safe_by_key,
            "whole": self.whole,
            "recovered": self.recovered,
        }
        return tuple(key for key, right in right_by_key.items() if not right)

    @property
    def good(self) -> bool:
        """Whether the fault was detected in time, answered safely, recorded, recovered from."""
        return not self.failures

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``."""
        more = {"safe": self.safe, "good": self.good, "failures": self.failures}
        return {**asdict(self), **more}


def _within(value: float | None, limit: float) -> bool:
    return value is not None and value <= limit + 1e-6


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
