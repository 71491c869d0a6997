"""The protocols a Lumio screen may speak: two serial ones, two USB reports."""

from __future__ import annotations

import struct

from twin.devices.lumio.decoder import INCOMPLETE, Contact, Packet, Report, StreamDecoder

_TABLET_TOP = 16383
_REPLY_START, _REPLY_END = 0x01, 0x0D
_LONGEST_REPLY = 34


class MicroTouchDecoder(StreamDecoder):
    """Decoder of Format Tablet (MicroTouch EX Serial Reference Guide, p. 27).

    Five bytes, the first marked by its highest bit. The origin is at the bottom left; y is turned
    here, so that it counts downwards as in the other protocols. There being no checksum, a damaged
    stream can yield false positions.
    """

    name = "microtouch"
    size = 5

    def _packet(self, buffer: bytearray, at: int) -> Packet | None:
        first = buffer[at]
        if first == _REPLY_START:
            return self._reply(buffer, at)
        if not first & 0x80:
            return None
        body = buffer[at + 1 : at + self.size]
        if any(byte & 0x80 for byte in body):
            return None
        if len(body) < self.size - 1:
            return INCOMPLETE
        x = body[0] | body[1] << 7
        y = body[2] | body[3] << 7
        contact = Contact(x / _TABLET_TOP, 1 - y / _TABLET_TOP, bool(first & 0x40))
        return Packet(self.size, (contact,))

    def _reply(self, buffer: bytearray, at: int) -> Packet | None:
        """An answer to a command: SOH, printable characters, CR."""
        for index in range(at + 1, min(len(buffer), at + _LONGEST_REPLY)):
            byte = buffer[index]
            if byte == _REPLY_END:
                self.stats.replies += 1
                return Packet(index + 1 - at)
            if not 0x20 <= byte < 0x7F:
                return None
        return INCOMPLETE if len(buffer) - at < _LONGEST_REPLY else None


_SMARTSET_TOP = 4095
_LEAD, _TOUCH = ord("U"), ord("T")
_TOUCHING, _LIFTED = 0x03, 0x04


class EloDecoder(StreamDecoder):
    """Decoder of the 10-byte SmartSet packets (Elo SmartSet guide, p. A-53).

    A packet is ``U``, a letter, status, x, y, z (each little-endian) and the sum of all bytes
    before it plus 0xAA. Coordinates are 12 bit; which way y counts is left to the calibration.
    """

    name = "elo"
    size = 10

    def _packet(self, buffer: bytearray, at: int) -> Packet | None:
        packet = buffer[at : at + self.size]
        if packet[0] != _LEAD or not ord("A") <= (packet[1:2] or b"T")[0] <= ord("Z"):
            return None
        if len(packet) < self.size:
            return INCOMPLETE
        if (0xAA + sum(packet[:-1])) & 0xFF != packet[-1]:
            self.stats.checksum += packet[1] == _TOUCH
            return None
        if packet[1] == _TOUCH:
            return Packet(self.size, self._touch(packet))
        self.stats.replies += 1
        return Packet(self.size)

    def _touch(self, packet: bytearray) -> Report | None:
        status, x, y = packet[2], packet[3] | packet[4] << 8, packet[5] | packet[6] << 8
        if x > _SMARTSET_TOP or y > _SMARTSET_TOP:
            self.stats.outside += 1
            return None
        down = bool(status & _TOUCHING) and not status & _LIFTED
        return (Contact(x / _SMARTSET_TOP, y / _SMARTSET_TOP, down),)


# Neither USB report has a mark of its beginning. What recorded reports have in common identifies
# it: bits 0, 4 and 5 of a status are tip, in range, confidence, and only two values occur.
_DOWN, _UP = 0x31, 0x30
_USB_TOP = 32767
_USB_PATIENCE = 0.008
_BLOCK = struct.Struct("<BBHH")
_BLOCKS = 4
_UNUSED = bytes(_BLOCK.size)
_MOST_CONTACTS = 8
_SINGLE = struct.Struct("<BBHHH")


class Hid0006Decoder(StreamDecoder):
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
        if not (1 <= number <= _MOST_CONTACTS and known and unused):
            return None
        self._left = number - _BLOCKS if number > _BLOCKS else 0
        if any(x > _USB_TOP or y > _USB_TOP for _, _, x, y in values):
            self.stats.outside += 1
            return Packet(self.size)
        contacts = [
            Contact(x / _USB_TOP, y / _USB_TOP, status == _DOWN, name)
            for status, name, x, y in values
        ]
        return Packet(self.size, tuple(contacts))


class Hid0007Decoder(StreamDecoder):
    """Decoder of product 202E:0007: one contact per report, several contacts taking turns."""

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
        if x > _USB_TOP or y > _USB_TOP:
            self.stats.outside += 1
            return Packet(self.size)
        return Packet(self.size, (Contact(x / _USB_TOP, y / _USB_TOP, status == _DOWN, name),))


DECODERS: dict[str, type[StreamDecoder]] = {
    decoder.name: decoder
    for decoder in (MicroTouchDecoder, EloDecoder, Hid0006Decoder, Hid0007Decoder)
}
"""Every protocol by the name a rig file gives it; they can be told apart by listening."""
