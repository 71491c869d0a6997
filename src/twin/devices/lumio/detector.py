"""Which protocol bytes are of, found by listening."""

from __future__ import annotations

from twin.devices.lumio.decoder import Report, StreamDecoder
from twin.devices.lumio.protocols import DECODERS


class Detector:
    """Feeds the decoders of all byte protocols until one of them understands the stream.

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
        self._decoders = [decoder() for decoder in DECODERS.values()]


class Doubt:
    """Whether bytes are of another protocol than the one that was set.

    It listens until they are seen to be of that one. Reports of the decoder set prove nothing:
    bytes of one protocol can look like now and then a packet of another.

    Args:
        protocol: The one set.
    """

    def __init__(self, protocol: str) -> None:
        self.looks_like = ""
        """The protocol that the bytes look like instead; empty while none does."""
        self._protocol = protocol
        self._detector: Detector | None = Detector()

    def feed(self, data: bytes) -> None:
        """Take in more bytes."""
        if self._detector is None:
            return
        found = self._detector.feed(data)
        if found:
            name = found[0].name
            self.looks_like = "" if name == self._protocol else name
            self._detector = None if name == self._protocol else Detector()
