"""Elo SmartSet: ten bytes with a checksum."""

from __future__ import annotations

from twin.devices.lumio.decoder import INCOMPLETE, Contact, Decoder, Packet, Report

_LEAD = ord("U")
_TOUCH = ord("T")
_TOP = 4095
_TOUCHING, _LIFTED = 0x03, 0x04


class Elo(Decoder):
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
            self.tally.checksum += packet[1] == _TOUCH
            return None
        if packet[1] == _TOUCH:
            return Packet(self.size, self._touch(packet))
        self.tally.replies += 1
        return Packet(self.size)

    def _touch(self, packet: bytearray) -> Report | None:
        status, x, y = packet[2], packet[3] | packet[4] << 8, packet[5] | packet[6] << 8
        if x > _TOP or y > _TOP:
            self.tally.outside += 1
            return None
        down = bool(status & _TOUCHING) and not status & _LIFTED
        return (Contact(x / _TOP, y / _TOP, down),)
