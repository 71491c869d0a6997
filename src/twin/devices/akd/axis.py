"""One servo axis as the host sees it: newest data, and the control word that follows from them."""

from __future__ import annotations

from twin.devices.akd import cia402, frames
from twin.devices.akd.cia402 import State, Wish
from twin.devices.akd.config import AxisConfig
from twin.devices.akd.scaling import Scale, difference
from twin.devices.akd.stream import Stream

_TORQUE = {State.OPERATION_ENABLED, State.QUICK_STOP, State.UNKNOWN}
_PATIENCE = 8
"""Cycles for which a request to reset stands."""
_STILL = 0.01
"""Motor rate in rad/s that counts as rest."""


class Counter:
    """A 32-bit position counter, unwrapped; implausible steps are left out.

    Args:
        scale: Counts to rad.
        speed: Fastest motion taken for real, rad/s.
        slack: Motion that is always taken for real, rad.
    """

    def __init__(self, scale: Scale, speed: float, slack: float) -> None:
        self.scale = scale
        self.counts = 0
        """Position without wraps and jumps; starts at what the drive says first."""
        self.jump = 0
        """Last step that was left out, in counts; whoever notes it sets it back to 0."""
        self._speed = abs(speed / scale.unit)
        self._slack = abs(slack / scale.unit)
        self._raw: int | None = None

    def take(self, raw: int, elapsed: float) -> int:
        """Take in the drive's counter; elapsed: s since the last; the step taken, in counts."""
        if self._raw is None:
            self.counts = self._raw = raw
            return 0
        step = difference(raw, self._raw)
        self._raw = raw
        if abs(step) > self._speed * elapsed + self._slack:
            self.jump = step
            return 0
        self.counts += step
        return step


class Axis:
    """A drive's newest data, its state, and what it is to do.

    Args:
        config: The axis.
        motor: Counter of the motor encoder.
        plate: Counter of the plate encoder, None if it is not read through the drive.
    """

    def __init__(self, config: AxisConfig, motor: Counter, plate: Counter | None) -> None:
        self.config = config
        self.motor = motor
        self.plate = plate
        self.motion = Stream()
        self.sensors = Stream()
        self.sampled = -float("inf")
        """Time in s of the SYNC that sampled the motor position."""
        self.plate_sampled = -float("inf")
        self.status: int | None = None
        """Status word; None before the first."""
        self.state = State.UNKNOWN
        self.mode: int | None = None
        self.rate = 0.0
        """Measured motor rate at the cam shaft, rad/s."""
        self.nmt: int | None = None
        self.heartbeat = 0.0
        """Time in s at which the last heartbeat arrived."""
        self.booted = False
        """Whether the drive has said since the start that it booted."""
        self.emergencies: list[frames.Emergency] = []
        """The newest emergency messages, at most 16."""
        self.wish = Wish.OFF
        self.target = 0.0
        """Rate to be sent while operation is enabled, rad/s at the cam shaft."""
        self.sent = 0.0
        """Rate sent last, rad/s."""
        self._asked = 0

    @property
    def enabled(self) -> bool:
        """Whether the drive follows its target."""
        return self.state is State.OPERATION_ENABLED and self.wish is Wish.ON

    def take_motion(self, data: frames.Motion, cycle: int, at: float) -> int:
        """Take in TPDO1 that answers a SYNC sent at a time in s; the step in counts."""
        step = self.motor.take(data.position, at - self.sampled)
        self.status, self.mode = data.status, data.mode
        self.state = cia402.state(data.status)
        self.sampled = at
        self.motion.arrive(cycle)
        return step

    def take_sensors(self, data: frames.Sensors, cycle: int, at: float) -> int:
        """Take in TPDO2 that answers a SYNC sent at a time in s; the plate's step in counts."""
        step = 0
        if self.plate is not None and data.plate is not None:
            step = self.plate.take(data.plate, at - self.plate_sampled)
        self.rate = self.config.velocity.value(data.velocity)
        self.plate_sampled = at
        self.sensors.arrive(cycle)
        return step

    def settle_stop(self) -> None:
        """End a quick stop that has brought the drive out of operation, or to rest."""
        resting = self.state is State.QUICK_STOP and abs(self.rate) < _STILL
        if self.wish is Wish.QUICK_STOP and (resting or self.state not in _TORQUE):
            self.wish = Wish.OFF

    def ask_reset(self) -> None:
        """Ask for one rising edge of the reset bit, if the drive is, or soon shows, in fault."""
        self._asked = _PATIENCE

    def output(self) -> bytes:
        """RPDO1 for now: one transition further towards the wish at most."""
        control = cia402.control(self.state, self.wish)
        if self._asked and self.state is State.FAULT:
            # The first cycle has no reset bit yet, so that there is an edge.
            control = cia402.DISABLE_VOLTAGE if self._asked == _PATIENCE else cia402.RESET
        self._asked = max(0, self._asked - 1)
        self.sent = self.target if self.enabled else 0.0
        return frames.target(control, self.config.velocity.counts32(self.sent))
