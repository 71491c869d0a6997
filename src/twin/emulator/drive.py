"""An emulated AKD drive on CANopen: frames in, frames out, time in steps; no clock, no thread.

It has CiA 402's power stage, ramps, faults and STO. Defaults are the documented ones: no heartbeat,
nobody watched, so that it keeps turning when the master goes silent unless 1016h is set;
nothing exchanged before NMT start. Not emulated: event-driven transmit PDOs, which a host that
leaves the defaults does not hear here, storing parameters, node guarding, homing and every mode but
profile velocity (in which the drive turns), the PLL, and the bus's own timing.
"""

from __future__ import annotations

import math
import struct
from enum import IntEnum
from functools import partial

from twin.emulator.drive_objects import (
    Frame,
    Heartbeats,
    ObjectStore,
    Pdos,
    emergency_code,
    sdo_answer,
)
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


class Power(IntEnum):
    """States; the values are the status word's bits 0 to 3, 5 and 6."""

    NOT_READY = 0x00
    SWITCH_ON_DISABLED = 0x40
    READY = 0x21
    SWITCHED_ON = 0x23
    OPERATION_ENABLED = 0x27
    QUICK_STOP = 0x07
    FAULT_REACTION = 0x0F
    FAULT = 0x08


STO_FAULT = 602
UNDERVOLTAGE_FAULT = 502
NO_VOLTAGE = 247
MASTER_SILENT = 129

_TORQUE_STATES = {
    Power.SWITCHED_ON,
    Power.OPERATION_ENABLED,
    Power.QUICK_STOP,
    Power.FAULT_REACTION,
}
_RESET = 0x80


class PowerStage:
    """States of the power stage under control words, inputs and faults.

    A fault with a cause that is still present cannot be reset: open STO, missing DC link, and
    whatever is in ``causes``.
    """

    def __init__(self) -> None:
        self.state = Power.SWITCH_ON_DISABLED
        self.sto_closed = True
        self.dc_link = True
        self.faults: list[int] = []
        """Numbers of the present faults, oldest first."""
        self.causes: set[int] = set()
        """Faults with a cause that is still present, apart from STO and DC link."""
        self.refuse_reset = False
        self.option = 2
        """Quick stop option (605Ah): 2 ends in switch on disabled, 6 stays."""
        self._control = 0

    @property
    def live(self) -> bool:
        """Whether the motor has torque or would have it in a moment."""
        return self.state in _TORQUE_STATES

    def control(self, word: int) -> list[int]:
        """Obey a control word, one transition at most; numbers of faults that come of it."""
        rising = word & _RESET and not self._control & _RESET
        self._control = word
        if self.state is Power.FAULT:
            if rising and not self.refuse_reset and not self.standing:
                self.faults.clear()
                self.state = Power.SWITCH_ON_DISABLED
            return []
        if self.state is Power.FAULT_REACTION:
            return []
        voltage, running = word & 0x02, word & 0x04
        if not voltage:
            self.state = Power.SWITCH_ON_DISABLED
        elif not running:
            if self.state is Power.OPERATION_ENABLED:
                self.state = Power.QUICK_STOP
            elif self.state is not Power.QUICK_STOP:
                self.state = Power.SWITCH_ON_DISABLED
        elif self.state is Power.QUICK_STOP:
            if word & 0x0F == 0x0F and self.option >= 5:
                self.state = Power.OPERATION_ENABLED
        else:
            return self._step(word & 0x0F)
        return []

    def _step(self, word: int) -> list[int]:
        if word & 0x07 == 0x06:
            self.state = Power.READY
        elif self.state is Power.READY:
            return self._switch_on()
        elif self.state in {Power.SWITCHED_ON, Power.OPERATION_ENABLED}:
            self.state = Power.OPERATION_ENABLED if word == 0x0F else Power.SWITCHED_ON
        return []

    def _switch_on(self) -> list[int]:
        if not self.sto_closed:
            return self.fail(STO_FAULT)
        if not self.dc_link:
            return self.fail(NO_VOLTAGE)
        self.state = Power.SWITCHED_ON
        return []

    def fault(self, place: int) -> int:
        """Number of the present fault at a place, 0 being the oldest's; 0 if there is none."""
        return self.faults[place] if place < len(self.faults) else 0

    @property
    def standing(self) -> set[int]:
        """Present faults with a cause that persists."""
        persisting = set(self.causes)
        if not self.sto_closed:
            persisting.add(STO_FAULT)
        if not self.dc_link:
            persisting |= {UNDERVOLTAGE_FAULT, NO_VOLTAGE}
        return persisting & set(self.faults)

    def fail(self, number: int, *, braked: bool = False) -> list[int]:
        """Go into fault; braked: with torque until standstill. The number, if it is new."""
        if number in self.faults:
            return []
        self.faults.append(number)
        if self.state is not Power.FAULT:
            self.state = Power.FAULT_REACTION if braked and self.live else Power.FAULT
        return [number]

    def inputs(self) -> list[int]:
        """Look at STO and DC link; numbers of faults that come of it."""
        if self.live and not self.sto_closed:
            return self.fail(STO_FAULT)
        if self.live and not self.dc_link:
            return self.fail(UNDERVOLTAGE_FAULT)
        return []

    def still(self) -> None:
        """The motor stands: a stop that was under way is done."""
        if self.state is Power.FAULT_REACTION:
            self.state = Power.FAULT
        elif self.state is Power.QUICK_STOP and self.option == 2:
            self.state = Power.SWITCH_ON_DISABLED


PRE_OPERATIONAL, OPERATIONAL, STOPPED = 127, 5, 4
PROFILE_VELOCITY = 3

_STANDSTILL_RAD_S = 1e-3
_MODE_REST = 0.01
"""Rate in rad/s above which the mode may not change; assumed."""
_HALT = 1 << 8
_VENDOR_ID = 0x6A
_CODE = struct.Struct("<HB")


class EmulatedDrive:
    """One drive with its motor.

    What can be done to it is an attribute or a method of its own.

    Args:
        node: CANopen node, 1 to 127.
        start_counts: Motor position at power-up; near 2^31 it soon wraps.
        parameter_count: One count of velocity limits and ramps, in rpm and rpm/s; no other units
            (365Fh, 3659h) are emulated.
    """

    def __init__(self, node: int, *, start_counts: int = 0, parameter_count: float = 0.001) -> None:
        self.node = node
        self.parameter_count = parameter_count
        self._start_counts = start_counts
        self._off = 0.0
        self.power_on()
        self._let_alone()

    def power_on(self) -> None:
        """Begin as after power-up: defaults, counters at their start, boot-up message next."""
        self.store = ObjectStore(self.node)
        self.power = PowerStage()
        self.motor = Motor(self._start_counts)
        self.pdos = Pdos(self.store, self._written)
        self.heartbeats = Heartbeats(self.store)
        self.nmt = PRE_OPERATIONAL
        self._out: list[Frame] = [self._own(0x700, b"\0")]
        self._target = 0.0
        store = self.store
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
    def enabled(self) -> bool:
        """Whether it follows its commands."""
        return self.power.state is Power.OPERATION_ENABLED

    @property
    def state(self) -> Power:
        """State of the power stage."""
        return self.power.state

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

    def lose_power(self, seconds: float) -> None:
        """Lose the power of the electronics (24 V) for a time in s; then as after power-up."""
        self._off = seconds
        self.power.state = Power.SWITCH_ON_DISABLED

    def open_sto(self) -> None:
        """Open the safe torque off input, as an emergency stop button does."""
        self.power.sto_closed = False

    def fail(self, number: int, *, lasting: bool = False) -> None:
        """Have a fault; lasting: its cause stays until ``restore``."""
        if lasting:
            self.power.causes.add(number)
        self._failed(self.power.fail(number, braked=True))

    def restore(self) -> None:
        """Remove whatever has been done to it; faults that came of it stay until they are reset."""
        self.power.causes.clear()
        self.power.sto_closed = self.power.dc_link = True
        self.power.refuse_reset = False
        self.motor.encoder.frozen = self.motor.plate.frozen = False
        self.store.set(0x1018, 1, _VENDOR_ID)
        self.store.stuck.clear()
        self._let_alone()

    def _let_alone(self) -> None:
        """Do nothing more to it, apart from what is in its power stage, motor and objects."""
        self.remote = True
        """False: a tool has taken the drive over; control words and new targets are ignored."""
        self.mode_override: int | None = None
        """Mode it shows and is in, whatever 6060h requests."""
        self.limit_active: bool | None = None
        """Internal limit bit, None for the result of the velocity limit."""
        self.warning = self.sdo_silent = False
        self.sdo_aborts: dict[tuple[int, int], int] = {}
        """Objects that are refused, with the abort code."""
        self.short_emergencies = False
        """Sends two bytes of every emergency instead of eight."""

    def emergency(self, code: int, register: int = 0, extra: bytes = b"") -> None:
        """Send an emergency message."""
        data = _CODE.pack(code, register) + extra.ljust(5, b"\0")
        self._out.append(self._own(0x080, data[:2] if self.short_emergencies else data))

    def receive(self, frame: Frame) -> list[Frame]:
        """Take in any frame on the bus; return its immediate answers."""
        node, service, data = self.node, frame.cob_id, frame.data
        if frame.remote or frame.extended or self._off > 0:
            return []
        if service == 0x000 and len(data) == 2 and data[1] in {0, node}:
            self._command(data[0])
        elif service == self.store.get(0x1005) & 0x7FF and self.nmt == OPERATIONAL:
            self._out += self.pdos.sync()
        elif service == 0x600 + node and self.nmt != STOPPED and not self.sdo_silent:
            reply = sdo_answer(self.store, data, self.sdo_aborts, self._written)
            self._out += [] if reply is None else [self._own(0x580, reply)]
        elif service & ~0x7F == 0x700:
            self.heartbeats.heard(service & 0x7F)
        elif self.nmt == OPERATIONAL:
            code = self.pdos.receive(frame)
            if code is not None:
                self.emergency(code, 0x10)
        return self._sent()

    def step(self, dt: float) -> list[Frame]:
        """Let dt seconds pass; return the frames sent meanwhile."""
        if self._off > 0:
            self._off -= dt
            self.motor.coast(dt)
            if self._off <= 0:
                self.reboot()
            return []
        self._failed(self.power.inputs())
        if self.heartbeats.missed(dt):
            self._failed(self.power.fail(MASTER_SILENT, braked=True))
        self._move(dt)
        if abs(self.motor.rate) < _STANDSTILL_RAD_S:
            self.power.still()
        if self.heartbeats.due(dt):
            self._out.append(self._own(0x700, bytes((self.nmt,))))
        return self._sent()

    def _own(self, service: int, data: bytes) -> Frame:
        return Frame(service + self.node, data)

    def _sent(self) -> list[Frame]:
        out, self._out = self._out, []
        return out

    def _command(self, command: int) -> None:
        if command == 1:
            self.nmt = OPERATIONAL
            self.pdos.forget()
        elif command == 2:
            self.nmt = STOPPED
        elif command == 128:
            self.nmt = PRE_OPERATIONAL
        elif command in {129, 130}:
            self.reboot()

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
            moving = self.mode == PROFILE_VELOCITY and not store.get(0x6040) & _HALT
            target = self._target if moving else 0.0
            ramps = store.get(0x6083) * unit, store.get(0x6084) * unit
            most = store.get(0x207F) or (1 << 31)
            low = max(store.get(0x3623), -most) * unit
            motor.follow(target, ramps, (low, min(store.get(0x3622), most) * unit), dt)
        elif self.power.live:
            motor.follow(0.0, (STOP_RAMP, STOP_RAMP), (0.0, 0.0), dt)
        else:
            motor.coast(dt)
