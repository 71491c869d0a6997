"""A row of the fault matrix: what is done to a rig, and what must come of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from twin.devices.akd import conditions as akd
from twin.devices.akd.config import AkdConfig
from twin.devices.lumio.config import PlausibilityLimits
from twin.emulator.drive import Power
from twin.emulator.lockstep import LockstepRig
from twin.emulator.screen_bytes import Protocol
from twin.hal.interface import Condition, Severity
from twin.safety.reaction import Stopper

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


@dataclass(frozen=True, kw_only=True)
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
