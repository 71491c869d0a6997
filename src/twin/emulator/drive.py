"""An emulated AKD drive on CANopen: frames in, frames out, time in steps; no clock, no thread.

Defaults are the documented ones: no heartbeat, nobody watched, so that it keeps turning when the
master goes silent unless 1016h says otherwise; event-driven PDOs; nothing exchanged before NMT
start. Not emulated: storing parameters, node guarding, homing and every mode but profile velocity
(in which the drive turns), the PLL, and the bus's own timing.
"""

from __future__ import annotations

import math
import struct
from functools import partial

from twin.emulator.can_faults import Frame
from twin.emulator.drive_comm import Heartbeats, Pdos, sdo_answer
from twin.emulator.drive_motion import Motor
from twin.emulator.drive_objects import ObjectStore
from twin.emulator.drive_power import MASTER_SILENT, Power, PowerStage
from twin.emulator.drive_settings import RPM, DriveSettings

PRE_OPERATIONAL, OPERATIONAL, STOPPED = 127, 5, 4
PROFILE_VELOCITY = 3

_STILL = 1e-3
_MODE_REST = 0.01
"""Rate in rad/s above which the mode may not change; assumed."""
_HALT = 1 << 8
_VENDOR = 0x6A
_ROTARY = {0: RPM, 1: 2 * math.pi, 2: math.radians(1), 3: 2 * math.pi / 3600, 4: 1.0}
"""Sizes of the units of 365Fh in rad/s, of 3659h in rad/s^2; 3 is one's own, 3600 a revolution."""
_CODE = struct.Struct("<HB")


class EmulatedDrive:
    """One drive with its motor.

    What can be done to it is an attribute or a method of its own.

    Args:
        settings: What is special about it.
    """

    def __init__(self, settings: DriveSettings) -> None:
        self.settings = settings
        self.silent = False
        """Says nothing at all, but keeps running."""
        self.mute: set[int] = set()
        """COB-IDs it does not send."""
        self.remote = True
        """False: a tool has taken the drive over; control words and new targets are ignored."""
        self.mode_override: int | None = None
        """Mode it shows and is in, whatever 6060h says."""
        self.limit_active: bool | None = None
        """Internal limit bit, None for what the velocity limit says."""
        self.warning = False
        self.sdo_silent = False
        self.sdo_aborts: dict[tuple[int, int], int] = {}
        """Objects that are refused, with the abort code."""
        self.short_emergencies = False
        """Sends two bytes of every emergency instead of eight."""
        self.power_on()

    def power_on(self) -> None:
        """Begin as after power-up: defaults, counters at their start, boot-up message next."""
        settings = self.settings
        self.store = ObjectStore(
            settings.node, coarse=settings.coarse, shows_bit_30=settings.shows_bit_30
        )
        self.power = PowerStage()
        self.motor = Motor(settings)
        self.pdos = Pdos(self.store, self._written)
        self.heartbeats = Heartbeats(self.store)
        self.nmt = PRE_OPERATIONAL
        self._out: list[Frame] = [self._own(0x700, b"\0")]
        self._target = 0.0
        store = self.store
        store.set(0x1018, 4, settings.serial)
        store.set(0x608F, 1, settings.motor_counts)
        store.live(0x1001, 0, lambda: int(bool(self.power.faults)))
        for place in range(10):
            store.live(0x2001, place + 1, partial(self.power.fault, place))
        store.live(0x6041, 0, lambda: self.status)
        store.live(0x6061, 0, lambda: self.mode)
        store.live(0x6064, 0, lambda: self.motor.position)
        store.live(0x606C, 0, lambda: round(self.motor.rate / settings.velocity_unit))
        for index, sub in ((0x2050, 0), (0x60E4, 2)):
            store.live(index, sub, lambda: self.motor.plate)
        store.live(0x60E4, 1, lambda: self.motor.position)

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
    def fault_numbers(self) -> tuple[int, ...]:
        """Present faults, oldest first."""
        return tuple(self.power.faults)

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

    def sense(self, motor: float, plate: float) -> None:
        """Set where a plant has shaft and plate, rad."""
        self.motor.sense(motor, plate)

    def reboot(self) -> None:
        """Lose the power of the electronics for a moment."""
        rate = self.motor.rate
        self.power_on()
        self.motor.rate = rate

    def open_sto(self) -> None:
        """Open the safe torque off input, as an emergency stop button does."""
        self.power.sto_closed = False

    def close_sto(self) -> None:
        """Close it again; a fault that came of it stays until it is reset."""
        self.power.sto_closed = True

    def fail(self, number: int, *, lasting: bool = False) -> None:
        """Have a fault; lasting: its cause stays until ``clear_causes``."""
        if lasting:
            self.power.causes.add(number)
        self._failed(self.power.fail(number, braked=True))

    def restore(self) -> None:
        """Remove whatever has been done to it; faults that came of it stay until they are reset."""
        self.close_sto()
        self.clear_causes()
        self.power.dc_link = self.remote = True
        self.power.refuse_reset = self.silent = self.sdo_silent = self.short_emergencies = False
        self.motor.frozen = self.motor.frozen_plate = self.warning = False
        self.mode_override = self.limit_active = None
        self.store.set(0x1018, 1, _VENDOR)
        self.mute.clear()
        self.store.stuck.clear()
        self.sdo_aborts.clear()

    def clear_causes(self) -> None:
        """Remove the causes of faults, not the faults."""
        self.power.causes.clear()

    def emergency(self, code: int, register: int = 0, extra: bytes = b"") -> None:
        """Send an emergency message."""
        data = _CODE.pack(code, register) + extra.ljust(5, b"\0")
        self._out.append(self._own(0x080, data[:2] if self.short_emergencies else data))

    def receive(self, frame: Frame) -> list[Frame]:
        """Take in any frame on the bus; what it answers at once."""
        node = self.settings.node
        service, data = frame.cob_id, frame.data
        if frame.remote:
            return []
        if service == 0x000 and len(data) == 2 and data[1] in {0, node}:
            self._command(data[0])
        elif service == self.store.get(0x1005) & 0x7FF and self.nmt == OPERATIONAL:
            self._out += self.pdos.sync()
        elif service == 0x600 + node and self.nmt != STOPPED and not self.sdo_silent:
            reply = sdo_answer(
                self.store,
                data,
                at_rest=abs(self.motor.rate) < _MODE_REST,
                aborts=self.sdo_aborts,
                written=self._written,
            )
            self._out += [] if reply is None else [self._own(0x580, reply)]
        elif service & ~0x7F == 0x700:
            self.heartbeats.heard(service & 0x7F)
        elif self.nmt == OPERATIONAL:
            code = self.pdos.receive(frame)
            if code is not None:
                self.emergency(code, 0x10)
        return self._sent()

    def step(self, dt: float) -> list[Frame]:
        """Let dt seconds pass; what it sends meanwhile."""
        self._failed(self.power.inputs())
        if self.heartbeats.missed(dt):
            self._failed(self.power.fail(MASTER_SILENT, braked=True))
        self._move(dt)
        if abs(self.motor.rate) < _STILL:
            self.power.still()
        if self.nmt == OPERATIONAL:
            self._out += self.pdos.events(dt)
        if self.heartbeats.due(dt):
            self._out.append(self._own(0x700, bytes((self.nmt,))))
        return self._sent()

    def _own(self, service: int, data: bytes) -> Frame:
        return Frame(service + self.settings.node, data)

    def _sent(self) -> list[Frame]:
        out, self._out = self._out, []
        return [] if self.silent else [each for each in out if each.cob_id not in self.mute]

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
            self._target = self.store.get(0x60FF) * self.settings.velocity_unit
        elif index == 0x6040:
            self.power.option = self.store.get(0x605A)
            self._failed(self.power.control(self.store.get(0x6040)))

    def _failed(self, numbers: list[int]) -> None:
        for number in numbers:
            self.emergency(self.settings.emergency_code(number), 0x01, f"F{number}".encode())

    def _move(self, dt: float) -> None:
        settings, store, motor = self.settings, self.store, self.motor
        unit = settings.parameter_count * _ROTARY[store.get(0x365F)]
        ramp_unit = settings.parameter_count * _ROTARY[store.get(0x3659)]
        stop = settings.stop_ramp
        if self.power.state is Power.OPERATION_ENABLED:
            moving = self.mode == PROFILE_VELOCITY and not store.get(0x6040) & _HALT
            target = self._target if moving else 0.0
            ramps = (
                store.get(0x6083) * ramp_unit,
                store.get(0x6084) * ramp_unit,
            )
            most = store.get(0x207F) or (1 << 31)
            low = max(store.get(0x3623), -most) * unit
            motor.follow(target, ramps, (low, min(store.get(0x3622), most) * unit), dt)
        elif self.power.live:
            motor.follow(0.0, (stop, stop), (0.0, 0.0), dt)
        else:
            motor.coast(dt)
