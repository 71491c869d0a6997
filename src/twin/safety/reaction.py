"""How a rig came to rest: seen from outside, by time, and who stopped which axis."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from controllers.arrays import Array, Mask
from twin.emulator.drive import MASTER_SILENT, NO_VOLTAGE, STO_FAULT, UNDERVOLTAGE, Power
from twin.emulator.lockstep import MotionTrace, PowerChange

STILL = 0.02
"""Plate rate in rad/s that counts as standstill: what levelling commands for one count of the
plate encoders, 0.38 mrad in its time constant of 20 ms."""
LEVEL = float(np.radians(0.3))
"""Plate angle in rad that counts as level: quantisation and noise of the angle, and friction."""


class Stopper(StrEnum):
    """Who ended the motion of an axis, the lines of defence in their order first."""

    LEVELLING = "host's levelling"
    QUICK_STOP = "host's quick stop"
    HEARTBEAT = "drive's heartbeat watch"
    STO = "safe torque off"
    DRIVE = "the drive itself"
    """By a stop of its own: its fault reaction, or a quick stop that nobody here asked for."""
    LOST_TORQUE = "loss of torque"
    """Nobody: the fault took the torque away, and the motor runs out."""
    NOBODY = "nobody"


@dataclass(frozen=True)
class Reaction:
    """What became of a rig between a fault and the end of the observation; times from the fault.

    Attributes:
        stopped_by: Who stopped phi and theta.
        states: The states that were reached: with torque where the plate was levelled or goes on,
            else the first without.
        standstill: From when on, in s, the plate stands (and is level if it must be); None if it
            does not.
        torque_off: When the last drive lost its torque, s; None if one never did.
        live: Whether a drive has torque at the end.
        tilt: Largest plate angle, rad.
        ball: Largest distance of the ball from the plate's centre along x and y until the plate
            must stand, m.
        ball_later: The same over the whole observation.
    """

    stopped_by: tuple[Stopper, Stopper]
    states: tuple[Power, Power]
    standstill: float | None
    torque_off: float | None
    live: bool
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
    reached = [each.state if ended else None for each in axes]
    rest = _latest(still, settled) if level else still
    off = _latest(phi.off, theta.off)
    early = np.asarray(motion.time <= begin + within)
    return Reaction(
        stopped_by=(phi.stopper, theta.stopper),
        states=(reached[0] or trace.state(0, end), reached[1] or trace.state(1, end)),
        standstill=None if rest is None else rest - begin,
        torque_off=None if off is None else off - begin,
        live=trace.live,
        tilt=float(motion.tilt.max(initial=0.0)),
        ball=_farthest(motion.ball[early]),
        ball_later=_farthest(motion.ball),
    )


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
