"""The object dictionary of an emulated drive: typed values, access rights, abort codes.

It is the drive's own, read from ``drive_objects.toml``; the host's list is another.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

from twin.data_file import packaged

NO_OBJECT = 0x06020000
NO_SUB = 0x06090011
READ_ONLY = 0x06010002
WRONG_LENGTH = 0x06070010
OUT_OF_RANGE = 0x06090030
NOT_NOW = 0x08000022
NOT_MAPPABLE = 0x06040041
PDO_TOO_LONG = 0x06040042

MODES = {-3, -2, -1, 1, 3, 4, 6, 7, 8}
"""Modes an AKD has (6060h); 0 stays as it is at power-up."""

PDO_ENTRIES = 8
"""Most entries of a PDO."""

_INVALID = 1 << 31
_PARAMETERS = {base + number for base in (0x1400, 0x1800) for number in range(4)}
_FIRST_TRANSMIT = 0x1800


class AbortError(Exception):
    """An SDO transfer is refused.

    Args:
        code: CiA 301 abort code.
    """

    def __init__(self, code: int) -> None:
        self.code = code
        super().__init__(f"{code:08X}h")


class DriveObject(NamedTuple):
    """One object of the drive.

    Attributes:
        type: U or I and the bits.
        access: const, ro, rw or rww; see ``drive_objects.toml``.
        pdo: Whether a PDO may carry it.
        default: Value at power-up.
    """

    type: str
    access: str
    pdo: bool
    default: int

    @property
    def size(self) -> int:
        """Bytes."""
        return int(self.type[1:]) // 8

    @property
    def signed(self) -> bool:
        """Whether it has a sign."""
        return self.type[0] == "I"


def drive_objects(node: int) -> dict[tuple[int, int], DriveObject]:
    """All objects of a drive with this node, by index and subindex."""
    found = {}
    for key, (kind, access, pdo, default, _) in _table()["objects"].items():
        index, _, sub = key.partition(":")
        value = node + int(default[5:], 16) if isinstance(default, str) else default
        found[int(index, 16), int(sub)] = DriveObject(kind, access, pdo, value)
    for key, entries in _table()["mappings"].items():
        record = int(key, 16)
        found[record, 0] = DriveObject("U8", "rw", False, len(entries))
        for at in range(PDO_ENTRIES):
            entry = entries[at] if at < len(entries) else 0
            found[record, at + 1] = DriveObject("U32", "rw", False, entry)
    return found


def emergency_code(fault: int) -> int:
    """The emergency code for a fault number."""
    return int(_table()["emergency_codes"].get(str(fault), 0x1081))


@cache
def _table() -> dict[str, dict[str, Any]]:
    return packaged("twin.emulator", "drive_objects.toml")


class ObjectStore:
    """All objects of a drive, as bytes on the wire and as integers inside.

    Args:
        node: The drive's node, for its default COB-IDs.
    """

    def __init__(self, node: int) -> None:
        self._objects = drive_objects(node)
        self._indices = {index for index, _ in self._objects}
        self._values = {key: each.default for key, each in self._objects.items()}
        self._live: dict[tuple[int, int], Callable[[], int]] = {}
        self.stuck: set[tuple[int, int]] = set()
        """Objects that acknowledge what is written and keep what they have."""
        self.turning: Callable[[], bool] = lambda: False
        """Whether the motor turns: its mode cannot be changed then."""

    def live(self, index: int, sub: int, value: Callable[[], int]) -> None:
        """Let an object always be what a function gives."""
        self._live[index, sub] = value

    def get(self, index: int, sub: int = 0) -> int:
        """The value of an object that exists."""
        live = self._live.get((index, sub))
        return self._values[index, sub] if live is None else live()

    def set(self, index: int, sub: int, value: int) -> None:
        """Set an object from inside, whatever its access."""
        self._values[index, sub] = value

    def find(self, index: int, sub: int) -> DriveObject:
        """The object of an index and subindex.

        Raises:
            AbortError: There is none.
        """
        known = self._objects.get((index, sub))
        if known is None:
            raise AbortError(NO_SUB if index in self._indices else NO_OBJECT)
        return known

    def read(self, index: int, sub: int) -> bytes:
        """The bytes of an object.

        Raises:
            AbortError: If it does not exist.
        """
        size = self.find(index, sub).size
        return (self.get(index, sub) & ((1 << 8 * size) - 1)).to_bytes(size, "little")

    def write(self, index: int, sub: int, data: bytes) -> None:
        """Write an object from outside.

        Args:
            index: Index.
            sub: Subindex.
            data: Bytes, as many as the object has.

        Raises:
            AbortError: If the object, its access, the length or the value forbids it.
        """
        known = self.find(index, sub)
        if known.access in {"const", "ro"}:
            raise AbortError(READ_ONLY)
        if len(data) != known.size:
            raise AbortError(WRONG_LENGTH)
        value = int.from_bytes(data, "little", signed=known.signed)
        if index == 0x6060:
            if value not in MODES:
                raise AbortError(OUT_OF_RANGE)
            if value != self.get(0x6060) and self.turning():
                raise AbortError(NOT_NOW)
        self._check_pdo(index, sub, value)
        if (index, sub) not in self.stuck:
            self._values[index, sub] = value

    def _check_pdo(self, index: int, sub: int, value: int) -> None:
        """CiA 301's order: switch the PDO off, count to 0, entries, count, switch it on."""
        if index in _PARAMETERS and sub == 1:
            off = self.get(index, 1) & _INVALID or value & _INVALID
            if not off and self.get(index, 1) != value:
                raise AbortError(NOT_NOW)
        if index - 0x200 not in _PARAMETERS:
            return
        if not self.get(index - 0x200, 1) & _INVALID:
            raise AbortError(NOT_NOW)
        if sub == 0:
            if value > PDO_ENTRIES:
                raise AbortError(OUT_OF_RANGE)
            if sum(self.get(index, each) & 0xFF for each in range(1, value + 1)) > 64:
                raise AbortError(PDO_TOO_LONG)
        elif self.get(index, 0):
            raise AbortError(NOT_NOW)
        elif value:
            self._check_mappable(value, receive=index < _FIRST_TRANSMIT)

    def _check_mappable(self, entry: int, *, receive: bool) -> None:
        known = self._objects.get((entry >> 16, entry >> 8 & 0xFF))
        if known is None or not known.pdo or 8 * known.size != entry & 0xFF:
            raise AbortError(NOT_MAPPABLE)
        if receive and known.access != "rww":
            raise AbortError(NOT_MAPPABLE)
