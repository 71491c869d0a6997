"""CANopen and CiA 402 as the host reads them: objects, frames, states of the power stage.

The objects of a drive that the host knows, and all words, are in ``objects.toml``. Decoders take
any bytes and never raise: what they cannot read is None.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import date, datetime, time, timedelta
from enum import Enum, IntFlag
from functools import cache
from typing import Any, NamedTuple

from twin.base.data_file import read_packaged
from twin.base.errors import plural

PDO_INVALID = 1 << 31
"""Bit of a PDO's COB-ID that switches it off."""
PDO_ENTRIES = 8
PDO_PARAMETER_INDICES = range(0x1400, 0x1C00)
"""Their parameters, and 200h above these their mappings."""
Key = tuple[int, int]
"""Index and subindex."""
TURN_RAD = 2 * math.pi
AKD_VENDOR_ID = 0x6A
"""Vendor of the AKD (1018h:1); it counts velocities in 0.001 rpm."""
RPM_RAD_S = TURN_RAD / 60
"""One revolution per minute in rad/s."""


@dataclass(frozen=True)
class Object:
    """One object of a drive.

    Its type is a letter and the bits, 0 for any number of them: U and I for numbers without and
    with a sign, F for those of IEEE 754, S for text, B for bytes.
    """

    index: int
    sub: int
    name: str
    type: str

    @property
    def bits(self) -> int:
        """Its length."""
        return int(self.type[1:])

    def encode(self, value: int) -> bytes:
        """The bytes of a value.

        Raises:
            OverflowError: If it is out of range.
        """
        return value.to_bytes(self.bits // 8, "little", signed=self.type[0] == "I")

    def decode(self, data: bytes) -> int:
        """The value of its bytes."""
        return int.from_bytes(data, "little", signed=self.type[0] == "I")


@cache
def objects() -> dict[tuple[int, int], Object]:
    """The objects of a drive that the host knows, by index and subindex."""
    found = [Object(*each) for each in table()["objects"]]
    for kind, first in (("RPDO", 0x1400), ("TPDO", 0x1800)):
        for number in range(4):
            name, index = f"{kind}{number + 1}", first + number
            found += [Object(index, s, f"{name} {what}", t) for s, what, t in table()["parameters"]]
            found += [
                Object(index + 0x200, sub, f"{name} mapping {sub}", "U32" if sub else "U8")
                for sub in range(PDO_ENTRIES + 1)
            ]
    return {(each.index, each.sub): each for each in found}


@cache
def table() -> dict[str, Any]:
    """The tables of ``objects.toml`` by their names."""
    return read_packaged("twin.devices.akd", "objects.toml")


def is_kept(index: int, written: int, read: int) -> bool:
    """Whether what is read of an object is what was written, as far as the drive can keep it."""
    key = f"0x{index:04X}"
    share = table()["tolerances"].get(key, 0.0)
    ignored = table()["ignored_bits"].get(key, 0)
    same = (written ^ read) & ~ignored == 0
    return bool(same or abs(read - written) <= share * abs(written))


def abort_words(code: int) -> str:
    """Why a drive refuses, in words, with the abort code."""
    known = table()["aborts"].get(f"0x{code:08X}", "a reason of the vendor's own")
    return f"code {code:08X}h, {known}"


def mappings(maps: Mapping[int, Sequence[Key]]) -> dict[Key, int]:
    """What the objects of mappings hold, by the index of their PDO's parameters.

    Raises:
        KeyError: If the host does not know an object.
    """
    held = {}
    for parameters, keys in maps.items():
        held[parameters + 0x200, 0] = len(keys)
        for place, (index, sub) in enumerate(keys, 1):
            bits = objects()[index, sub].bits
            held[parameters + 0x200, place] = index << 16 | sub << 8 | bits
    return held


class DriveState(Enum):
    """States of a drive's power stage; the values are what CiA 402 calls them."""

    NOT_READY = "not ready to switch on"
    SWITCH_ON_DISABLED = "switch on disabled"
    READY = "ready to switch on"
    SWITCHED_ON = "switched on"
    OPERATION_ENABLED = "operation enabled"
    QUICK_STOP = "quick stop active"
    FAULT_REACTION = "fault reaction active"
    FAULT = "fault"
    UNKNOWN = "unknown"


class StatusBit(IntFlag):
    """Bits of the status word that are evaluated besides the state."""

    VOLTAGE = 1 << 4
    WARNING = 1 << 7
    REMOTE = 1 << 9
    INTERNAL_LIMIT = 1 << 11


class AxisRequest(Enum):
    """Requested state of an axis."""

    DISABLE = "disable"
    ENABLE = "enable"
    QUICK_STOP = "quick stop"


DISABLE_VOLTAGE = 0x00
QUICK_STOP = 0x02
SHUTDOWN = 0x06
SWITCH_ON = 0x07
ENABLE = 0x0F
RESET = 0x80

_STATES_BY_MASK_4F = {
    0x00: DriveState.NOT_READY,
    0x40: DriveState.SWITCH_ON_DISABLED,
    0x08: DriveState.FAULT,
    0x0F: DriveState.FAULT_REACTION,
}
_STATES_BY_MASK_6F = {
    0x21: DriveState.READY,
    0x23: DriveState.SWITCHED_ON,
    0x27: DriveState.OPERATION_ENABLED,
    0x07: DriveState.QUICK_STOP,
}

_ENABLING_WORDS = {
    DriveState.SWITCH_ON_DISABLED: SHUTDOWN,
    DriveState.READY: SWITCH_ON,
    DriveState.SWITCHED_ON: ENABLE,
    DriveState.OPERATION_ENABLED: ENABLE,
}
_DISABLING_WORDS = {DriveState.OPERATION_ENABLED: SWITCH_ON, DriveState.SWITCHED_ON: SHUTDOWN}
_QUICK_STOP_WORDS = {DriveState.OPERATION_ENABLED: QUICK_STOP, DriveState.QUICK_STOP: QUICK_STOP}
_CONTROL_WORDS = {
    AxisRequest.ENABLE: _ENABLING_WORDS,
    AxisRequest.DISABLE: _DISABLING_WORDS,
    AxisRequest.QUICK_STOP: _QUICK_STOP_WORDS,
}


def is_akd_product(code: int) -> bool:
    """Whether a product code (1018h:2) is an AKD's: letters and digits; 0 is no code.

    Other drives with the same vendor (S300, S700, AKD2G, AX2000) have numbers.
    """
    text = code.to_bytes(8, "little").rstrip(b"\0")
    return not code or (len(text) > 2 and text.isalnum())


def state(status: int) -> DriveState:
    """The state that a status word means, any integer; masks 4Fh and 6Fh of CiA 402."""
    return (
        _STATES_BY_MASK_4F.get(status & 0x4F)
        or _STATES_BY_MASK_6F.get(status & 0x6F)
        or DriveState.UNKNOWN
    )


_HALT_BIT = 1 << 8
PROFILE_VELOCITY = 3


TARGET_REACHED, MODE_BIT = 1 << 10, 1 << 12
"""Bits of the status word: the target is reached; a bit with a meaning of its own in each mode."""
_MOTION_BITS = {PROFILE_VELOCITY: TARGET_REACHED | MODE_BIT}
"""Bits of the status word that change with the motion, by mode; else `TARGET_REACHED`."""


def passing_bits(mode: int | None) -> int:
    """Bits of the status word that come and go with the motion, and are no other state.

    Args:
        mode: The mode of operation; None if it is not known.
    """
    return _MOTION_BITS.get(mode or 0, TARGET_REACHED)


def status_words(
    status: int, served: int = 0xFFFF, mode: int | None = None, seen: int = 0xFFFF
) -> str:
    """A status word in words: the state, and its warnings.

    Args:
        status: The word.
        served: Bits that the drive serves; a 0 in any other bit means nothing.
        mode: The mode of operation; None if it is not known.
        seen: Bits that the drive has been seen to serve, among those with a meaning that depends
            on the mode.
    """
    now = state(status)
    more = [
        words
        for bit, given, words in table()["status_word"]
        if bool(status & bit) is given and (given or served & bit)
    ]
    enabled = now is DriveState.OPERATION_ENABLED
    more += [
        words
        for bit, given, words in table()["status_bits"].get(f"{mode}", ())
        if bool(status & bit) is given and (given or (seen & bit and enabled))
    ]
    return ", ".join((now.value, *more))


def error_words(code: int, *, akd: bool = True) -> str:
    """Meaning of an error code (of an emergency, or in 603Fh); its class if no more is known.

    Args:
        code: The code.
        akd: Whether it is an AKD's, which gives some codes a meaning of its own.
    """
    known = table()["emergencies"] | (table()["akd_emergencies"] if akd else {})
    kinds = (f"0x{each:04X}" for each in (code, code & 0xFF00, code & 0xF000))
    return next((str(known[each]) for each in kinds if each in known), "")


def control_words(control: int, mode: int | None = None) -> str:
    """Request of a control word, in words.

    Args:
        control: The word.
        mode: The mode of operation; None if it is not known.
    """
    asked = next(words for mask, value, words in table()["asked"] if control & mask == value)
    if control & (RESET | ENABLE) != ENABLE:
        return str(asked)
    more = [words for bit, words in table()["control_bits"].get(f"{mode}", ()) if control & bit]
    more += ["halt"] if control & _HALT_BIT else []
    return ", ".join((asked, *more))


def control_word(current: DriveState, request: AxisRequest) -> int:
    """The control word that takes a drive one transition from a state towards a request.

    It never resets a fault: in both fault states, and wherever no transition leads on, it disables
    the voltage, which is also what comes before the rising edge of a reset.
    """
    return _CONTROL_WORDS[request].get(current, DISABLE_VOLTAGE)


NMT = 0x000
SYNC = 0x080
EMERGENCY = 0x080
TPDO1 = 0x180
TPDO2 = 0x280
RPDO1 = 0x200
SDO_RESPONSE = 0x580
SDO_REQUEST = 0x600
HEARTBEAT = 0x700

TIME, TIME_BYTES = 0x100, 6
"""Identifier and length of the time of day."""
LSS, LSS_BYTES = (0x7E5, 0x7E4), 8
"""Identifiers of the layer setting services, of the host and of devices, and their length."""
NODE_MASK = 0x7F
"""Mask of the node in an identifier; the rest is the service."""

START, PRE_OPERATIONAL = 1, 128
"""NMT commands."""

OPERATIONAL = 5
"""NMT state in a heartbeat; 0 is a boot-up."""

AT_EVERY_SYNC = 1
"""Transmission type of a PDO that is exchanged at every SYNC."""

CONSUMER_HEARTBEAT = 0x1016
"""Index of the node with the monitored heartbeat, as `split_watch` reads it."""


def split_watch(value: int) -> tuple[int, int]:
    """The monitored node, and the longest allowed time in ms between its heartbeats."""
    return value >> 16 & 0x7F, value & 0xFFFF


def pdo_maps(plate: tuple[int, int]) -> dict[int, tuple[tuple[int, int], ...]]:
    """Mapped objects of the PDOs of a drive, by the index of their parameters.

    Args:
        plate: The plate encoder's object.
    """
    return {
        0x1400: ((0x6040, 0), (0x60FF, 0)),
        0x1800: ((0x6041, 0), (0x6061, 0), (0x6064, 0)),
        0x1801: ((0x606C, 0), plate),
    }


_SDO_FRAME = struct.Struct("<BHB4s")
"""An expedited SDO: command specifier, index, subindex, value."""

_RPDO1 = struct.Struct("<Hi")
TPDOS = {TPDO1: struct.Struct("<Hbi"), TPDO2: struct.Struct("<ii")}
"""Status word, mode display and motor position; motor velocity and plate encoder."""
_ERROR_CODE = struct.Struct("<H")
_SDO_READ, _SDO_WRITE, _SDO_ANSWER, _SDO_WRITTEN, _SDO_ABORT = 0x40, 0x23, 0x43, 0x60, 0x80
_SDO_UNUSED_BYTES_MASK = 0x0C
"""Bits of the command specifier that count the bytes which are not part of the value."""


def nmt_words(state: int) -> str:
    """The NMT state in a heartbeat in words."""
    return str(table()["nmt_states"].get(f"{state}", f"in state {state}"))


_DAYS_SINCE = date(1984, 1, 1)
"""First day of the time of day of CiA 301."""


def time_words(data: bytes) -> str:
    """The time of day in a TIME message (CiA 301: ms after midnight, days since 1984) in words."""
    milliseconds = int.from_bytes(data[:4], "little") & 0xFFF_FFFF
    day = datetime.combine(_DAYS_SINCE, time()) + timedelta(
        days=int.from_bytes(data[4:6], "little"), milliseconds=milliseconds
    )
    return f"the time is {day:%Y-%m-%d %H:%M:%S}.{day.microsecond // 1000:03d}"


def lss_words(data: bytes) -> str:
    """A message of the layer setting services (CiA 305) in words."""
    words = table()["lss"].get(f"{data[0]}", f"command {data[0]:02X}h")
    return str(words).format(first=data[1], number=int.from_bytes(data[1:5], "little"))


def fault_words(numbers: Iterable[int]) -> str:
    """Fault numbers as the drive's display shows them, with their names."""
    names = table()["faults"]
    return ", ".join(f"F{number} {names.get(f'{number}', '')}".strip() for number in numbers)


class Emergency(NamedTuple):
    """An emergency message; fewer than eight bytes are marked and read as far as they go."""

    code: int | None
    extra: bytes
    short: bool

    @property
    def words(self) -> str:
        """Code, name and fault number of an AKD as text."""
        return self.in_words(akd=True)

    def in_words(self, *, akd: bool) -> str:
        """Code, name and what the device adds: of an AKD as text, else its bytes.

        Args:
            akd: Whether it is an AKD's.
        """
        if self.code is None:
            return "no code"
        name = error_words(self.code, akd=akd)
        rest = self.extra.rstrip(b"\0")
        text = rest.decode("ascii") if akd and rest.isascii() else "\n"
        parts = [f"{self.code:04X}h", name, text if text.isprintable() else rest.hex(" ")]
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
    return _SDO_FRAME.pack(_SDO_READ, index, sub, b"")


def encode_sdo_write(index: int, sub: int, data: bytes) -> bytes:
    """The request to write an object of one to four bytes."""
    return _SDO_FRAME.pack(_SDO_WRITE | (4 - len(data)) << 2, index, sub, data)


def decode_sdo(data: bytes) -> SdoAnswer | None:
    """The answer to a request; None if it is no abort, and nothing that fits into one frame."""
    if len(data) != _SDO_FRAME.size:
        return None
    command, index, sub, value = _SDO_FRAME.unpack(data)
    if command in {_SDO_WRITTEN, _SDO_ABORT}:
        value = b"" if command == _SDO_WRITTEN else value
        return SdoAnswer((index, sub), value, aborted=command == _SDO_ABORT)
    if command & ~_SDO_UNUSED_BYTES_MASK != _SDO_ANSWER:
        return None
    return SdoAnswer((index, sub), value[: 4 - (command >> 2 & 3)], aborted=False)


def answers_otherwise(asked: Key, answer: SdoAnswer | None) -> str:
    """Why an answer is not one to the request to read an object, in words; empty if it is one.

    Args:
        asked: Index and subindex of the object.
        answer: The answer; None for one that `decode_sdo` cannot read.
    """
    if answer is None:
        return "an answer that cannot be read"
    if answer.key != asked:
        index, sub = answer.key
        return f"answered for {index:04X}h:{sub} instead"
    needed = objects()[asked].bits // 8
    if not answer.aborted and len(answer.data) != needed:
        return f"{plural(len(answer.data), 'byte')}, an AKD has {needed}"
    return ""


def decode_tpdo(service: int, data: bytes) -> tuple[int, ...] | None:
    """The values of a PDO of `TPDOS`; None unless it is exactly as long as mapped."""
    layout = TPDOS[service]
    return layout.unpack(data) if len(data) == layout.size else None


def decode_emergency(data: bytes) -> Emergency:
    """An emergency message of any length."""
    code = _ERROR_CODE.unpack_from(data)[0] if len(data) >= 2 else None
    return Emergency(code, bytes(data[3:8]), len(data) < 8)


def decode_nmt_state(data: bytes) -> int | None:
    """The NMT state in a heartbeat or boot-up; None unless it is one byte."""
    return data[0] & 0x7F if len(data) == 1 else None
