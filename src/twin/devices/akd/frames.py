"""CANopen frames as the host needs them: identifiers, PDOs, heartbeats, emergencies.

Decoders take any bytes and never raise: what they cannot read is None.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

NMT = 0x000
SYNC = 0x080
EMERGENCY = 0x080
TPDO1 = 0x180
TPDO2 = 0x280
RPDO1 = 0x200
ANSWER = 0x580
REQUEST = 0x600
HEARTBEAT = 0x700

NODE = 0x7F
"""Mask of the node in an identifier; the rest is the service."""

START, STOP, PRE_OPERATIONAL, RESET_NODE = 1, 2, 128, 129
"""NMT commands."""

OPERATIONAL = 5
"""NMT state in a heartbeat; 0 is a boot-up."""

RPDO1_MAP = ((0x6040, 0), (0x60FF, 0))
TPDO1_MAP = ((0x6041, 0), (0x6061, 0), (0x6064, 0))
VELOCITY = (0x606C, 0)
"""First entry of TPDO2; the plate encoder's object follows where it is read through the drive."""

_TARGET = struct.Struct("<Hi")
_MOTION = struct.Struct("<Hbi")
_SENSORS = struct.Struct("<ii")
_RATE = struct.Struct("<i")
_CODE = struct.Struct("<H")

NMT_STATES = {0: "booting", 4: "stopped", 5: "operational", 127: "pre-operational"}

CODES = {
    0x1080: "general warning",
    0x1081: "general error",
    0x3110: "bus overvoltage",
    0x3120: "bus voltage out of range",
    0x3130: "bus capacitor overload",
    0x3180: "bus capacitor overload",
    0x3210: "bus overvoltage",
    0x3220: "bus undervoltage",
    0x3280: "bus undervoltage",
    0x3281: "brake overload",
    0x3282: "regeneration short circuit",
    0x3283: "bus overvoltage",
    0x4210: "control board hot",
    0x4310: "heat sink hot",
    0x4380: "power stage hot",
    0x4381: "power stage hot",
    0x4382: "power stage hot",
    0x5530: "non-volatile memory",
    0x5580: "non-volatile memory",
    0x8110: "CAN overrun",
    0x8120: "CAN error passive",
    0x8130: "heartbeat or life guard",
    0x8140: "recovered from bus-off",
    0x8210: "PDO too short",
    0x8220: "PDO too long",
}
"""Emergency codes: hardware facts A9 and CiA 301."""

FAULTS = {
    129: "CAN monitoring: the master went silent",
    130: "secondary feedback supply",
    131: "secondary feedback A/B line break",
    132: "secondary feedback Z line break",
    134: "secondary feedback illegal state",
    247: "bus voltage out of range",
    501: "bus overvoltage",
    502: "bus undervoltage",
    503: "bus capacitor overload",
    602: "safe torque off",
    702: "fieldbus lost",
}
"""The drive's own fault numbers worth naming."""


class Motion(NamedTuple):
    """TPDO1: status word, mode display, motor position in counts."""

    status: int
    mode: int
    position: int


class Sensors(NamedTuple):
    """TPDO2: motor velocity and plate encoder in the drive's units; None where not mapped."""

    velocity: int
    plate: int | None


class Emergency(NamedTuple):
    """An emergency message; fewer than eight bytes are marked and read as far as they go."""

    code: int | None
    register: int | None
    extra: bytes
    short: bool

    @property
    def words(self) -> str:
        """What it says, for people."""
        if self.code is None:
            return "no code"
        name = CODES.get(self.code, "")
        ascii_part = self.extra.rstrip(b"\0")
        number = ascii_part.decode("ascii") if ascii_part.isascii() else ""
        parts = [f"{self.code:04X}h", name, number if number.isprintable() else ""]
        return " ".join(part for part in parts if part)


def target(control: int, velocity: int) -> bytes:
    """RPDO1: control word and target velocity in the drive's units."""
    return _TARGET.pack(control, velocity)


def motion(data: bytes) -> Motion | None:
    """TPDO1; None unless it is exactly as long as mapped."""
    return Motion(*_MOTION.unpack(data)) if len(data) == _MOTION.size else None


def sensors(data: bytes, with_plate: bool) -> Sensors | None:
    """TPDO2; None unless it is exactly as long as mapped."""
    if with_plate:
        return Sensors(*_SENSORS.unpack(data)) if len(data) == _SENSORS.size else None
    return Sensors(_RATE.unpack(data)[0], None) if len(data) == _RATE.size else None


def emergency(data: bytes) -> Emergency:
    """An emergency message of any length."""
    code = _CODE.unpack_from(data)[0] if len(data) >= 2 else None
    register = data[2] if len(data) >= 3 else None
    return Emergency(code, register, bytes(data[3:8]), len(data) < 8)


def nmt_state(data: bytes) -> int | None:
    """The NMT state in a heartbeat or boot-up."""
    return data[0] & 0x7F if len(data) == 1 else None
