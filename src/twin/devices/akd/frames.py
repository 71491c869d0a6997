"""CANopen frames as the host needs them: identifiers, PDOs, heartbeats, emergencies.

Decoders take any bytes and never raise: what they cannot read is None.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import NamedTuple

from twin.devices.akd.dictionary import table

NMT = 0x000
SYNC = 0x080
EMERGENCY = 0x080
TPDO1 = 0x180
TPDO2 = 0x280
RPDO1 = 0x200
SDO_RESPONSE = 0x580
SDO_REQUEST = 0x600
HEARTBEAT = 0x700

NODE_MASK = 0x7F
"""Mask of the node in an identifier; the rest is the service."""

START, PRE_OPERATIONAL = 1, 128
"""NMT commands."""

OPERATIONAL = 5
"""NMT state in a heartbeat; 0 is a boot-up."""


def pdo_maps(plate: tuple[int, int]) -> dict[int, tuple[tuple[int, int], ...]]:
    """What the PDOs of a drive carry, by the index of their parameters.

    Args:
        plate: The plate encoder's object.
    """
    return {
        0x1400: ((0x6040, 0), (0x60FF, 0)),
        0x1800: ((0x6041, 0), (0x6061, 0), (0x6064, 0)),
        0x1801: ((0x606C, 0), plate),
    }


_SDO = struct.Struct("<BHB4s")
"""An expedited SDO: command specifier, index, subindex, value."""

_RPDO1 = struct.Struct("<Hi")
_TPDO1 = struct.Struct("<Hbi")
_TPDO2 = struct.Struct("<ii")
_CODE = struct.Struct("<H")
_SDO_READ, _SDO_WRITE, _SDO_ANSWER, _SDO_WRITTEN, _SDO_ABORT = 0x40, 0x23, 0x43, 0x60, 0x80
_UNUSED = 0x0C
"""Bits of the command specifier that count the bytes which are not part of the value."""


def nmt_words(state: int) -> str:
    """The NMT state in a heartbeat in words."""
    return str(table()["nmt_states"].get(f"{state}", f"in state {state}"))


def fault_words(numbers: Iterable[int]) -> str:
    """Fault numbers as the drive's display shows them, with their names."""
    names = table()["faults"]
    return ", ".join(f"F{number} {names.get(f'{number}', '')}".strip() for number in numbers)


class MotionPdo(NamedTuple):
    """TPDO1: status word, mode display, motor position in counts."""

    status: int
    mode: int
    position: int


class FeedbackPdo(NamedTuple):
    """TPDO2: motor velocity and plate encoder in the drive's units."""

    velocity: int
    plate: int


class Emergency(NamedTuple):
    """An emergency message; fewer than eight bytes are marked and read as far as they go."""

    code: int | None
    extra: bytes
    short: bool

    @property
    def words(self) -> str:
        """Code, name and fault number as text."""
        if self.code is None:
            return "no code"
        known = table()["emergencies"]
        kinds = (self.code, self.code & 0xFF00, self.code & 0xF000)
        name = next((known[f"0x{each:04X}"] for each in kinds if f"0x{each:04X}" in known), "")
        rest = self.extra.rstrip(b"\0")
        number = rest.decode("ascii") if rest.isascii() else ""
        parts = [f"{self.code:04X}h", name, number if number.isprintable() else rest.hex(" ")]
        return " ".join(part for part in parts if part)


class SdoAnswer(NamedTuple):
    """The answer to an SDO request.

    Attributes:
        key: Index and subindex of the object.
        data: What was read, least byte first; of a write nothing, of an abort its code.
        aborted: Whether the request was refused.
    """

    key: tuple[int, int]
    data: bytes
    aborted: bool

    @property
    def value(self) -> int:
        """The data as a number without sign."""
        return int.from_bytes(self.data, "little")


def encode_rpdo1(control: int, velocity: int) -> bytes:
    """RPDO1: control word and target velocity in the drive's units."""
    return _RPDO1.pack(control, velocity)


def encode_sdo_read(index: int, sub: int) -> bytes:
    """The request to read an object."""
    return _SDO.pack(_SDO_READ, index, sub, b"")


def encode_sdo_write(index: int, sub: int, data: bytes) -> bytes:
    """The request to write an object of one to four bytes."""
    return _SDO.pack(_SDO_WRITE | (4 - len(data)) << 2, index, sub, data)


def decode_sdo(data: bytes) -> SdoAnswer | None:
    """The answer to a request; None if it is no abort, and nothing that fits into one frame."""
    if len(data) != _SDO.size:
        return None
    command, index, sub, value = _SDO.unpack(data)
    if command in {_SDO_WRITTEN, _SDO_ABORT}:
        value = b"" if command == _SDO_WRITTEN else value
        return SdoAnswer((index, sub), value, aborted=command == _SDO_ABORT)
    if command & ~_UNUSED != _SDO_ANSWER:
        return None
    return SdoAnswer((index, sub), value[: 4 - (command >> 2 & 3)], aborted=False)


def decode_tpdo1(data: bytes) -> MotionPdo | None:
    """TPDO1; None unless it is exactly as long as mapped."""
    return MotionPdo(*_TPDO1.unpack(data)) if len(data) == _TPDO1.size else None


def decode_tpdo2(data: bytes) -> FeedbackPdo | None:
    """TPDO2; None unless it is exactly as long as mapped."""
    return FeedbackPdo(*_TPDO2.unpack(data)) if len(data) == _TPDO2.size else None


def decode_emergency(data: bytes) -> Emergency:
    """An emergency message of any length."""
    code = _CODE.unpack_from(data)[0] if len(data) >= 2 else None
    return Emergency(code, bytes(data[3:8]), len(data) < 8)


def decode_nmt_state(data: bytes) -> int | None:
    """The NMT state in a heartbeat or boot-up; None unless it is one byte."""
    return data[0] & 0x7F if len(data) == 1 else None
