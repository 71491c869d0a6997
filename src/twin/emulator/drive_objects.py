"""The objects of emulated drives, and their messages about them: SDO answers, PDOs, heartbeats.

An object dictionary is a table in TOML. The AKD's is ``drive_objects.toml``; the host has its own.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from typing import Any, NamedTuple

from twin.base.data_file import read_packaged

UNKNOWN_COMMAND = 0x05040001
NO_OBJECT = 0x06020000
NO_SUB = 0x06090011
READ_ONLY = 0x06010002
WRONG_LENGTH = 0x06070010
VALUE_OUT_OF_RANGE = 0x06090030
NOT_NOW = 0x08000022
NOT_MAPPABLE = 0x06040041
PDO_TOO_LONG = 0x06040042

AKD_MODES = {-3, -2, -1, 1, 3, 4, 6, 7, 8}
"""Modes an AKD has (6060h); 0 stays as it is at power-up."""

PDO_ENTRIES = 8
"""Most entries of a PDO."""

COB_ID_INVALID = 1 << 31
"""Bit of a COB-ID: what has it is off."""
PDO_PARAMETERS = {base + number for base in (0x1400, 0x1800) for number in range(4)}
"""Indices of the communication parameters of PDOs."""
_FIRST_TRANSMIT = 0x1800


class Frame(NamedTuple):
    """A classic CAN frame of up to eight bytes.

    Attributes:
        cob_id: Identifier.
        data: Its bytes.
        remote: Whether it is a remote request.
        extended: Whether the identifier has 29 bits; CANopen's have 11.
    """

    cob_id: int
    data: bytes = b""
    remote: bool = False
    extended: bool = False


class AbortError(Exception):
    """An SDO transfer is refused.

    Args:
        code: CiA 301 abort code.
    """

    def __init__(self, code: int) -> None:
        self.code = code
        super().__init__(f"{code:08X}h")


Key = tuple[int, int]
"""Index and subindex of an object."""


class DriveObject(NamedTuple):
    """One object of a drive.

    Attributes:
        type: U or I and the bits; S for a text.
        access: const, ro, rw or rww; see ``drive_objects.toml``.
        pdo: Whether a PDO may carry it.
        default: Value at power-up; of a text 0.
        text: Its name or the source of its default; of type S the text that it holds is in
            ``content``.
        low: Smallest value that may be written, None for the smallest of its type.
        high: Largest value that may be written, None for the largest of its type.
        content: The text of an object of type S.
    """

    type: str
    access: str
    pdo: bool
    default: int
    text: str = ""
    low: int | None = None
    high: int | None = None
    content: str = ""

    @property
    def size(self) -> int:
        """Bytes."""
        return len(self.content) if self.type == "S" else int(self.type[1:]) // 8

    @property
    def signed(self) -> bool:
        """Whether it has a sign."""
        return self.type[0] == "I"


def read_objects(table: Mapping[str, Mapping[str, Any]], node: int) -> dict[Key, DriveObject]:
    """The objects of a table, by index and subindex.

    Args:
        table: ``objects`` and ``mappings``; ``drive_objects.toml`` describes both.
        node: Node of the drive, for the defaults that depend on it.
    """
    found = {}
    for key, (kind, access, pdo, default, text, *limits) in table["objects"].items():
        index, _, sub = key.partition(":")
        content, value = "", default
        if kind == "S":
            content, value = default, 0
        elif isinstance(default, str):
            value = node + int(default[5:], 16)
        low, high = limits or (None, None)
        each = DriveObject(kind, access, pdo, value, text, low, high, content)
        found[int(index, 16), int(sub)] = each
    for key, entries in table["mappings"].items():
        record = int(key, 16)
        count = DriveObject("U8", "rw", False, len(entries), "Number of entries")
        found[record, 0] = count
        for at in range(PDO_ENTRIES):
            entry = entries[at] if at < len(entries) else 0
            found[record, at + 1] = DriveObject("U32", "rw", False, entry, f"Entry {at + 1}")
    return found


def drive_objects(node: int) -> dict[Key, DriveObject]:
    """All objects of an AKD with this node, by index and subindex."""
    return read_objects(_table(), node)


def emergency_code(fault: int) -> int:
    """The emergency code for a fault number."""
    return int(_table()["emergency_codes"].get(str(fault), 0x1081))


@cache
def _table() -> dict[str, dict[str, Any]]:
    return read_packaged("twin.emulator", "drive_objects.toml")


class ObjectDictionary:
    """All objects of a drive, as bytes on the wire and as integers inside.

    Args:
        objects: The objects.
    """

    def __init__(self, objects: dict[Key, DriveObject]) -> None:
        self._objects = objects
        self._indices = {index for index, _ in self._objects}
        self._values = {key: each.default for key, each in self._objects.items()}
        self._live: dict[Key, Callable[[], int]] = {}
        self.stuck: set[Key] = set()
        """Objects that acknowledge what is written and keep what they have."""

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

    def __contains__(self, key: Key) -> bool:
        return key in self._objects

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
        known = self.find(index, sub)
        if known.type == "S":
            return known.content.encode()
        size = known.size
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
        if known.low is not None and value < known.low:
            raise AbortError(VALUE_OUT_OF_RANGE)
        if known.high is not None and value > known.high:
            raise AbortError(VALUE_OUT_OF_RANGE)
        self.check(index, sub, value)
        self._check_pdo(index, sub, value)
        if (index, sub) not in self.stuck:
            self._values[index, sub] = value

    def check(self, index: int, sub: int, value: int) -> None:
        """Refuse a value that an object cannot have, or not now; any is accepted here.

        Raises:
            AbortError: The reason.
        """

    def _check_pdo(self, index: int, sub: int, value: int) -> None:
        """CiA 301's order: switch the PDO off, count to 0, entries, count, switch it on."""
        if index in PDO_PARAMETERS and sub == 1:
            off = self.get(index, 1) & COB_ID_INVALID or value & COB_ID_INVALID
            if not off and self.get(index, 1) != value:
                raise AbortError(NOT_NOW)
        if index - 0x200 not in PDO_PARAMETERS:
            return
        if not self.get(index - 0x200, 1) & COB_ID_INVALID:
            raise AbortError(NOT_NOW)
        if sub == 0:
            if value > PDO_ENTRIES:
                raise AbortError(VALUE_OUT_OF_RANGE)
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


class ObjectStore(ObjectDictionary):
    """All objects of an AKD.

    Args:
        node: The drive's node, for its default COB-IDs.
    """

    def __init__(self, node: int) -> None:
        super().__init__(drive_objects(node))
        self.turning: Callable[[], bool] = lambda: False
        """Whether the motor turns: its mode cannot be changed then."""

    def check(self, index: int, sub: int, value: int) -> None:
        """Refuse a mode (6060h) that the drive does not have, and a change of it in motion.

        Raises:
            AbortError: The reason.
        """
        if index == 0x6060:
            if value not in AKD_MODES:
                raise AbortError(VALUE_OUT_OF_RANGE)
            if value != self.get(0x6060) and self.turning():
                raise AbortError(NOT_NOW)


_SDO_HEAD = struct.Struct("<BHB")

_TOO_SHORT, _TOO_LONG = 0x8210, 0x8220
_MAX_SYNCHRONOUS_TYPE = 240


def sdo_answer(
    store: ObjectDictionary,
    request: bytes,
    aborts: dict[tuple[int, int], int],
    written: Callable[[int, int], None],
) -> bytes | None:
    """The SDO answer to a request of eight bytes; None to anything else, and to an abort.

    Transfers are expedited: the objects need no others.

    Args:
        store: The objects.
        request: What the host sent.
        aborts: Objects that are refused, with the abort code.
        written: Called with index and subindex of what was written.
    """
    if len(request) != 8:
        return None
    command, index, sub = _SDO_HEAD.unpack_from(request)
    if command == 0x80:
        return None
    try:
        if (index, sub) in aborts:
            raise AbortError(aborts[index, sub])
        if command & 0xE0 == 0x40:
            data = store.read(index, sub)
            head = _SDO_HEAD.pack(0x43 | (4 - len(data)) << 2, index, sub)
            return head + data.ljust(4, b"\0")
        if command & 0xE3 == 0x23 or command == 0x22:
            size = 4 - (command >> 2 & 3) if command != 0x22 else store.find(index, sub).size
            store.write(index, sub, request[4 : 4 + size])
            written(index, sub)
            return _SDO_HEAD.pack(0x60, index, sub) + bytes(4)
        raise AbortError(UNKNOWN_COMMAND)
    except AbortError as refusal:
        return _SDO_HEAD.pack(0x80, index, sub) + struct.pack("<I", refusal.code)


class Pdos:
    """The four receive and four transmit PDOs of a drive.

    Not emulated: event-driven transmit PDOs, which are never sent.

    Args:
        store: The objects.
        written: Called with index and subindex of what a PDO wrote.
    """

    def __init__(self, store: ObjectDictionary, written: Callable[[int, int], None]) -> None:
        self._store = store
        self._written = written
        self.forget()

    def forget(self) -> None:
        """Start from nothing, as on entering the operational state."""
        self._pending: dict[int, bytes] = {}
        self._counts = [0] * 4

    def receive(self, frame: Frame) -> int | None:
        """Take in a receive PDO; an emergency code if its length is wrong."""
        for number in range(4):
            cob_id, kind = self._parameters(0x1400 + number)
            if cob_id != frame.cob_id:
                continue
            needed = sum(size for _, _, size in self._entries(0x1600 + number))
            if len(frame.data) < needed:
                return _TOO_SHORT
            if kind <= _MAX_SYNCHRONOUS_TYPE:
                self._pending[number] = frame.data
            else:
                self._apply(number, frame.data)
            return _TOO_LONG if len(frame.data) > needed else None
        return None

    def sync(self) -> list[Frame]:
        """Sample the synchronous transmit PDOs, then apply what was received for this SYNC."""
        sent = []
        for number in range(4):
            cob_id, kind = self._parameters(0x1800 + number)
            if cob_id is None or not 1 <= kind <= _MAX_SYNCHRONOUS_TYPE:
                continue
            self._counts[number] += 1
            if self._counts[number] >= kind:
                self._counts[number] = 0
                sent.append(Frame(cob_id, self._sample(number)))
        for number, data in self._pending.items():
            self._apply(number, data)
        self._pending.clear()
        return sent

    def _sample(self, number: int) -> bytes:
        """The present data of a transmit PDO, with zeros for an entry without an object."""
        store = self._store
        return b"".join(
            store.read(index, sub) if (index, sub) in store else bytes(size)
            for index, sub, size in self._entries(0x1A00 + number)
        )

    def _parameters(self, index: int) -> tuple[int | None, int]:
        """Identifier of a PDO, None if it is off, and its transmission type."""
        cob_id = self._store.get(index, 1)
        return None if cob_id & COB_ID_INVALID else cob_id & 0x7FF, self._store.get(index, 2)

    def _entries(self, index: int) -> Iterator[tuple[int, int, int]]:
        """Index, subindex and bytes of each entry of a mapping; an empty one has no bytes."""
        for sub in range(1, self._store.get(index, 0) + 1):
            entry = self._store.get(index, sub)
            yield entry >> 16, entry >> 8 & 0xFF, (entry & 0xFF) // 8

    def _apply(self, number: int, data: bytes) -> None:
        at, store, changed = 0, self._store, list[Key]()
        # Values first: a control word must not enable with the target of an earlier cycle.
        for index, sub, size in self._entries(0x1600 + number):
            if (index, sub) in store:
                signed = store.find(index, sub).signed
                store.set(index, sub, int.from_bytes(data[at : at + size], "little", signed=signed))
                changed.append((index, sub))
            at += size
        for index, sub in changed:
            self._written(index, sub)


class Heartbeats:
    """Sends one at the period of 1017h, and reports a missing one of the node that 1016h names.

    Args:
        store: The drive's objects.
    """

    def __init__(self, store: ObjectDictionary) -> None:
        self._store = store
        self._beat = 0.0
        self._silence: float | None = None

    def restart(self) -> None:
        """Restart the time to the next one, as after a write to 1017h."""
        self._beat = 0.0

    def due(self, dt: float) -> bool:
        """Whether one is to be sent after a further time in s."""
        period = self._store.get(0x1017) / 1e3
        self._beat += dt
        if not period or self._beat < period:
            return False
        self._beat %= period
        return True

    def heard(self, node: int) -> None:
        """Take in a node's heartbeat; monitoring begins with the first of the watched node."""
        watched = self._store.get(0x1016, 1)
        if watched & 0xFFFF and watched >> 16 & 0x7F == node:
            self._silence = 0.0

    def missed(self, dt: float) -> bool:
        """Whether the watched node has been silent for too long after a further time in s."""
        patience = (self._store.get(0x1016, 1) & 0xFFFF) / 1e3
        if self._silence is None or not patience:
            self._silence = None
            return False
        self._silence += dt
        if self._silence <= patience:
            return False
        self._silence = None
        return True
