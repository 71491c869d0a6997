"""The SDO server of an emulated drive: expedited transfers; its objects need no others."""

from __future__ import annotations

import struct
from collections.abc import Callable

from twin.emulator.drive_objects import AbortError, Store

_HEAD = struct.Struct("<BHB")
_UNKNOWN_COMMAND = 0x05040001


def answer(
    store: Store,
    request: bytes,
    *,
    at_rest: bool,
    aborts: dict[tuple[int, int], int],
    written: Callable[[int, int], None],
) -> bytes | None:
    """The answer to a request of eight bytes; None to anything else, and to an abort.

    Args:
        store: The objects.
        request: What the host sent.
        at_rest: Whether the motor stands.
        aborts: Objects that are refused, with the abort code.
        written: Told the index and subindex of what was written.
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
            size = 4 - (command >> 2 & 3) if command != 0x22 else store.size(index, sub)
            store.write(index, sub, request[4 : 4 + size], at_rest=at_rest)
            written(index, sub)
            return _HEAD.pack(0x60, index, sub) + bytes(4)
        raise AbortError(_UNKNOWN_COMMAND)
    except AbortError as refusal:
        return _HEAD.pack(0x80, index, sub) + struct.pack("<I", refusal.code)
