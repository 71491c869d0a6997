"""Base of the protocol decoders: bytes in any portions to reports of contacts."""

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
        replies: Packets that answer a command.
        cut: Bytes before the first packet that may end one whose beginning was not heard.
        skipped: Other bytes that belong to no packet.
        checksum: Packets whose checksum is wrong.
        outside: Packets refused for a coordinate beyond the protocol's range.
    """

    bytes: int = 0
    reports: int = 0
    replies: int = 0
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

    @property
    def extent(self) -> tuple[float, float] | None:
        """Sides of the sensing area along the screen's x and y, m, if the screen tells."""
        return None

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
