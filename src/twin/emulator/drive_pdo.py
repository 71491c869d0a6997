"""PDOs of an emulated drive: mapped from and to its objects, at SYNC or by event."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from twin.emulator.can_frame import Frame
from twin.emulator.drive_objects import Store

_INVALID = 1 << 31
_TOO_SHORT, _TOO_LONG = 0x8210, 0x8220
_SYNCHRONOUS = 240
_HUNDRED_US = 1e-4


class Pdos:
    """The four receive and four transmit PDOs of a drive.

    Event-driven ones are sent when a mapped value changes, no faster than their inhibit time; the
    masks 2014h to 2017h and event timers are not emulated.

    Args:
        store: The objects.
        written: Told the index and subindex of what a PDO wrote.
    """

    def __init__(self, store: Store, written: Callable[[int, int], None]) -> None:
        self._store = store
        self._written = written
        self._pending: dict[int, bytes] = {}
        self._counts = [0] * 4
        self._last: list[bytes | None] = [None] * 4
        self._since = [0.0] * 4

    def forget(self) -> None:
        """Begin anew, as on entering the operational state."""
        self._pending.clear()
        self._counts = [0] * 4
        self._last = [None] * 4

    def receive(self, frame: Frame) -> int | None:
        """Take in a receive PDO; an emergency code if its length is wrong."""
        for number in range(4):
            cob_id = self._store.get(0x1400 + number, 1)
            if cob_id & _INVALID or cob_id & 0x7FF != frame.cob_id:
                continue
            needed = sum(size for _, _, size in self._entries(0x1600 + number))
            if len(frame.data) < needed:
                return _TOO_SHORT
            if self._store.get(0x1400 + number, 2) <= _SYNCHRONOUS:
                self._pending[number] = frame.data
            else:
                self._apply(number, frame.data)
            return _TOO_LONG if len(frame.data) > needed else None
        return None

    def sync(self) -> list[Frame]:
        """Sample the synchronous transmit PDOs, then apply what was received for this SYNC."""
        sent = []
        for number in range(4):
            cob_id, kind = self._transmit(number)
            if cob_id & _INVALID or not 1 <= kind <= _SYNCHRONOUS:
                continue
            self._counts[number] += 1
            if self._counts[number] >= kind:
                self._counts[number] = 0
                sent.append(Frame(cob_id & 0x7FF, self._pack(number)))
        for number, data in self._pending.items():
            self._apply(number, data)
        self._pending.clear()
        return sent

    def events(self, dt: float) -> list[Frame]:
        """Event-driven transmit PDOs that are due after dt seconds more."""
        sent = []
        for number in range(4):
            cob_id, kind = self._transmit(number)
            self._since[number] += dt
            if cob_id & _INVALID or kind < 254:
                continue
            inhibit = self._store.get(0x1800 + number, 3) * _HUNDRED_US
            data = self._pack(number)
            if data != self._last[number] and self._since[number] >= inhibit:
                self._last[number], self._since[number] = data, 0.0
                sent.append(Frame(cob_id & 0x7FF, data))
        return sent

    def _transmit(self, number: int) -> tuple[int, int]:
        return self._store.get(0x1800 + number, 1), self._store.get(0x1800 + number, 2)

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
                data[at : at + size], "little", signed=self._store.signed(index, sub)
            )
            self._store.set(index, sub, value)
            at += size
        for index, sub, _ in entries:
            self._written(index, sub)
