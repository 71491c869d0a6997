"""What came of a fault: how the rig came to rest, and the judged row of the matrix, in words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from controllers.arrays import Array, Mask
from twin.emulator.drive import MASTER_SILENT, NO_VOLTAGE, STO_FAULT, UNDERVOLTAGE, Power
from twin.emulator.lockstep import MotionTrace, PowerChange
from twin.safety.case import LEVEL, STILL, Stopper


@dataclass(frozen=True, kw_only=True)
class Reaction:
    """What became of a rig between a fault and the end of the observation; times from the fault.

    Attributes:
        stopped_by: Who stopped phi and theta.
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

    stopped_by: tuple[Stopper, Stopper]
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
        end: Bus time to which it is judged, s.
        within: Time in s from the fault to which the ball is followed in ``Reaction.ball``.
        ended: Whether a run was ended; else the states at the end are those reached, and nobody
            has levelled.
        level: Whether a plate must be level to count as standing.
    """
    motion = trace.between(begin, end)
    settled = _lasting(motion.time, motion.tilt < LEVEL) if ended else None
    still = _lasting(motion.time, motion.speed < STILL)
    changes = [each for each in trace.changes if begin <= each.time <= end]
    axes = [_axis([each for each in changes if each.axis == axis], settled) for axis in (0, 1)]
    phi, theta = axes
    states = [(each.state if ended else None) or trace.state(n, end) for n, each in enumerate(axes)]
    rest = _latest(still, settled) if level else still
    off = _latest(phi.off, theta.off)
    early = np.asarray(motion.time <= begin + within)
    return Reaction(
        stopped_by=(phi.stopper, theta.stopper),
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


class _Axis(NamedTuple):
    """Who stopped an axis, the state it reached if not only at the end, when its torque went."""

    stopper: Stopper
    state: Power | None
    off: float | None


def _axis(changes: list[PowerChange], settled: float | None) -> _Axis:
    """What happened to an axis.

    Args:
        changes: Those of its drive since the fault.
        settled: From when on the plate was level, bus time in s; None if it was not.
    """
    left = next((each for each in changes if each.before is Power.OPERATION_ENABLED), None)
    off = next((each for each in changes if each.lost), None)
    time = off.time if off else None
    if settled is not None and (left is None or settled <= left.time):
        return _Axis(Stopper.LEVELLING, Power.OPERATION_ENABLED, time)
    return _Axis(_who(left), off.after if off else None, time)


def _who(left: PowerChange | None) -> Stopper:
    """Who took a drive out of operation."""
    if left is None:
        return Stopper.NOBODY
    if left.fault == MASTER_SILENT:
        return Stopper.HEARTBEAT
    if left.fault == STO_FAULT:
        return Stopper.STO
    lost = left.fault in {UNDERVOLTAGE, NO_VOLTAGE} or (left.lost and not left.fault)
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


HEADING = (
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
"""What the cells of a row are; a value is followed by its limit."""


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
    """What came of one case; the keys of ``--json``.

    Times are in s from the injection, or from switching on; angles in rad, ways in m. Pairs are
    those of phi and theta, or of x and y. A key that ends in ``_limit`` or ``_expected`` is what
    the one before it is judged by.

    Attributes:
        name: What was done.
        condition: The condition that had to be reported; empty if none.
        severity: Its severity.
        allowed: Longest time to its detection.
        detected: Time to its detection; None if it was not. Where the host hangs, the time to
            the first drive that stops by itself.
        ending: How the run ended.
        line: The one line that a person reads; empty if the run finished.
        safe: Whether the plate was safe: every key judged below is as it must be, and no drive has
            torque at the end.
        whole: Whether every period up to the end is in the record, without gaps.
        recovered: Whether it runs again when the cause is gone and a person asks for it.
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
        ball_later: The same over the whole observation; not judged.
        torque: Whether a drive has torque at the end of the observation.
        held: Whether the drives held the limits of torque and speed when the fault began.
        says: Whether the line says what it must.
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
    def _judged(self) -> dict[str, bool]:
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
        return all(self._judged.values())

    @property
    def failures(self) -> Names:
        """Keys of what is not as it must be."""
        judged = {
            "detected": not self.condition or _within(self.detected, self.allowed),
            "reason": self.reason == self.reason_expected,
            "line": self.says,
            **self._judged,
            "whole": self.whole,
            "recovered": self.recovered,
        }
        return tuple(key for key, right in judged.items() if not right)

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
