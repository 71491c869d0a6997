"""USB HID reports of the Crystal Touch, as its two report descriptors lay them out."""

from __future__ import annotations

import struct

from twin.devices.lumio.decoder import INCOMPLETE, Contact, Decoder, Packet

_TOP = 32767
_DOWN, _UP = 0x31, 0x30
_BLOCK = struct.Struct("<BBHH")
_SINGLE = struct.Struct("<BBHHH")
_BLOCKS = 4
_MOST = 8
_UNUSED = bytes(_BLOCK.size)
_USB_PATIENCE = 0.008
# Neither layout has a mark of its beginning. What recorded reports have in common tells it: bits 0,
# 4 and 5 of a status are tip, in range, confidence, and only 0x31 and 0x30 (lift-off) occur.


class Hid0006(Decoder):
    """Decoder of product 202E:0006: four blocks of a contact each, then the number of contacts.

    With more than four, the rest follow in a second report whose number is 0.
    """

    name = "hid-0006"
    size = _BLOCKS * _BLOCK.size + 1
    patience = _USB_PATIENCE

    def __init__(self) -> None:
        super().__init__()
        self._left = 0

    def _packet(self, buffer: bytearray, at: int) -> Packet | None:
        if buffer[at] not in {_DOWN, _UP}:
            return None
        packet = bytes(buffer[at : at + self.size])
        if len(packet) < self.size:
            return INCOMPLETE
        number = packet[-1] or self._left
        used = min(number, _BLOCKS)
        blocks = [packet[i : i + _BLOCK.size] for i in range(0, self.size - 1, _BLOCK.size)]
        values = [_BLOCK.unpack(block) for block in blocks[:used]]
        known = all(status in {_DOWN, _UP} and name > 0 for status, name, _, _ in values)
        unused = all(block == _UNUSED for block in blocks[used:])
        if not (1 <= number <= _MOST and known and unused):
            return None
        self._left = number - _BLOCKS if number > _BLOCKS else 0
        if any(x > _TOP or y > _TOP for _, _, x, y in values):
            self.tally.outside += 1
            return Packet(self.size)
        contacts = [
            Contact(x / _TOP, y / _TOP, status == _DOWN, name) for status, name, x, y in values
        ]
        return Packet(self.size, tuple(contacts))


class Hid0007(Decoder):
    """Decoder of product 202E:0007: one contact a report, several contacts taking turns."""

    name = "hid-0007"
    size = _SINGLE.size
    patience = _USB_PATIENCE

    def _packet(self, buffer: bytearray, at: int) -> Packet | None:
        if buffer[at] not in {_DOWN, _UP}:
            return None
        packet = bytes(buffer[at : at + self.size])
        if len(packet) < self.size:
            return INCOMPLETE
        status, pad, x, y, name = _SINGLE.unpack(packet)
        if pad or not 1 <= name <= 0xFF:
            return None
        if x > _TOP or y > _TOP:
            self.tally.outside += 1
            return Packet(self.size)
        return Packet(self.size, (Contact(x / _TOP, y / _TOP, status == _DOWN, name),))
