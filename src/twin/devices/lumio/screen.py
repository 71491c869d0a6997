"""The Lumio touch screen as a device of the rig: from bytes to the ball, a thread that reads them.

Times are arrival times on any clock, in s; positions are in m in plate axes.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from enum import StrEnum
from itertools import pairwise
from typing import NamedTuple, Self

import numpy as np

from controllers.arrays import Array
from twin.base.errors import plural
from twin.devices.lumio import conditions as c
from twin.devices.lumio.config import (
    PORT_CLASSES,
    Calibration,
    LumioConfig,
    PlausibilityLimits,
    ScreenError,
    Transport,
)
from twin.devices.lumio.protocols import (
    Contact,
    Decoder,
    DecoderStats,
    Detector,
    Report,
    decoder_of,
)
from twin.devices.lumio.scan_time import ScanClock
from twin.devices.realtime import ahead
from twin.hal.interface import Condition, Fault, Touch


class TouchState(StrEnum):
    """State of the detection of the ball.

    TOUCHING: reported a moment ago. LIFTED: a lift-off was reported. STALE: reports have ceased
    without a lift-off. LOST: for too long either way, or never seen.
    """

    TOUCHING = "touching"
    LIFTED = "lifted"
    STALE = "stale"
    LOST = "lost"


ReportFault = Callable[[Condition, str], None]
"""Takes a condition detected and what was seen, in words and numbers."""


Place = tuple[float, float]
"""A position, m in plate axes."""


class Sample(NamedTuple):
    """The newest accepted position.

    Attributes:
        time: When it arrived.
        position: Where, m in plate axes.
        lifted: Whether a lift-off has been reported since.
        since: Since when the position has not changed at all.
    """

    time: float
    position: Place
    lifted: bool
    since: float


class Tracker:
    """Follows one ball through the reports, and notices when it is lost or disobeys the tilt.

    Args:
        limits: What is plausible.
        calibration: Screen units to plate axes.
        report_fault: Called with each condition detected.
    """

    WINDOW = 0.05
    """Time in s over which the speed of a ball is measured."""

    def __init__(
        self, limits: PlausibilityLimits, calibration: Calibration, report_fault: ReportFault
    ) -> None:
        self._limits = limits
        self.calibration = calibration
        """Screen units to plate axes."""
        self._report_fault = report_fault
        self.sample: Sample | None = None
        self._id = 0
        self._live: dict[int, float] = {}
        self._crowd = 0
        self._waiting: list[tuple[float, Place]] = []
        self._path: list[tuple[float, Place]] = []
        self._same = 0
        self._swapped = False
        self._state = TouchState.LOST
        self._tilted: float | None = None
        self._frozen = False

    def state(self, time: float) -> TouchState:
        """Knowledge of the ball at a time."""
        return self._known(self.sample, time)

    def _known(self, sample: Sample | None, time: float) -> TouchState:
        if sample is None:
            return TouchState.LOST
        age = time - sample.time
        if age > self._limits.lost:
            return TouchState.LOST
        if sample.lifted:
            return TouchState.LIFTED
        return TouchState.STALE if age > self._limits.stale else TouchState.TOUCHING

    def watch(self, time: float) -> None:
        """Notice what has become of the ball since the last call."""
        sample = self.sample
        before, self._state = self._state, self._known(sample, time)
        if sample is None or self._state == before:
            return
        end = "after a lift-off" if sample.lifted else "without a lift-off"
        detail = f"no touch for {1000 * (time - sample.time):.0f} ms {end}"
        if self._state == TouchState.STALE:
            self._report_fault(c.STALE, detail)
        elif self._state == TouchState.LOST:
            self._report_fault(c.TOUCH_LOST, detail)

    def note_tilt(self, time: float, tilt: float) -> None:
        """Take in the plate's tilt, the larger of both angles, rad: no ball rests on a steep plate.

        What keeps reporting one and the same position there is a frozen touch.
        """
        sample = self.sample
        if tilt <= self._limits.tilt or self._state != TouchState.TOUCHING or sample is None:
            self._tilted = None
            return
        self._tilted = time if self._tilted is None else self._tilted
        rest = time - max(self._tilted, sample.since)
        if rest <= self._limits.rest:
            self._frozen = False
        elif not self._frozen:
            self._frozen = True
            self._report_fault(
                c.TOUCH_FROZEN, f"no motion in {rest:.2f} s on a plate tilted by {tilt:.3f} rad"
            )

    def take(self, time: float, report: Report) -> None:
        """Take in a report that arrived at a time."""
        down = [contact for contact in report if contact.down]
        for contact in report:
            if contact.down:
                self._live[contact.id] = time
            else:
                self._live.pop(contact.id, None)
                if self.sample is not None and contact.id == self._id:
                    self.sample = self.sample._replace(lifted=True)
        self._live = {
            name: seen for name, seen in self._live.items() if time - seen <= self._limits.stale
        }
        self._count(len(self._live), bool(down))
        if down:
            self._follow(time, down)

    def _count(self, contacts: int, touching: bool) -> None:
        """Report several contacts once they stay."""
        if contacts < 2:
            self._crowd = 0
        elif touching:
            self._crowd += 1
            if self._crowd == 2:
                self._report_fault(c.TWO_CONTACTS, f"{contacts} contacts")

    def _follow(self, time: float, down: list[Contact]) -> None:
        last = self.sample
        if last is not None and time - last.time > self._limits.lost:
            last = None
        if last is None and self._swapped:
            return
        contact = self._nearest(last, down)
        if contact is None:
            return
        point = self.calibration.plate(contact.x, contact.y)
        if last is not None and self._continues(time, point, last):
            self._accept(time, contact.id, point, last)
        elif self._wait(time, point, last) and (
            last is None or self._relocated(time, contact, point, last)
        ):
            self._accept(time, contact.id, point, None)

    def _nearest(self, last: Sample | None, down: list[Contact]) -> Contact | None:
        """The contact that is the ball; None if these are others, the ball being touched too."""
        if last is None:
            return min(down, key=lambda contact: contact.id)
        here = last.position
        if self._id in self._live and all(contact.id != self._id for contact in down):
            return None
        return min(down, key=lambda one: math.dist(self.calibration.plate(one.x, one.y), here))

    def _continues(self, time: float, point: Place, last: Sample) -> bool:
        """Whether a position goes on from the last one, not from the refused ones since."""
        away = math.dist(point, last.position)
        if self._waiting and math.dist(point, self._waiting[-1][1]) < away:
            return False
        return self._reaches(time - last.time, last.position, point)

    def _wait(self, time: float, point: Place, last: Sample | None) -> bool:
        """Keep a position that cannot be the ball yet; return whether it is confirmed by others."""
        if self._waiting:
            before, there = self._waiting[-1]
            gap = time - before
            if gap > self._limits.stale or not self._reaches(gap, there, point):
                self._waiting.clear()
        elif last is not None:
            self._report_fault(c.JUMP, f"from {_place(last.position)} to {_place(point)}")
        self._waiting.append((time, point))
        return len(self._waiting) >= self._limits.confirm

    def _relocated(self, time: float, contact: Contact, point: Place, last: Sample) -> bool:
        """Report a confirmed jump; return whether the ball is there, not x and y exchanged."""
        turned = self.calibration.plate(contact.y, contact.x)
        words = f"from {_place(last.position)} to {_place(point)}"
        way, turned_way = math.dist(point, last.position), math.dist(turned, last.position)
        if turned_way > way / 2 or not self._reaches(time - last.time, last.position, turned):
            self._report_fault(c.RELOCATED, words)
            return True
        if not self._swapped:
            self._report_fault(c.SWAPPED_AXES, words)
        self._swapped = True
        return False

    def _accept(self, time: float, name: int, point: Place, last: Sample | None) -> None:
        since = time
        if last is None:
            self._path.clear()
            self._same = 0
        else:
            if time - last.time > self._limits.stale or last.lifted:
                self._report_fault(c.DROPOUT, f"no touch for {1000 * (time - last.time):.0f} ms")
            if point == last.position:
                since = last.since
        self._waiting.clear()
        self._swapped = False
        self._id = name
        self.sample = Sample(time, point, False, since)
        self._judge(time, point)

    def _judge(self, time: float, point: Place) -> None:
        """Report a ball that stops dead; its path ends where it was last seen to move."""
        if self._path and self._path[-1][1] == point:
            self._same += 1
            (first, begin), (end, stop) = self._path[0], self._path[-1]
            speed = math.dist(begin, stop) / (end - first) if end > first else 0.0
            if self._same == self._limits.still and speed > self._limits.halt:
                self._report_fault(
                    c.TOUCH_FROZEN, f"stopped dead at {_place(point)} from {speed:.2f} m/s"
                )
            return
        self._same = 0
        self._path = [entry for entry in self._path if time - entry[0] <= self.WINDOW]
        self._path.append((time, point))

    def _reaches(self, time: float, here: Place, there: Place) -> bool:
        """Whether a ball can get from ``here`` to ``there`` within a time in s."""
        return math.dist(here, there) <= self._limits.slack + self._limits.speed * time


def _place(point: Place) -> str:
    return f"({point[0]:.3f}, {point[1]:.3f}) m"


SCREEN_PLACE = "touch screen"
REFUSED_COUNTS = (
    (c.BAD_BYTES, "skipped", "bytes skipped"),
    (c.CHECKSUM, "checksum", "packets with a wrong checksum"),
    (c.OUT_OF_RANGE, "outside", "packets with a position beyond the screen"),
)
"""The conditions that the counts of a decoder show."""


class TouchStream:
    """Turns what a port delivers into ball positions and faults; knows no port and no clock.

    Args:
        config: Protocol, calibration, what is plausible, and what the line carries.
    """

    WINDOW = 0.25
    """Seconds over which bytes are counted for a flood."""
    QUIET = 0.5
    """Shortest time in s between two faults of one condition that comes with the bytes."""
    DEAF = 1.0
    """Seconds of bytes after which a protocol should have been recognised."""
    MOST = 256
    """Bytes of one reading that are decoded; older ones are dropped, to bound the time it takes."""

    def __init__(self, config: LumioConfig) -> None:
        named = None if config.protocol == "auto" else decoder_of(config.protocol)
        self.decoder: Decoder | None = named
        self.heard = 0
        """Bytes heard since the port was opened."""
        self.extent: tuple[float, float] | None = None
        """Sides of the sensing area along the screen's x and y, m, if the screen tells."""
        self.looks_like = ""
        """The protocol that the bytes look like, if that is not the one set; else empty."""
        self._config = config
        self._detector: Detector | None = Detector()
        calibration = config.calibration or Calibration.nominal()
        self.tracker = Tracker(config.gate, calibration, self.report_fault)
        """Where the ball is."""
        self._scans = ScanClock(config.gate.late)
        self._faults: deque[Fault] = deque(maxlen=1000)
        self._seen = DecoderStats()
        self._reported: dict[Condition, float] = {}
        self._arrived = 0.0
        self._deaf: float | None = None
        self._window = (-math.inf, 0)
        self._times: deque[float] = deque(maxlen=60)

    @property
    def rate(self) -> float:
        """Reports per second over the last ones, pauses without a touch left out."""
        times = list(self._times)
        gaps = [b - a for a, b in pairwise(times) if b - a <= self._config.gate.lost]
        return len(gaps) / sum(gaps) if sum(gaps) > 0 else 0.0

    @property
    def stats(self) -> DecoderStats:
        """Counts of the decoder so far."""
        return self.decoder.stats if self.decoder else DecoderStats()

    def report_fault(self, condition: Condition, detail: str) -> None:
        """Note a condition detected; any thread may."""
        self._faults.append(Fault(condition, SCREEN_PLACE, detail))

    def faults(self) -> list[Fault]:
        """Faults detected since the last call, oldest first; any thread may ask."""
        return [self._faults.popleft() for _ in range(len(self._faults))]

    def begin(self, decoder: Decoder | None) -> None:
        """Read with the decoder that an opened port asks for, if it does."""
        if decoder is None:
            return
        self.decoder, self._detector = decoder, None
        self.extent = decoder.extent
        if self._config.calibration is None and self.extent is not None:
            self.tracker.calibration = Calibration.nominal(self.extent)

    def take(self, time: float, data: bytes) -> None:
        """Take in the bytes that arrived at a time in s, if any did."""
        silence = time - self._arrived
        if self.decoder and silence > self.decoder.patience:
            self.decoder.reset()
        if data:
            self._arrived = time
            self.heard += len(data)
            self._measure(time, len(data))
            for report in self._decode(time, data[-self.MOST :]):
                self._times.append(time)
                if self._is_new(time, report):
                    self.tracker.take(time, report)
        self._compare(time)

    def _is_new(self, time: float, report: Report) -> bool:
        """Whether the contacts of a report have been scanned since the one before.

        A report of a lift-off is always taken; one that does not say is new.
        """
        touching = {contact.id for contact in report if contact.down}
        if report.scan is None or not touching:
            return True
        new = self._scans.is_new(time, report.scan, touching)
        if self._scans.stands_still:
            counter = f"{report.scan.time:.4f} s is no new one, for {self._scans.REPEATS} reports"
            self._report_rate_limited(time, c.SCAN_STILL, counter)
        if self._scans.falls_behind:
            late = f"{1e3 * self._scans.excess:.0f} ms later after the scan than the promptest"
            self._report_rate_limited(time, c.TOUCH_LATE, late)
        return new

    def _decode(self, time: float, data: bytes) -> list[Report]:
        reports = self.decoder.feed(data) if self.decoder else []
        found = self._detector.feed(data) if self._detector else None
        if found:
            # Only recognised bytes end the listening: reports of the configured decoder prove
            # nothing, as bytes of a different protocol sometimes look like one of its packets.
            decoder, heard = found
            if self.decoder is None:
                self.decoder, reports = decoder, heard
                self._seen = replace(decoder.stats)
            wrong = self._config.protocol not in {"auto", decoder.name}
            self.looks_like = decoder.name if wrong else ""
            self._detector = Detector() if wrong else None
        self._recognise(time)
        return reports

    def _recognise(self, time: float) -> None:
        """Report bytes of a protocol other than the configured one, or of no known protocol."""
        self._deaf = time if self._deaf is None else self._deaf
        protocol = self._config.protocol
        if self.looks_like:
            heard = f"the bytes are of {self.looks_like}, not of {protocol}"
            self._report_rate_limited(time, c.UNKNOWN_PROTOCOL, heard)
        elif not self.stats.reports and time - self._deaf > self.DEAF:
            wanted = "no known protocol" if protocol == "auto" else f"no {protocol}"
            heard = f"{self.heard} bytes are of {wanted}"
            self._report_rate_limited(time, c.UNKNOWN_PROTOCOL, heard)

    def _measure(self, time: float, count: int) -> None:
        """Notice a line that is full, on which samples queue up and arrive late."""
        begin, total = self._window
        if time - begin >= self.WINDOW:
            begin, total = time, 0
        self._window = begin, total + count
        if total + count > self._config.capacity * self.WINDOW:
            self._report_rate_limited(
                time, c.FLOOD, f"{total + count} bytes within {self.WINDOW:g} s"
            )

    def _compare(self, time: float) -> None:
        """Report what the decoder has refused since the last report of it."""
        stats = self.stats
        for condition, name, what in REFUSED_COUNTS:
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


class LumioScreen:
    """A touch screen with one ball on it; a TouchScreen and FaultSource of the rig.

    A thread of its own waits for bytes and keeps the newest plausible position with its arrival
    time. No method but ``start`` and ``stop`` ever waits.

    Args:
        config: Port, protocol, calibration, limits.
        now: Clock in s.
        port: Port to read from; by default the one of the configuration.
    """

    where = "touch screen"
    WAIT = 0.01
    """Longest time in s that the thread waits for bytes before it looks around."""
    REST = 0.003
    """Pause in s after more bytes at once than a screen sends, so that a flood costs little."""

    def __init__(
        self,
        config: LumioConfig,
        now: Callable[[], float] = time.monotonic,
        port: Transport | None = None,
    ) -> None:
        self.config = config
        self.connected = False
        """Whether the port is open."""
        self._now = now
        self._port = port or PORT_CLASSES[config.transport](config.port, config.baud)
        self.stream = TouchStream(config)
        """What is made of the bytes, and counted."""
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()
        self._watching = True
        """Whether a ball that is missing is a fault: not after ``stop``."""

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self) -> None:
        """Open the port and begin to listen.

        Raises:
            ScreenError: The port is absent, not permitted or busy.
        """
        if self._thread is not None:
            return
        self._begin()
        self._stop.clear()
        self._thread = threading.Thread(
            target=ahead(self._listen), name="touch screen", daemon=True
        )
        self._thread.start()

    def _begin(self) -> None:
        """Open the port, take over its description of itself, and forget all earlier data."""
        self.stream = TouchStream(self.config)
        self._port.open()
        try:
            self.stream.begin(self._port.decoder())
        except ScreenError:
            self._port.close()
            raise
        self.connected = self._watching = True

    def stop(self) -> None:
        """Stop listening and close the port; harmless if stopped already."""
        self._watching = False
        if self._thread is not None:
            self._stop.set()
            self._thread.join()
            self._thread = None

    def receive(self) -> None:
        """Nothing: the thread takes in what arrives."""

    def read(self) -> Touch:
        """The newest plausible position; before the first one zeros of infinite age.

        The ball counts as touched until its position is older than ``gate.stale``, lift-off or
        not: that bridges brief dropouts.
        """
        sample, now = self.stream.tracker.sample, self._now()
        if sample is None:
            return Touch(np.zeros((1, 2)), np.array([math.inf]), np.array([False]))
        age = max(0.0, now - sample.time)
        touched = age <= self.config.gate.stale
        return Touch(np.array([sample.position]), np.array([age]), np.array([touched]))

    def note_plate(self, plate: Array) -> None:
        """Take in the measured plate angles (phi, theta), rad, shape (1, 2), once per period.

        Only to notice a frozen touch: no ball rests on a steep plate.
        """
        tilt = float(np.abs(plate).max())
        self.stream.tracker.note_tilt(self._now(), tilt)

    def faults(self) -> tuple[Fault, ...]:
        """Faults detected since the last call, oldest first; ask once per period."""
        if self._watching:
            self.stream.tracker.watch(self._now())
        return tuple(self.stream.faults())

    @property
    def state(self) -> TouchState:
        """Knowledge of the ball now."""
        return self.stream.tracker.state(self._now())

    @property
    def protocol(self) -> str:
        """The protocol spoken; empty until it has been recognised."""
        return self.stream.decoder.name if self.stream.decoder else ""

    @property
    def hint(self) -> str:
        """Advice on missing positions; empty if nothing is known."""
        if self.stream.looks_like:
            return f"the bytes look like {self.stream.looks_like}: set touch.protocol to that"
        if not self.stream.heard:
            return "nothing heard: put the ball on, check the cable and the port"
        unknown = (
            f"{plural(self.stream.heard, 'byte')} heard, of no known protocol: check the baud rate"
        )
        return "" if self.stream.stats.reports else unknown

    def _listen(self) -> None:
        """Read until stopped; a port that was lost is left alone."""
        while not self._stop.is_set():
            if self.listen() > self.stream.MOST:
                self._stop.wait(self.REST)
            elif not self.connected:
                self._stop.wait()
        self._port.close()
        self.connected = False

    def listen(self) -> int:
        """Take in what arrives; the number of bytes. The thread does nothing else."""
        if not self.connected:
            return 0
        try:
            data = self._port.read(self.WAIT)
        except ScreenError as error:
            self.connected = False
            self._port.close()
            self.stream.report_fault(c.UNPLUGGED, str(error).partition(": ")[2])
            return 0
        self.stream.take(self._now(), data)
        return len(data)
