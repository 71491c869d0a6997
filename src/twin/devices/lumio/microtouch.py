"""MicroTouch Format Tablet: five bytes, the first marked by its highest bit, no checksum."""

from __future__ import annotations

from twin.devices.lumio.decoder import INCOMPLETE, Contact, Decoder, Packet

_TOP = 16383
_START, _END = 0x01, 0x0D
_LONGEST_REPLY = 34


class MicroTouch(Decoder):
    """Decoder of Format Tablet (MicroTouch EX Serial Reference Guide, p. 27).

    Its origin is at the bottom left; y is turned here, so that it counts downwards as in the other
    protocols. There being no checksum, a damaged stream can yield false positions.
    """

    name = "microtouch"
    size = 5

    def _packet(self, buffer: bytearray, at: int) -> Packet | None:
        first = buffer[at]
        if first == _START:
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
        return Packet(self.size, (Contact(x / _TOP, 1 - y / _TOP, bool(first & 0x40)),))

    def _reply(self, buffer: bytearray, at: int) -> Packet | None:
        """An answer to a command: SOH, printable characters, CR."""
        for index in range(at + 1, min(len(buffer), at + _LONGEST_REPLY)):
            byte = buffer[index]
            if byte == _END:
                self.tally.replies += 1
                return Packet(index + 1 - at)
            if not 0x20 <= byte < 0x7F:
                return None
        return INCOMPLETE if len(buffer) - at < _LONGEST_REPLY else None
