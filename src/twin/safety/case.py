"""A row of the fault matrix: what is done, what must come of it, and how a rig came to rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, field
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from controllers.arrays import Array, Mask
from twin.devices.akd import conditions as akd
from twin.devices.akd.config import AkdConfig
from twin.devices.lumio.config import PlausibilityLimits
from twin.emulator.drive import MASTER_SILENT, NO_VOLTAGE, STO_FAULT, UNDERVOLTAGE, Power
from twin.emulator.lockstep import LockstepRig, MotionTrace, PowerChange
from twin.emulator.screen import Protocol
from twin.hal.interface import Condition, Severity

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
    state: tuple[Power, Power]
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
    reached = [each.state if ended else None for each in axes]
    rest = _latest(still, settled) if level else still
    off = _latest(phi.off, theta.off)
    early = np.asarray(motion.time <= begin + within)
    return Reaction(
        stopped_by=(phi.stopper, theta.stopper),
        state=(reached[0] or trace.state(0, end), reached[1] or trace.state(1, end)),
        standstill=None if rest is None else rest - begin,
        torque_off=None if off is None else off - begin,
        torque=trace.live,
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


Act = Callable[[LockstepRig], None]


BRING_UP = akd.NODE_ABSENT.within
"""Longest time in s from switching on to drives that could be enabled, or a refusal."""
REACHED = {
    Stopper.NOBODY: Power.OPERATION_ENABLED,
    Stopper.LEVELLING: Power.OPERATION_ENABLED,
    Stopper.QUICK_STOP: Power.SWITCH_ON_DISABLED,
    Stopper.LOST_TORQUE: Power.SWITCH_ON_DISABLED,
    Stopper.HEARTBEAT: Power.FAULT,
    Stopper.STO: Power.FAULT,
    Stopper.DRIVE: Power.FAULT,
}
"""The state that a stop must lead to: with torque, held level; else without."""


@dataclass(frozen=True)
class FaultCase:
    """One fault done on purpose, and what must come of it: a row of the matrix.

    Attributes:
        name: What is done, in words.
        act: Does it.
        expected: The condition that must be reported; None if nothing may come of it.
        before: Whether it is done before the rig is switched on; a condition must refuse that.
        protocol: What the touch screen speaks.
        resting: Whether the ball rests instead of tracking the circle.
        stubborn: Whether a reset must be refused as long as the cause is there.
        of_screen: Whether it shows in the screen's bytes, a dead time and a frame later.
        first: The condition that stops the rig, where it shows before the expected one.
        stopped_by: Who must stop phi and theta; empty for what the condition's severity says.
        states: The states that phi and theta must reach; empty for those of ``REACHED``.
        says: What the line that a person reads must contain.
        wait: What passes in s before the device concerned is asked, when switching on.
        withheld: Whether the host is left with nothing but to end its heartbeat.
        hangs: Whether the host hangs: it detects nothing, so that the drives' detection counts.
        speed: Plate rate in rad/s that the fault itself brings about.
        slow: How many times longer than meant a control period lasts.
        shoved: For how long in s the plate is turned with ``speed`` by force.
        begins: Tells when the fault is there, of a cause that takes its time; the act starts it.
        goes: Whether the ball is on its way off the plate, so that nothing can keep it there.
        zeroed: Whether the zero rate of a stop brakes the drives, whoever ends their torque.
        host: Settings of the drives.
        gate: Thresholds of the touch screen.
    """

    name: str
    act: Act
    expected: Condition | None
    _: KW_ONLY
    before: bool = False
    protocol: Protocol = Protocol.MICROTOUCH
    resting: bool = False
    stubborn: bool = False
    of_screen: bool = False
    first: Condition | None = None
    stopped_by: tuple[Stopper, ...] = ()
    states: tuple[Power, ...] = ()
    says: str = ""
    wait: float = 0.0
    withheld: bool = False
    hangs: bool = False
    speed: float = 0.0
    slow: float = 1.0
    shoved: float = 0.0
    begins: Callable[[LockstepRig], bool] = lambda _: True
    goes: bool = False
    zeroed: bool = False
    host: AkdConfig = field(default_factory=AkdConfig)
    gate: PlausibilityLimits = field(default_factory=PlausibilityLimits)

    @property
    def refused(self) -> bool:
        """Whether the rig must not be switched on."""
        return self.before and self.severity not in {None, Severity.WARNING}

    @property
    def severity(self) -> Severity | None:
        """Severity of the expected condition."""
        return self.expected.severity if self.expected else None

    @property
    def reason(self) -> str:
        """Name of the condition for which the rig must end up as it does; empty if for none."""
        reason = self.first or self.expected
        if reason is None or reason.severity is Severity.WARNING:
            return ""
        return reason.name

    @property
    def stoppers(self) -> tuple[Stopper, ...]:
        """Who must stop phi and theta."""
        if self.stopped_by:
            return self.stopped_by
        if self.refused or not self.reason:
            return Stopper.NOBODY, Stopper.NOBODY
        level = (self.first or self.expected).severity is Severity.LEVEL  # type: ignore[union-attr]
        return (Stopper.LEVELLING if level else Stopper.QUICK_STOP,) * 2

    @property
    def reached(self) -> tuple[Power, ...]:
        """States that phi and theta must reach."""
        if self.states:
            return self.states
        if self.refused:
            return Power.SWITCH_ON_DISABLED, Power.SWITCH_ON_DISABLED
        return tuple(REACHED[stopper] for stopper in self.stoppers)
