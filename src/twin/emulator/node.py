"""A drive as a node of CANopen: network management, SDO, PDO, heartbeats, emergencies, faults.

Frames in, frames out, time in steps; no clock, no thread. What turns is the subclass's.
"""

from __future__ import annotations

import struct
from abc import ABC, abstractmethod

from twin.emulator.drive_objects import Frame, Heartbeats, Key, ObjectDictionary, Pdos
from twin.emulator.power_stage import MASTER_SILENT, Power, PowerStage

PRE_OPERATIONAL, OPERATIONAL, STOPPED = 127, 5, 4

_EMERGENCY_FRAME = struct.Struct("<HB")


class EmulatedNode(ABC):
    """One drive on the bus. What can be done to it is an attribute or a method of its own.

    Args:
        node: CANopen node, 1 to 127.
    """

    store: ObjectDictionary
    """Its objects."""
    power: PowerStage
    """Its power stage."""
    pdos: Pdos
    heartbeats: Heartbeats

    def __init__(self, node: int) -> None:
        self.node = node
        self._off = 0.0
        self.power_on()
        self._let_alone()

    @abstractmethod
    def power_on(self) -> None:
        """Begin as after power-up: defaults, counters at their start, boot-up message next."""

    def _boot(self, store: ObjectDictionary, pdos: Pdos) -> None:
        """Begin with objects as after power-up; pdos: those of the objects."""
        self.store, self.pdos = store, pdos
        self.power = PowerStage()
        self.heartbeats = Heartbeats(store)
        self.nmt = PRE_OPERATIONAL
        self._out = [self._own(0x700, b"\0")]

    @property
    @abstractmethod
    def rate(self) -> float:
        """Motor shaft rate in rad/s."""

    @property
    def enabled(self) -> bool:
        """Whether it follows its commands."""
        return self.power.state is Power.OPERATION_ENABLED

    @property
    def state(self) -> Power:
        """State of the power stage."""
        return self.power.state

    @abstractmethod
    def reboot(self) -> None:
        """Lose the power of the electronics for a moment; the motor keeps its rate."""

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
        self.store.stuck.clear()
        self._let_alone()

    def _let_alone(self) -> None:
        """Do nothing more to it, apart from what is in its power stage, motor and objects."""
        self.sdo_silent = False
        self.sdo_aborts: dict[Key, int] = {}
        """Objects that are refused, with the abort code."""
        self.short_emergencies = False
        """Sends two bytes of every emergency instead of eight."""

    def emergency(self, code: int, register: int = 0, extra: bytes = b"") -> None:
        """Send an emergency message."""
        data = _EMERGENCY_FRAME.pack(code, register) + extra.ljust(5, b"\0")
        self._out.append(Frame(self.emergency_id, data[:2] if self.short_emergencies else data))

    @property
    def emergency_id(self) -> int:
        """Identifier of its emergency messages."""
        return 0x080 + self.node

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
            reply = self._sdo(data)
            self._out += [] if reply is None else [self._own(0x580, reply)]
        elif service & ~0x7F == 0x700:
            self.heartbeats.heard(service & 0x7F)
        elif self.nmt == OPERATIONAL:
            code = self.pdos.receive(frame)
            if code is not None:
                self.emergency(code, 0x10)
        return self._sent()

    @abstractmethod
    def _sdo(self, request: bytes) -> bytes | None:
        """The answer to an SDO request; None for no answer."""

    def step(self, dt: float) -> list[Frame]:
        """Let dt seconds pass; return the frames sent meanwhile."""
        if self._off > 0:
            self._off -= dt
            self._coast(dt)
            if self._off <= 0:
                self.reboot()
            return []
        self._failed(self.power.inputs())
        if self.heartbeats.missed(dt):
            self._lose_master()
        self._move(dt)
        if self.heartbeats.due(dt):
            self._out.append(self._own(0x700, bytes((self.nmt,))))
        return self._sent()

    def _lose_master(self) -> None:
        """React to a master that has been silent for too long."""
        self._failed(self.power.fail(MASTER_SILENT, braked=True))

    @abstractmethod
    def _coast(self, dt: float) -> None:
        """Let the motor run out without torque."""

    @abstractmethod
    def _move(self, dt: float) -> None:
        """Let the motor do what state, mode and targets demand."""

    def _own(self, service: int, data: bytes) -> Frame:
        return Frame(service + self.node, data)

    def _sent(self) -> list[Frame]:
        out, self._out = self._out, []
        return out

    def _command(self, command: int) -> None:
        """Obey network management."""
        if command == 1:
            self.nmt = OPERATIONAL
            self.pdos.forget()
        elif command == 2:
            self.nmt = STOPPED
        elif command == 128:
            self.nmt = PRE_OPERATIONAL
        elif command in {129, 130}:
            self.reboot()

    @abstractmethod
    def _written(self, index: int, sub: int) -> None:
        """React to a write by SDO or PDO."""

    @abstractmethod
    def _failed(self, numbers: list[int]) -> None:
        """Report new faults by emergencies."""
