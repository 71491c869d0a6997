"""The protocols a Lumio screen may speak on a serial line, and which of them bytes are of."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, NamedTuple


class Contact(NamedTuple):
    """Something on the screen.

    Attributes:
        x: Position along the screen's first axis, as a fraction 0..1 of the protocol's range.
        y: Position along its second axis, downwards, as a fraction 0..1.
        down: Whether it touches; False in the one report of the lift-off.
        id: Number that stays the same while it touches; always 1 in protocols that have none.
    """

    x: float
    y: float
    down: bool
    id: int = 1


Report = tuple[Contact, ...]
"""The contacts of one packet."""


@dataclass(slots=True)
class DecoderStats:
    """What a decoder has met so far.

    Attributes:
        bytes: Bytes fed.
        reports: Packets with contacts.
        cut: Bytes before the first packet that may end one whose beginning was not heard.
        skipped: Other bytes that belong to no packet.
        checksum: Packets whose checksum is wrong.
        outside: Packets refused for a coordinate beyond the protocol's range.
    """

    bytes: int = 0
    reports: int = 0
    cut: int = 0
    skipped: int = 0
    checksum: int = 0
    outside: int = 0


class Packet(NamedTuple):
    """What a decoder makes of the beginning of its buffer.

    Attributes:
        length: Bytes it takes; 0 for a packet that is not complete yet.
        report: Its contacts, if it has any.
    """

    length: int
    report: Report | None = None


INCOMPLETE = Packet(0)


class Decoder(ABC):
    """Reports out of bytes; never raises, whatever the bytes."""

    name: ClassVar[str]
    """What a rig file calls the protocol."""
    patience: ClassVar[float] = 0.05
    """Seconds of silence after which half a packet will not be completed any more."""

    def __init__(self) -> None:
        self.stats = DecoderStats()
        self.extent: tuple[float, float] | None = None
        """Sides of the sensing area along the screen's x and y, m, if the panel tells."""

    @abstractmethod
    def feed(self, data: bytes) -> list[Report]:
        """The reports that these bytes complete, oldest first."""

    @abstractmethod
    def reset(self) -> None:
        """Give up on what has begun and has not been completed."""


class StreamDecoder(Decoder):
    """Reports out of a stream of bytes in any portions.

    A subclass says what a packet looks like. Bytes that start none are skipped one by one, so the
    stream is understood again at the next whole packet.
    """

    size: ClassVar[int]
    """Bytes of a packet with contacts."""

    def __init__(self) -> None:
        super().__init__()
        self._buffer = bytearray()
        self._joined = False

    def feed(self, data: bytes) -> list[Report]:
        """The reports that these bytes complete, oldest first."""
        self.stats.bytes += len(data)
        self._buffer += data
        reports = []
        at = 0
        while at < len(self._buffer):
            packet = self._packet(self._buffer, at)
            if packet is None:
                self._leave_out()
                at += 1
            elif packet.length == 0:
                break
            else:
                at += packet.length
                self._joined = True
                if packet.report is not None:
                    self.stats.reports += 1
                    reports.append(packet.report)
        del self._buffer[:at]
        return reports

    def reset(self) -> None:
        """Give up on the beginning of a packet that has not been completed."""
        for _ in self._buffer:
            self._leave_out()
        self._buffer.clear()

    def _leave_out(self) -> None:
        """Count a byte that belongs to no packet, or to one that began before the port was open."""
        if self._joined or self.stats.cut == self.size - 1:
            self.stats.skipped += 1
        else:
            self.stats.cut += 1

    @abstractmethod
    def _packet(self, buffer: bytearray, at: int) -> Packet | None:
        """The packet that begins at an index; INCOMPLETE, or None where none can begin."""


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
        return Packet(self.size)

    def _touch(self, packet: bytearray) -> Report | None:
        status, x, y = packet[2], packet[3] | packet[4] << 8, packet[5] | packet[6] << 8
        if x > _SMARTSET_TOP or y > _SMARTSET_TOP:
            self.stats.outside += 1
            return None
        down = bool(status & _TOUCHING) and not status & _LIFTED
        return (Contact(x / _SMARTSET_TOP, y / _SMARTSET_TOP, down),)


STREAMS: dict[str, type[StreamDecoder]] = {
    decoder.name: decoder for decoder in (MicroTouchDecoder, EloDecoder)
}
"""The protocols of a serial line by the names a rig file gives them; listening tells them apart."""


class Detector:
    """Feeds the decoders of all serial protocols until one of them understands the stream.

    A protocol is taken when it has given several reports and these account for nearly all bytes of
    a stream long enough: a few packets of one can look like several of another.
    After ``WINDOW`` bytes without a decision it starts afresh.
    """

    REPORTS = 3
    """Reports that a protocol must have given."""
    SHARE = 0.8
    """Share of the bytes that they must account for."""
    LEAST = 60
    """Bytes that must have been heard."""
    WINDOW = 1024

    def __init__(self) -> None:
        self._listened = 0
        self._start()

    @property
    def listened(self) -> int:
        """Bytes heard in vain."""
        return self._listened + self._decoders[0].stats.bytes

    def feed(self, data: bytes) -> tuple[StreamDecoder, list[Report]] | None:
        """The decoder of the protocol and what it makes of these bytes, once it is known."""
        found = []
        for decoder in self._decoders:
            reports = decoder.feed(data)
            heard, given = decoder.stats.bytes, decoder.stats.reports
            understood = decoder.size * given / max(1, heard)
            if heard >= self.LEAST and given >= self.REPORTS and understood >= self.SHARE:
                found.append((understood, decoder, reports))
        if found:
            _, decoder, reports = max(found, key=lambda entry: entry[0])
            return decoder, reports
        if self._decoders[0].stats.bytes > self.WINDOW:
            self._listened += self._decoders[0].stats.bytes
            self._start()
        return None

    def _start(self) -> None:
        self._decoders = [decoder() for decoder in STREAMS.values()]
