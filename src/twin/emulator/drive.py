"""An emulated AKD drive on CANopen: frames in, frames out, time in steps; no clock, no thread.

It has CiA 402's power stage, ramps, faults and STO. Defaults are the documented ones: no heartbeat,
nobody watched, so that it keeps turning when the master goes silent unless 1016h is set;
nothing exchanged before NMT start. Not emulated: event-driven transmit PDOs, which a host that
leaves the defaults does not hear here, storing parameters, node guarding, homing and every mode but
profile velocity (in which the drive turns), the PLL, and the bus's own timing.
"""

from __future__ import annotations

import math
from functools import partial

from twin.emulator.drive_objects import ObjectStore, Pdos, emergency_code, sdo_answer
from twin.emulator.node import EmulatedNode
from twin.emulator.power_stage import Power
from twin.sim.sensors import ENCODER_COUNTS_PER_TURN

RPM = math.pi / 30
VELOCITY_UNIT = 0.001 * RPM
"""One count of 60FFh and 606Ch in rad/s."""
PLATE_PER_MOTOR = 0.2
"""How the second encoder turns with the motor where no plant gives it."""
COASTING_TIME_S = 0.2
"""Time constant in s with which the motor runs out without power."""
STOP_RAMP = 1000.0
"""Deceleration of quick stop and fault reaction in rad/s^2; assumed."""


MOTOR_COUNTS = 1 << 20
"""Counts per motor revolution."""
TURN_RAD = 2 * math.pi


class Encoder:
    """A counter on a shaft, of signed 32 bits.

    Args:
        turn: Counts per revolution.
        start: Its reading at an angle of zero; near 2^31 it soon wraps.
    """

    def __init__(self, turn: int, start: int = 0) -> None:
        self.frozen = False
        self._turn, self._offset, self._shown = turn, start, 0

    @property
    def counts(self) -> int:
        """Its reading, wrapped."""
        return (self._shown + self._offset + (1 << 31)) % (1 << 32) - (1 << 31)

    def jump(self, counts: int) -> None:
        """Let it jump."""
        self._offset += counts

    def look(self, angle: float) -> None:
        """Take in the shaft's angle in rad."""
        if not self.frozen:
            self._shown = math.floor(angle / TURN_RAD * self._turn)


class Motor:
    """Shaft and encoders of a drive.

    Args:
        start_counts: Motor position at power-up.
    """

    def __init__(self, start_counts: int = 0) -> None:
        self.rate = 0.0
        """Shaft rate in rad/s that the drive gives it."""
        self.forced = 0.0
        """Shaft rate in rad/s that somebody gives it besides."""
        self.limited = False
        """Whether the velocity limit cut the target."""
        self.encoder, self.plate = (
            Encoder(MOTOR_COUNTS, start_counts),
            Encoder(ENCODER_COUNTS_PER_TURN),
        )
        self._angle = 0.0
        self._sensed = False

    def sense(self, motor: float, plate: float) -> None:
        """Where shaft and plate are, rad; from now on nothing is integrated here."""
        self._sensed = True
        self._look(motor, plate)

    def follow(
        self, target: float, ramps: tuple[float, float], limits: MotionLimits, dt: float
    ) -> None:
        """Ramp towards a target in rad/s with (acceleration, deceleration) in rad/s^2."""
        clipped = max(limits[0], min(limits[1], target))
        self.limited = clipped != target
        faster = abs(clipped) > abs(self.rate) and clipped * self.rate >= 0
        step = ramps[0 if faster else 1] * dt
        self._go(self.rate + max(-step, min(step, clipped - self.rate)), dt)

    def coast(self, dt: float) -> None:
        """Run out without torque."""
        self.limited = False
        rate = self.rate * math.exp(-dt / COASTING_TIME_S)
        self._go(rate if abs(rate) > 1e-4 else 0.0, dt)

    def _go(self, rate: float, dt: float) -> None:
        if not self._sensed:
            self._angle += (self.rate + rate) / 2 * dt
            self._look(self._angle, PLATE_PER_MOTOR * self._angle)
        self.rate = rate

    def _look(self, motor: float, plate: float) -> None:
        self.encoder.look(motor)
        self.plate.look(plate)


MotionLimits = tuple[float, float]
"""Lowest and highest rate in rad/s."""


PROFILE_VELOCITY_MODE = 3

_STOPPED_RATE_RAD_S = 1e-3
_MODE_REST = 0.01
"""Rate in rad/s above which the mode may not change; assumed."""
_HALT_CONTROL = 1 << 8
_VENDOR_ID = 0x6A


class EmulatedDrive(EmulatedNode):
    """One AKD with its motor.

    What can be done to it is an attribute or a method of its own.

    Args:
        node: CANopen node, 1 to 127.
        start_counts: Motor position at power-up; near 2^31 it soon wraps.
        parameter_count: One count of velocity limits and ramps, in rpm and rpm/s; no other units
            (365Fh, 3659h) are emulated.
    """

    store: ObjectStore

    def __init__(self, node: int, *, start_counts: int = 0, parameter_count: float = 0.001) -> None:
        self.parameter_count = parameter_count
        self._start_counts = start_counts
        super().__init__(node)

    def power_on(self) -> None:
        """Begin as after power-up: defaults, counters at their start, boot-up message next."""
        store = ObjectStore(self.node)
        self._boot(store, Pdos(store, self._written))
        self.motor = Motor(self._start_counts)
        self._target = 0.0
        store.turning = lambda: abs(self.motor.rate) >= _MODE_REST
        store.set(0x608F, 1, MOTOR_COUNTS)
        store.live(0x1001, 0, lambda: int(bool(self.power.faults)))
        for place in range(10):
            store.live(0x2001, place + 1, partial(self.power.fault, place))
        store.live(0x6041, 0, lambda: self.status)
        store.live(0x6061, 0, lambda: self.mode)
        store.live(0x6064, 0, lambda: self.motor.encoder.counts)
        store.live(0x606C, 0, lambda: round((self.motor.rate + self.motor.forced) / VELOCITY_UNIT))
        for index, sub in ((0x2050, 0), (0x60E4, 2)):
            store.live(index, sub, lambda: self.motor.plate.counts)
        store.live(0x60E4, 1, lambda: self.motor.encoder.counts)

    @property
    def rate(self) -> float:
        """Motor shaft rate in rad/s."""
        return self.motor.rate

    @property
    def mode(self) -> int:
        """Mode of operation it is in."""
        return self.store.get(0x6060) if self.mode_override is None else self.mode_override

    @property
    def status(self) -> int:
        """Status word."""
        limit = self.motor.limited if self.limit_active is None else self.limit_active
        bits = ((4, self.power.dc_link), (7, self.warning), (9, self.remote), (11, limit))
        return self.power.state | sum(on << bit for bit, on in bits)

    def reboot(self) -> None:
        """Lose the power of the electronics for a moment."""
        rate = self.motor.rate
        self.power_on()
        self.motor.rate = rate

    def restore(self) -> None:
        """Remove whatever has been done to it; faults that came of it stay until they are reset."""
        super().restore()
        self.motor.encoder.frozen = self.motor.plate.frozen = False
        self.store.set(0x1018, 1, _VENDOR_ID)

    def _let_alone(self) -> None:
        """Do nothing more to it, apart from what is in its power stage, motor and objects."""
        super()._let_alone()
        self.remote = True
        """False: a tool has taken the drive over; control words and new targets are ignored."""
        self.mode_override: int | None = None
        """Mode it shows and is in, whatever 6060h requests."""
        self.limit_active: bool | None = None
        """Internal limit bit, None for the result of the velocity limit."""
        self.warning = False

    def _sdo(self, request: bytes) -> bytes | None:
        return sdo_answer(self.store, request, self.sdo_aborts, self._written)

    def _coast(self, dt: float) -> None:
        self.motor.coast(dt)

    def _written(self, index: int, sub: int) -> None:
        if index == 0x1017:
            self.heartbeats.restart()
        if not self.remote:
            return
        if index == 0x60FF:
            self._target = self.store.get(0x60FF) * VELOCITY_UNIT
        elif index == 0x6040:
            self.power.option = self.store.get(0x605A)
            self._failed(self.power.control(self.store.get(0x6040)))

    def _failed(self, numbers: list[int]) -> None:
        for number in numbers:
            self.emergency(emergency_code(number), 0x01, f"F{number}".encode())

    def _move(self, dt: float) -> None:
        store, motor = self.store, self.motor
        unit = self.parameter_count * RPM
        if self.power.state is Power.OPERATION_ENABLED:
            moving = self.mode == PROFILE_VELOCITY_MODE and not store.get(0x6040) & _HALT_CONTROL
            target = self._target if moving else 0.0
            ramps = store.get(0x6083) * unit, store.get(0x6084) * unit
            most = store.get(0x207F) or (1 << 31)
            low = max(store.get(0x3623), -most) * unit
            motor.follow(target, ramps, (low, min(store.get(0x3622), most) * unit), dt)
        elif self.power.live:
            motor.follow(0.0, (STOP_RAMP, STOP_RAMP), (0.0, 0.0), dt)
        else:
            motor.coast(dt)
        if abs(motor.rate) < _STOPPED_RATE_RAD_S:
            self.power.still()
