"""What an emulated drive says on the bus: SDO answers, PDOs at SYNC or by event, heartbeats."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator

from twin.emulator.can_faults import Frame
from twin.emulator.drive_objects import AbortError, ObjectStore

_HEAD = struct.Struct("<BHB")
_UNKNOWN_COMMAND = 0x05040001

_INVALID = 1 << 31
_TOO_SHORT, _TOO_LONG = 0x8210, 0x8220
_SYNCHRONOUS = 240
_HUNDRED_US = 1e-4


def sdo_answer(
    store: ObjectStore,
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
    command, index, sub = _HEAD.unpack_from(request)
    if command == 0x80:
        return None
    try:
        if (index, sub) in aborts:
            raise AbortError(aborts[index, sub])
        if command & 0xE0 == 0x40:
            data = store.read(index, sub)
            head = _HEAD.pack(0x43 | (4 - len(data)) << 2, index, sub)
            return head + data.ljust(4, b"\0")
        if command & 0xE3 == 0x23 or command == 0x22:
            size = 4 - (command >> 2 & 3) if command != 0x22 else store.find(index, sub).size
            store.write(index, sub, request[4 : 4 + size])
            written(index, sub)
            return _HEAD.pack(0x60, index, sub) + bytes(4)
        raise AbortError(_UNKNOWN_COMMAND)
    except AbortError as refusal:
        return _HEAD.pack(0x80, index, sub) + struct.pack("<I", refusal.code)


class Pdos:
    """The four receive and four transmit PDOs of a drive.

    Event-driven ones are sent when a mapped value changes, no faster than their inhibit time; the
    masks 2014h to 2017h and event timers are not emulated.

    Args:
        store: The objects.
        written: Called with index and subindex of what a PDO wrote.
    """

    def __init__(self, store: ObjectStore, written: Callable[[int, int], None]) -> None:
        self._store = store
        self._written = written
        self._since = [0.0] * 4
        self.forget()

    def forget(self) -> None:
        """Start from nothing, as on entering the operational state."""
        self._pending: dict[int, bytes] = {}
        self._counts = [0] * 4
        self._last: list[bytes | None] = [None] * 4

    def receive(self, frame: Frame) -> int | None:
        """Take in a receive PDO; an emergency code if its length is wrong."""
        for number in range(4):
            cob_id, kind = self._parameters(0x1400 + number)
            if cob_id != frame.cob_id:
                continue
            needed = sum(size for _, _, size in self._entries(0x1600 + number))
            if len(frame.data) < needed:
                return _TOO_SHORT
            if kind <= _SYNCHRONOUS:
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
            if cob_id is None or not 1 <= kind <= _SYNCHRONOUS:
                continue
            self._counts[number] += 1
            if self._counts[number] >= kind:
                self._counts[number] = 0
                sent.append(Frame(cob_id, self._pack(number)))
        for number, data in self._pending.items():
            self._apply(number, data)
        self._pending.clear()
        return sent

    def events(self, dt: float) -> list[Frame]:
        """Event-driven transmit PDOs that are due after dt seconds more."""
        sent = []
        for number in range(4):
            cob_id, kind = self._parameters(0x1800 + number)
            self._since[number] += dt
            if cob_id is None or kind < 254:
                continue
            inhibit = self._store.get(0x1800 + number, 3) * _HUNDRED_US
            data = self._pack(number)
            if data != self._last[number] and self._since[number] >= inhibit:
                self._last[number], self._since[number] = data, 0.0
                sent.append(Frame(cob_id, data))
        return sent

    def _parameters(self, index: int) -> tuple[int | None, int]:
        """Identifier of a PDO, None if it is off, and its transmission type."""
        cob_id = self._store.get(index, 1)
        return None if cob_id & _INVALID else cob_id & 0x7FF, self._store.get(index, 2)

    def _entries(self, index: int) -> Iterator[tuple[int, int, int]]:
        for sub in range(1, self._store.get(index, 0) + 1):
            entry = self._store.get(index, sub)
            yield entry >> 16, entry >> 8 & 0xFF, (entry & 0xFF) // 8

    def _pack(self, number: int) -> bytes:
        entries = self._entries(0x1A00 + number)
        return b"".join(self._store.read(index, sub) for index, sub, _ in entries)

    def _apply(self, number: int, data: bytes) -> None:
        at = 0
        # Values first: a control word must not enable with the target of an earlier cycle.
        entries = list(self._entries(0x1600 + number))
        for index, sub, size in entries:
            value = int.from_bytes(
                data[at : at + size], "little", signed=self._store.find(index, sub).signed
            )
            self._store.set(index, sub, value)
            at += size
        for index, sub, _ in entries:
            self._written(index, sub)


class Heartbeats:
    """Sends one as often as 1017h says, and misses those of another node as 1016h says.

    Args:
        store: The drive's objects.
    """

    def __init__(self, store: ObjectStore) -> None:
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
        """Take in that of a node; monitoring begins with the first of the one to be watched."""
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
