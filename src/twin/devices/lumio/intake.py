"""From bytes and their arrival times to the ball's newest position, and to what is wrong."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from itertools import pairwise

from twin.devices.lumio.calibration import Calibration
from twin.devices.lumio.conditions import BAD_BYTES, CHECKSUM, FLOOD, OUT_OF_RANGE, UNKNOWN_PROTOCOL
from twin.devices.lumio.decoder import Decoder, Report, Tally
from twin.devices.lumio.detect import DECODERS, Detector
from twin.devices.lumio.gate import Gate, Sample
from twin.devices.lumio.tracker import Tracker
from twin.hal.faults import Condition, Fault

WHERE = "touch screen"
REFUSED = (
    (BAD_BYTES, "skipped", "bytes skipped"),
    (CHECKSUM, "checksum", "packets with a wrong checksum"),
    (OUT_OF_RANGE, "outside", "packets with a position beyond the screen"),
)
"""Which count of a decoder tells which condition."""


class Intake:
    """Takes what a port delivers; knows no port and no clock.

    Args:
        protocol: Name of the protocol, or ``auto``.
        capacity: Bytes a second from which the line counts as flooded.
        calibration: Screen units to plate.
        gate: What is plausible.
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
        self, protocol: str, capacity: float, calibration: Calibration, gate: Gate
    ) -> None:
        self.decoder: Decoder | None = None if protocol == "auto" else DECODERS[protocol]()
        self.dropped = 0
        """Bytes dropped undecoded."""
        self.reports = 0
        """Reports taken in."""
        self._detector = Detector()
        self._capacity = capacity
        self._gate = gate
        self._tracker = Tracker(gate, calibration, self.tell)
        self._faults: deque[Fault] = deque(maxlen=1000)
        self._seen = Tally()
        self._told: dict[Condition, float] = {}
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
        """Reports a second over the last ones, pauses without a touch left out."""
        times = list(self._times)
        gaps = [b - a for a, b in pairwise(times) if b - a <= self._gate.lost]
        return len(gaps) / sum(gaps) if sum(gaps) > 0 else 0.0

    @property
    def tally(self) -> Tally:
        """What the decoder has met so far."""
        return self.decoder.tally if self.decoder else Tally(bytes=self._detector.listened)

    def tell(self, condition: Condition, detail: str) -> None:
        """Note a condition detected; any thread may."""
        self._faults.append(Fault(condition, WHERE, detail))

    def faults(self) -> list[Fault]:
        """What has been detected since the last call, oldest first; any thread may ask."""
        return [self._faults.popleft() for _ in range(len(self._faults))]

    def forget(self) -> None:
        """Forget the ball and half a packet, as after the port was opened anew."""
        self._tracker.forget()
        self._deaf = None
        if self.decoder:
            self.decoder.reset()
            self._seen = replace(self.decoder.tally)

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
            self._seen = replace(self.decoder.tally)
            return reports
        self._deaf = time if self._deaf is None else self._deaf
        if time - self._deaf > self.DEAF:
            heard = f"{self._detector.listened} bytes are of no known protocol"
            self._now_and_then(time, UNKNOWN_PROTOCOL, heard)
        return []

    def _measure(self, time: float, count: int) -> None:
        """Notice a line that is full, on which samples queue up and arrive late."""
        begin, total = self._window
        total += count
        if total > self._capacity * self.WINDOW:
            self._now_and_then(time, FLOOD, f"{total} bytes in {time - begin:.2f} s")
        self._window = (time, 0) if time - begin >= self.WINDOW else (begin, total)

    def _compare(self, time: float) -> None:
        """Tell what the decoder has refused since it was last told."""
        tally = self.tally
        for condition, name, what in REFUSED:
            now, before = getattr(tally, name), getattr(self._seen, name)
            if now > before and self._now_and_then(time, condition, f"{now - before} {what}"):
                setattr(self._seen, name, now)

    def _now_and_then(self, time: float, condition: Condition, detail: str) -> bool:
        """Tell a condition unless it was told a moment ago; return whether it was."""
        if time - self._told.get(condition, -self.QUIET) < self.QUIET:
            return False
        self._told[condition] = time
        self.tell(condition, detail)
        return True
