"""The reaction of an emulated rig to a fault: who stopped each axis, in which state, and when."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controllers.arrays import Array, Mask
from twin.emulator.lockstep import MotionTrace, PowerChange
from twin.emulator.power_stage import (
    MASTER_SILENT,
    NO_VOLTAGE,
    STO_FAULT,
    UNDERVOLTAGE_FAULT,
    Power,
)
from twin.safety.limits import LEVEL_RAD, STANDSTILL_RAD_S, Stopper


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
