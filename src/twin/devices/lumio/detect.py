"""Which protocol a stream of bytes speaks, found by listening."""

from __future__ import annotations

from twin.devices.lumio.decoder import Decoder, Report
from twin.devices.lumio.elo import Elo
from twin.devices.lumio.evdev import Evdev
from twin.devices.lumio.hid import Hid0006, Hid0007
from twin.devices.lumio.microtouch import MicroTouch

DECODERS: dict[str, type[Decoder]] = {
    decoder.name: decoder for decoder in (MicroTouch, Elo, Hid0006, Hid0007, Evdev)
}
"""Every protocol by the name a rig file gives it."""


class Detector:
    """Feeds the decoders of all byte protocols until one of them understands the stream.

    A protocol is taken when it has given several reports and these account for nearly all bytes of
    a stream long enough: a few packets of one can look like several of another.
    Input events are no candidate: their device is known by its path.
    After ``WINDOW`` bytes without a decision it starts afresh.
    """

    REPORTS = 3
    SHARE = 0.8
    LEAST = 60
    WINDOW = 1024

    def __init__(self) -> None:
        self._listened = 0
        self._start()

    @property
    def listened(self) -> int:
        """Bytes heard in vain."""
        return self._listened + self._decoders[0].tally.bytes

    def feed(self, data: bytes) -> tuple[Decoder, list[Report]] | None:
        """The decoder of the protocol and what it makes of these bytes, once it is known."""
        found = []
        for decoder in self._decoders:
            reports = decoder.feed(data)
            heard, given = decoder.tally.bytes, decoder.tally.reports
            understood = decoder.size * given / max(1, heard)
            if heard >= self.LEAST and given >= self.REPORTS and understood >= self.SHARE:
                found.append((understood, decoder, reports))
        if found:
            _, decoder, reports = max(found, key=lambda entry: entry[0])
            return decoder, reports
        if self._decoders[0].tally.bytes > self.WINDOW:
            self._listened += self._decoders[0].tally.bytes
            self._start()
        return None

    def _start(self) -> None:
        self._decoders: list[Decoder] = [MicroTouch(), Elo(), Hid0006(), Hid0007()]
