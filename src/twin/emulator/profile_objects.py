"""The objects of the emulated plain CiA 402 drive, and its messages that an AKD does not send.

Segmented SDO transfers (CiA 301, 7.2.4.3), PDOs on events and on request, parameters that are
stored. Not emulated: block transfers, SYNC by the drive itself, dummy entries of mappings.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

from twin.base.data_file import read_packaged
from twin.emulator.drive_objects import (
    COB_ID_INVALID,
    NOT_NOW,
    PDO_PARAMETERS,
    READ_ONLY,
    UNKNOWN_COMMAND,
    VALUE_OUT_OF_RANGE,
    WRONG_LENGTH,
    AbortError,
    Frame,
    Key,
    ObjectDictionary,
    Pdos,
    read_objects,
    sdo_answer,
)

TOGGLE_ERROR = 0x05030000
NOT_STORED, NO_DATA = 0x08000020, 0x08000024
SAVE, LOAD = 0x65766173, 0x64616F6C
"""Signatures that 1010h and 1011h take: the texts ``save`` and ``load``."""
NO_REMOTE = 1 << 30
"""Bit of a COB-ID: no remote request is answered."""

_COB_IDS = {*((index, 1) for index in PDO_PARAMETERS), (0x1005, 0), (0x1014, 0)}
_NEVER_STORED = {0x1003, 0x1010, 0x1011, 0x6040, 0x607A, 0x60FF}
_RESTRICTED_WRITES = (
    range(0x001), range(0x001, 0x080), range(0x101, 0x181), range(0x581, 0x600),
    range(0x601, 0x680), range(0x6E0, 0x700), range(0x701, 0x800),
)  # fmt: skip
"""Identifiers that belong to other services (CiA 301, table 73)."""


@cache
def profile_table() -> dict[str, dict[str, Any]]:
    """The tables of ``profile_objects.toml``."""
    return read_packaged("twin.emulator", "profile_objects.toml")


def emergency_code(fault: int) -> int:
    """The emergency code for a fault number."""
    return int(profile_table()["emergency_codes"].get(str(fault), fault))


class ProfileObjects(ObjectDictionary):
    """All objects of a plain CiA 402 drive.

    Args:
        node: The drive's node, for its default COB-IDs.
    """

    def __init__(self, node: int) -> None:
        super().__init__(read_objects(profile_table(), node))
        self._allowed = {
            int(index, 16): frozenset(values)
            for index, values in profile_table()["allowed"].items()
        }

    def allows(self, index: int, value: int) -> bool:
        """Whether an object that takes some values only takes this one."""
        return index not in self._allowed or value in self._allowed[index]

    def check(self, index: int, sub: int, value: int) -> None:
        """Refuse what CiA 301 and 402 do not allow beyond a range.

        Raises:
            AbortError: The reason.
        """
        if not self.allows(index, value):
            raise AbortError(VALUE_OUT_OF_RANGE)
        if (index, sub) in _COB_IDS and not _is_cob_id(value):
            raise AbortError(VALUE_OUT_OF_RANGE)
        if index == 0x1005 and value >> 11:
            raise AbortError(VALUE_OUT_OF_RANGE)  # no SYNC is produced
        signature = {0x1010: SAVE, 0x1011: LOAD}.get(index)
        if signature is not None and value != signature:
            raise AbortError(NOT_STORED)
        if index in PDO_PARAMETERS:
            if sub == 2 and value in range(241, 254):
                raise AbortError(VALUE_OUT_OF_RANGE)
            if sub == 3 and not self.get(index, 1) & COB_ID_INVALID:
                raise AbortError(NOT_NOW)

    def stored(self) -> dict[Key, int]:
        """The values that can be stored: of all objects that can be written."""
        return {
            key: self._values[key]
            for key, each in self._objects.items()
            if each.access in {"rw", "rww"} and key[0] not in _NEVER_STORED
        }

    def load(self, values: dict[Key, int], first: int = 0x1000, last: int = 0xFFFF) -> None:
        """Take stored values of the indices from first to last; of others the default."""
        for key in self.stored():
            if first <= key[0] <= last:
                self._values[key] = values.get(key, self._objects[key].default)


def _is_cob_id(value: int) -> bool:
    """Whether a COB-ID has 11 bits, of a kind that may be set."""
    identifier = value & 0x1FFFFFFF
    return (
        not value & 1 << 29
        and identifier < 0x800
        and not any(identifier in each for each in _RESTRICTED_WRITES)
    )


@dataclass
class _Transfer:
    """A segmented transfer under way.

    Attributes:
        key: The object.
        data: What is still to be sent, or has come.
        size: Bytes that the client announced, None for none.
        download: Whether it comes from the client.
        toggle: Toggle bit of the next segment.
    """

    key: Key
    data: bytes
    size: int | None = None
    download: bool = False
    toggle: int = 0


class SdoServer:
    """Answers SDO requests by expedited and segmented transfers.

    Args:
        store: The objects.
        written: Called with index and subindex of what was written.
    """

    def __init__(self, store: ObjectDictionary, written: Callable[[int, int], None]) -> None:
        self._store, self._written = store, written
        self._transfer: _Transfer | None = None

    def answer(self, request: bytes, aborts: dict[Key, int]) -> bytes | None:
        """The answer to a request of eight bytes; None to anything else, and to an abort.

        Args:
            request: What the host sent.
            aborts: Objects that are refused, with the abort code.
        """
        if len(request) != 8:
            return None
        command, index, sub = struct.unpack_from("<BHB", request)
        segment = command & 0xE0 in {0x00, 0x60}
        transfer, self._transfer = self._transfer, None
        if segment:
            index, sub = transfer.key if transfer else (0, 0)
        try:
            if segment:
                return self._continue(transfer, command, request[1:])
            if (index, sub) not in aborts:
                if command & 0xE2 == 0x20:
                    return self._begin_download(request)
                if command & 0xE0 == 0x40 and len(self._store.read(index, sub)) > 4:
                    data = self._store.read(index, sub)
                    self._transfer = _Transfer((index, sub), data)
                    return struct.pack("<BHBI", 0x41, index, sub, len(data))
        except AbortError as refusal:
            return struct.pack("<BHBI", 0x80, index, sub, refusal.code)
        return sdo_answer(self._store, request, aborts, self._written)

    def _begin_download(self, request: bytes) -> bytes:
        command, index, sub, size = struct.unpack("<BHBI", request)
        known = self._store.find(index, sub)
        if known.access in {"const", "ro"}:
            raise AbortError(READ_ONLY)
        announced = size if command & 1 else None
        if announced not in {None, known.size}:
            raise AbortError(WRONG_LENGTH)
        self._transfer = _Transfer((index, sub), b"", announced, download=True)
        return struct.pack("<BHBI", 0x60, index, sub, 0)

    def _continue(self, transfer: _Transfer | None, command: int, data: bytes) -> bytes:
        """Answer a segment.

        Raises:
            AbortError: No such transfer is under way, or the segment is not the next one.
        """
        if transfer is None or transfer.download != (command & 0xE0 == 0x00):
            raise AbortError(UNKNOWN_COMMAND)
        if command >> 4 & 1 != transfer.toggle:
            raise AbortError(TOGGLE_ERROR)
        toggle, transfer.toggle = transfer.toggle << 4, transfer.toggle ^ 1
        if not transfer.download:
            part, transfer.data = transfer.data[:7], transfer.data[7:]
            if transfer.data:
                self._transfer = transfer
            head = toggle | (7 - len(part)) << 1 | (not transfer.data)
            return bytes((head,)) + part.ljust(7, b"\0")
        transfer.data += data[: 7 - (command >> 1 & 7)]
        if not command & 1:
            if len(transfer.data) > self._store.find(*transfer.key).size:
                raise AbortError(WRONG_LENGTH)
            self._transfer = transfer
        else:
            self._store.write(*transfer.key, transfer.data)
            self._written(*transfer.key)
        return bytes((0x20 | toggle,)) + bytes(7)


class EventPdos(Pdos):
    """PDOs of a drive that also sends them on events and on remote requests.

    Transmission type 0 is sent with the SYNC after a change, 254 and 255 after a change, but not
    within the inhibit time, and whenever the event timer ends.
    """

    def forget(self) -> None:
        """Start from nothing, as on entering the operational state."""
        super().forget()
        self._last: list[bytes | None] = [None] * 4
        self._since = [0.0] * 4

    def sync(self) -> list[Frame]:
        """Sample the synchronous transmit PDOs, then apply what was received for this SYNC."""
        changed = [
            self._send(number, cob_id)
            for number, cob_id, kind in self._valid()
            if kind == 0 and self._sample(number) != self._last[number]
        ]
        return changed + super().sync()

    def events(self, dt: float) -> list[Frame]:
        """The PDOs that are due after a further time in s."""
        sent = []
        for number, cob_id, kind in self._valid():
            self._since[number] += dt
            if kind < 254:
                continue
            record, since = 0x1800 + number, self._since[number] + 1e-9
            inhibited = self._last[number] is not None and since < self._store.get(record, 3) * 1e-4
            timer = self._store.get(record, 5) / 1e3
            changed = not inhibited and self._sample(number) != self._last[number]
            if changed or (timer and since >= timer):
                sent.append(self._send(number, cob_id))
        return sent

    def requested(self, identifier: int) -> list[Frame]:
        """The PDO that a remote request asks for, if that is allowed."""
        return [
            self._send(number, cob_id)
            for number, cob_id, _ in self._valid()
            if cob_id == identifier and not self._store.get(0x1800 + number, 1) & NO_REMOTE
        ]

    def _valid(self) -> list[tuple[int, int, int]]:
        """Number, identifier and transmission type of each transmit PDO that is valid."""
        found = []
        for number in range(4):
            cob_id, kind = self._parameters(0x1800 + number)
            if cob_id is not None and self._store.get(0x1A00 + number, 0):
                found.append((number, cob_id, kind))
        return found

    def _send(self, number: int, cob_id: int) -> Frame:
        data = self._sample(number)
        self._last[number], self._since[number] = data, 0.0
        return Frame(cob_id, data)
