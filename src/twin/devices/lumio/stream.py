"""From bytes and their arrival times to the ball's newest position and to faults."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from itertools import pairwise

from twin.devices.lumio.calibration import Calibration
from twin.devices.lumio.conditions import BAD_BYTES, CHECKSUM, FLOOD, OUT_OF_RANGE, UNKNOWN_PROTOCOL
from twin.devices.lumio.config import PlausibilityLimits
from twin.devices.lumio.decoder import Decoder, DecoderStats, Report
from twin.devices.lumio.detector import Detector, Doubt
from twin.devices.lumio.protocols import DECODERS
from twin.devices.lumio.tracking import Sample, Tracker
from twin.hal.interface import Condition, Fault

WHERE = "touch screen"
REFUSED = (
    (BAD_BYTES, "skipped", "bytes skipped"),
    (CHECKSUM, "checksum", "packets with a wrong checksum"),
    (OUT_OF_RANGE, "outside", "packets with a position beyond the screen"),
)
"""Which count of a decoder shows which condition."""


class TouchStream:
    """Turns what a port delivers into ball positions and faults; knows no port and no clock.

    Args:
        protocol: Name of the protocol, or ``auto``.
        capacity: Bytes per second from which the line counts as flooded.
        calibration: Screen units to plate axes; None for a screen mounted square and centred.
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
        self,
        protocol: str,
        capacity: float,
        calibration: Calibration | None,
        limits: PlausibilityLimits,
    ) -> None:
        self.decoder: Decoder | None = None if protocol == "auto" else DECODERS[protocol]()
        self.dropped = 0
        """Bytes dropped undecoded."""
        self.reports = 0
        """Reports taken in."""
        self.extent: tuple[float, float] | None = None
        """Sides of the sensing area along the screen's x and y, m, if the screen tells."""
        self._protocol = protocol
        self._detector = Detector()
        self._doubt = self._new_doubt()
        self._calibration = calibration
        self._capacity = capacity
        self._limits = limits
        self._tracker = Tracker(limits, calibration or Calibration.nominal(), self.report_fault)
        self._faults: deque[Fault] = deque(maxlen=1000)
        self._seen = DecoderStats()
        self._reported: dict[Condition, float] = {}
        self._arrived = 0.0
        self._deaf: float | None = None
        self._window = (-math.inf, 0)
        self._times: deque[float] = deque(maxlen=60)

    def _new_doubt(self) -> Doubt | None:
        return Doubt(self._protocol) if self._protocol in DECODERS else None

    @property
    def looks_like(self) -> str:
        """The protocol that the bytes look like, if that is not the one set; else empty."""
        return self._doubt.looks_like if self._doubt else ""

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

    def begin(self, decoder: Decoder | None) -> None:
        """Read with the decoder that an opened port asks for, if it does."""
        if decoder is None:
            return
        self.decoder, self._doubt = decoder, None
        self._seen = replace(decoder.stats)
        self.extent = decoder.extent
        if self._calibration is None and self.extent is not None:
            self._tracker.calibration = Calibration.nominal(size=self.extent)

    def forget(self) -> None:
        """Forget the ball and half a packet, as after the port was reopened."""
        self._tracker.forget()
        self._deaf = None
        self._doubt = self._new_doubt()
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
        reports: list[Report] = []
        if self.decoder:
            reports = self.decoder.feed(data)
        elif found := self._detector.feed(data):
            self.decoder, reports = found
            self._seen = replace(self.decoder.stats)
        if self._doubt:
            self._doubt.feed(data)
        self._recognise(time)
        return reports

    def _recognise(self, time: float) -> None:
        """Report bytes that are of another protocol than the one set, or of none that is known."""
        self._deaf = time if self._deaf is None else self._deaf
        if self.looks_like:
            heard = f"the bytes are of {self.looks_like}, not of {self._protocol}"
            self._report_rate_limited(time, UNKNOWN_PROTOCOL, heard)
        elif not self.stats.reports and time - self._deaf > self.DEAF:
            wanted = "no known protocol" if self._protocol == "auto" else f"no {self._protocol}"
            heard = f"{self.stats.bytes} bytes are of {wanted}"
            self._report_rate_limited(time, UNKNOWN_PROTOCOL, heard)

    def _measure(self, time: float, count: int) -> None:
        """Notice a line that is full, on which samples queue up and arrive late."""
        begin, total = self._window
        if time - begin >= self.WINDOW:
            begin, total = time, 0
        self._window = begin, total + count
        if total + count > self._capacity * self.WINDOW:
            self._report_rate_limited(
                time, FLOOD, f"{total + count} bytes within {self.WINDOW:g} s"
            )

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
