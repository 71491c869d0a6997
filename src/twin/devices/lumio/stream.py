"""From bytes and their arrival times to the ball's newest position and to faults."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from itertools import pairwise

from twin.devices.lumio.calibration import Calibration
from twin.devices.lumio.conditions import BAD_BYTES, CHECKSUM, FLOOD, OUT_OF_RANGE, UNKNOWN_PROTOCOL
from twin.devices.lumio.config import PlausibilityLimits
from twin.devices.lumio.decoder import Decoder, DecoderStats, Report
from twin.devices.lumio.protocols import BYTE_DECODERS, DECODERS
from twin.devices.lumio.tracking import Sample, Tracker
from twin.hal.faults import Condition, Fault

WHERE = "touch screen"
REFUSED = (
    (BAD_BYTES, "skipped", "bytes skipped"),
    (CHECKSUM, "checksum", "packets with a wrong checksum"),
    (OUT_OF_RANGE, "outside", "packets with a position beyond the screen"),
)
"""Which count of a decoder shows which condition."""


class Detector:
    """Feeds the decoders of all byte protocols until one of them understands the stream.

    A protocol is taken when it has given several reports and these account for nearly all bytes of
    a stream long enough: a few packets of one can look like several of another.
    Input events are no candidate: their device is known by its path.
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

    def feed(self, data: bytes) -> tuple[Decoder, list[Report]] | None:
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
        self._decoders = [decoder() for decoder in BYTE_DECODERS]


class TouchStream:
    """Turns what a port delivers into ball positions and faults; knows no port and no clock.

    Args:
        protocol: Name of the protocol, or ``auto``.
        capacity: Bytes per second from which the line counts as flooded.
        calibration: Screen units to plate axes.
        limits: What is plausible.
    """

    WINDOW = 0.25
    """Seconds over which bytes are counted for a flood."""
    QUIET = 0.5
    """Shortest time in s between two faults of one condition that comes with the bytes."""
    DEAF = 1.0
    """Seconds of bytes after which a protocol should have been recognised."""
    MOST = 256
    """Bytes of one reading that are decoded; older ones are dropped, to bound the time it takes."""

    def __init__(
        self, protocol: str, capacity: float, calibration: Calibration, limits: PlausibilityLimits
    ) -> None:
        self.decoder: Decoder | None = None if protocol == "auto" else DECODERS[protocol]()
        self.dropped = 0
        """Bytes dropped undecoded."""
        self.reports = 0
        """Reports taken in."""
        self._detector = Detector()
        self._capacity = capacity
        self._limits = limits
        self._tracker = Tracker(limits, calibration, self.report_fault)
        self._faults: deque[Fault] = deque(maxlen=1000)
        self._seen = DecoderStats()
        self._reported: dict[Condition, float] = {}
        self._arrived = 0.0
        self._deaf: float | None = None
        self._window = (0.0, 0)
        self._times: deque[float] = deque(maxlen=60)

    @property
    def sample(self) -> Sample | None:
        """The ball's newest position."""
        return self._tracker.sample

    @property
    def rate(self) -> float:
        """Reports per second over the last ones, pauses without a touch left out."""
        times = list(self._times)
        gaps = [b - a for a, b in pairwise(times) if b - a <= self._limits.lost]
        return len(gaps) / sum(gaps) if sum(gaps) > 0 else 0.0

    @property
    def stats(self) -> DecoderStats:
        """What the decoder has met so far."""
        return self.decoder.stats if self.decoder else DecoderStats(bytes=self._detector.listened)

    def report_fault(self, condition: Condition, detail: str) -> None:
        """Note a condition detected; any thread may."""
        self._faults.append(Fault(condition, WHERE, detail))

    def faults(self) -> list[Fault]:
        """What has been detected since the last call, oldest first; any thread may ask."""
        return [self._faults.popleft() for _ in range(len(self._faults))]

    def forget(self) -> None:
        """Forget the ball and half a packet, as after the port was reopened."""
        self._tracker.forget()
        self._deaf = None
        if self.decoder:
            self.decoder.reset()
            self._seen = replace(self.decoder.stats)

    def take(self, time: float, data: bytes) -> None:
        """Take in the bytes that arrived at a time in s, if any did."""
        silence = time - self._arrived
        if self.decoder and silence > self.decoder.patience:
            self.decoder.reset()
        if data:
            self._arrived = time
            self._measure(time, len(data))
            self.dropped += max(0, len(data) - self.MOST)
            for report in self._decode(time, data[-self.MOST :]):
                self.reports += 1
                self._times.append(time)
                self._tracker.take(time, report)
        self._compare(time)

    def _decode(self, time: float, data: bytes) -> list[Report]:
        if self.decoder:
            return self.decoder.feed(data)
        found = self._detector.feed(data)
        if found:
            self.decoder, reports = found
            self._seen = replace(self.decoder.stats)
            return reports
        self._deaf = time if self._deaf is None else self._deaf
        if time - self._deaf > self.DEAF:
            heard = f"{self._detector.listened} bytes are of no known protocol"
            self._report_rate_limited(time, UNKNOWN_PROTOCOL, heard)
        return []

    def _measure(self, time: float, count: int) -> None:
        """Notice a line that is full, on which samples queue up and arrive late."""
        begin, total = self._window
        total += count
        if total > self._capacity * self.WINDOW:
            self._report_rate_limited(time, FLOOD, f"{total} bytes in {time - begin:.2f} s")
        self._window = (time, 0) if time - begin >= self.WINDOW else (begin, total)

    def _compare(self, time: float) -> None:
        """Report what the decoder has refused since the last report of it."""
        stats = self.stats
        for condition, name, what in REFUSED:
            now, before = getattr(stats, name), getattr(self._seen, name)
            detail = f"{now - before} {what}"
            if now > before and self._report_rate_limited(time, condition, detail):
                setattr(self._seen, name, now)

    def _report_rate_limited(self, time: float, condition: Condition, detail: str) -> bool:
        """Report a condition at most once per ``QUIET``; return whether it was reported."""
        if time - self._reported.get(condition, -self.QUIET) < self.QUIET:
            return False
        self._reported[condition] = time
        self.report_fault(condition, detail)
        return True
