"""An emulated Lumio screen: what it sends and when, and the port on which it does so."""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Self

from twin.devices.lumio.calibration import Calibration
from twin.emulator.pseudo_terminal import PseudoTerminal
from twin.emulator.screen_bytes import ENCODERS, Protocol, Spot
from twin.emulator.screen_faults import Damage, ScreenFault

FRAME = 0.01736
"""Seconds between frames, as recorded from a screen of product 202E:0006."""
DEAD_TIME = 0.042
"""Seconds from a touch to its arrival, as the thesis measured."""
SPLIT_GAP = 0.003
"""Seconds between the parts of a packet that is split on purpose."""


class ScreenLine:
    """Looks at the ball once per frame and sends what a screen would, a dead time later.

    It has neither port nor thread: ``step`` says what is due.

    Args:
        ball: What touches the screen now, m in plate axes, empty for nothing; called once per
            frame.
        protocol: What it speaks.
        baud: Bits per second of a serial protocol, ten bits per byte.
        frame: Seconds between frames.
        dead_time: Seconds from looking to arrival, or what tells them at each look.
        calibration: How it is mounted: plate to screen units.
        seed: Of everything random in the faults injected.
    """

    TICK = 0.003
    """Shortest time in s between two portions of a packet."""

    def __init__(
        self,
        ball: Callable[[], Sequence[tuple[float, float]]],
        *,
        protocol: Protocol = Protocol.MICROTOUCH,
        baud: int = 9600,
        frame: float = FRAME,
        dead_time: float | Callable[[], float] = DEAD_TIME,
        calibration: Calibration | None = None,
        seed: int = 0,
    ) -> None:
        self.damage = Damage(protocol, seed)
        self.due = 0.0
        """When there is something to do next, s."""
        self._ball = ball
        self.protocol = protocol
        self._byte = 10 / baud if protocol in {Protocol.MICROTOUCH, Protocol.ELO} else 0.0
        self._baud = baud
        self._frame = frame
        self._dead_time = dead_time if callable(dead_time) else lambda: dead_time
        self._calibration = calibration or Calibration.nominal()
        self._next: float | None = None
        self._queue: deque[tuple[float, bytes]] = deque()
        self._free = 0.0
        self._down: tuple[Spot, ...] = ()

    def step(self, now: float) -> list[bytes]:
        """Look if a frame is due; the portions of bytes that are due by now, in order."""
        frame = now if self._next is None else self._next
        if now >= frame:
            self._look(now)
            frame += self._frame * max(1, int((now - frame) / self._frame))
        self._next = frame
        sent = []
        while self._queue and self._queue[0][0] <= now:
            sent.append(self._queue.popleft()[1])
        self.due = min(frame, self._queue[0][0]) if self._queue else frame
        return sent

    def _look(self, now: float) -> None:
        """Take a frame and schedule what it makes the screen send."""
        shares = (self._calibration.screen(*place) for place in self._ball())
        seen = [
            Spot(x, y, name)
            for name, (x, y) in enumerate(shares, start=1)
            if 0 <= x <= 1 and 0 <= y <= 1
        ]
        arrival = now + self._dead_time()
        spots = self.damage.contacts(now, seen)
        lifted = () if self.damage.hides_lift(now) else self._lifted(spots)
        self._down = spots
        for packet in ENCODERS[self.protocol]((*spots, *lifted)):
            for number, part in enumerate(self.damage.packet(now, packet)):
                self._schedule(arrival + number * SPLIT_GAP, part)
        if self.damage.active(ScreenFault.FLOOD, now):
            rate = self._baud / 10 if self._byte else 100_000
            self._schedule(arrival, self.damage.noise(int(self._frame * rate)))

    def _lifted(self, spots: Sequence[Spot]) -> tuple[Spot, ...]:
        """One last report of every contact that touched in the last frame and no longer does."""
        names = {spot.id for spot in spots}
        return tuple(spot._replace(down=False) for spot in self._down if spot.id not in names)

    def _schedule(self, arrival: float, packet: bytes) -> None:
        """Queue a packet so that its last byte arrives at a time, the line permitting."""
        begin = max(self._free, arrival - len(packet) * self._byte)
        step = max(1, int(self.TICK / self._byte)) if self._byte else len(packet)
        for at in range(0, len(packet), step):
            part = packet[at : at + step]
            self._queue.append((begin + (at + len(part)) * self._byte, part))
        self._free = begin + len(packet) * self._byte


class EmulatedScreen:
    """A screen on a pseudo-terminal, served by a thread; a context manager.

    A pseudo-terminal knows no baud rate: the bytes of the serial protocols are sent at their pace
    here, so that the last byte of a packet arrives a dead time after the look. HID reports go in
    one piece. A reader that does not read loses the newest bytes, as on a real line.

    Args:
        line: What is sent and when; it asks for the ball in the screen's thread.
        now: Clock in s.

    Raises:
        RigError: This system has no pseudo-terminals.
    """

    def __init__(self, line: ScreenLine, now: Callable[[], float] = time.monotonic) -> None:
        self.protocol = line.protocol
        self.sent = 0
        """Bytes sent."""
        self.dropped = 0
        """Bytes lost because nobody read or nothing was plugged in."""
        self._now = now
        self._line = line
        self._lock = threading.Lock()
        self._terminal = PseudoTerminal("lumio")
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def path(self) -> Path:
        """The port to open; stays the same when unplugged and plugged in again."""
        return self._terminal.path

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self) -> None:
        """Plug it in and begin to send."""
        self.replug()
        self._stop.clear()
        self._thread = threading.Thread(target=self._run, name="emulated screen", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop sending and take the port away; it cannot be started again."""
        if self._thread is not None:
            self._stop.set()
            self._thread.join()
            self._thread = None
        with self._lock:
            self._terminal.close()

    def unplug(self) -> None:
        """Take the port away, as when the cable is pulled."""
        with self._lock:
            self._terminal.unplug()

    def replug(self) -> None:
        """Bring the port back under the same path."""
        with self._lock:
            self._terminal.plug()

    def inject(self, fault: ScreenFault, lasting: float) -> None:
        """Put a fault in force from now on, for a time in s."""
        self._line.damage.inject(fault, self._now() + lasting)

    def _run(self) -> None:
        """Send what is due, when it is due."""
        while not self._stop.is_set():
            for part in self._line.step(self._now()):
                self._send(part)
            self._stop.wait(max(0.0, self._line.due - self._now()))

    def _send(self, part: bytes) -> None:
        with self._lock:
            try:
                plugged = self._terminal.handle >= 0
                written = os.write(self._terminal.handle, part) if plugged else 0
            except OSError:
                written = 0
        self.sent += written
        self.dropped += len(part) - written
