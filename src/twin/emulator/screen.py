"""An emulated Lumio screen: a pty that carries the bytes of one, at the pace of one."""

from __future__ import annotations

import os
import pty
import tempfile
import threading
import time
import tty
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self

from twin.emulator.screen_bytes import ENCODERS, Protocol, Spot
from twin.emulator.screen_faults import Damage, ScreenFault
from twin.hal.lumio.calibration import Calibration

Ball = Callable[[], Sequence[tuple[float, float]]]

FRAME = 0.01736
"""Seconds between frames, as recorded from a screen of product 202E:0006."""
DEAD_TIME = 0.042
"""Seconds from a touch to its arrival, as the thesis measured."""
SPLIT_GAP = 0.003
"""Seconds between the parts of a packet that is split on purpose."""


class EmulatedScreen:
    """Looks at the ball once a frame and sends what a Lumio screen would, a dead time later.

    A pty knows no baud rate: the bytes of the serial protocols are sent at their pace here, so
    that the last byte of a packet arrives a dead time after the look. HID reports go in one piece.
    A reader that does not read loses the newest bytes, as on a real line.

    Args:
        ball: What touches the screen now, m in plate axes, empty for nothing; called in the
            thread of the screen, once a frame.
        protocol: What it speaks.
        baud: Bits a second of a serial protocol, ten bits a byte.
        frame: Seconds between frames.
        dead_time: Seconds from looking to arrival.
        calibration: How it is mounted: plate to screen units.
        seed: Of everything random in the faults injected.
        now: Clock in s.
    """

    TICK = 0.001
    """Shortest time in s between two portions of a packet."""

    def __init__(
        self,
        ball: Ball,
        *,
        protocol: Protocol = Protocol.MICROTOUCH,
        baud: int = 9600,
        frame: float = FRAME,
        dead_time: float = DEAD_TIME,
        calibration: Calibration | None = None,
        seed: int = 0,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self.protocol = protocol
        self.sent = 0
        """Bytes sent."""
        self.dropped = 0
        """Bytes lost because nobody read or nothing was plugged in."""
        self._ball = ball
        self._byte = 10 / baud if protocol in {Protocol.MICROTOUCH, Protocol.ELO} else 0.0
        self._baud = baud
        self._frame = frame
        self._dead_time = dead_time
        self._calibration = calibration or Calibration.nominal()
        self._now = now
        self._damage = Damage(protocol, seed)
        self._lock = threading.Lock()
        self._folder = tempfile.TemporaryDirectory(prefix="screen-")
        self.path = Path(self._folder.name) / "lumio"
        """The port to open; stays the same when unplugged and plugged in again."""
        self._master = self._slave = -1
        self._queue: deque[tuple[float, bytes]] = deque()
        self._free = 0.0
        self._down: tuple[Spot, ...] = ()
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
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
        self.unplug()
        self._folder.cleanup()

    def unplug(self) -> None:
        """Take the port away, as when the cable is pulled."""
        with self._lock, suppress(OSError):
            self.path.unlink(missing_ok=True)
            for handle in (self._master, self._slave):
                if handle >= 0:
                    os.close(handle)
            self._master = self._slave = -1

    def replug(self) -> None:
        """Bring the port back under the same path."""
        self.unplug()
        with self._lock:
            self._master, self._slave = pty.openpty()
            tty.setraw(self._slave)
            os.set_blocking(self._master, False)
            self.path.symlink_to(os.ttyname(self._slave))

    def inject(self, fault: ScreenFault, lasting: float) -> None:
        """Put a fault in force from now on, for a time in s."""
        self._damage.inject(fault, self._now() + lasting)

    def _run(self) -> None:
        """Frames and bytes by absolute times; what is overdue is done at once, in order."""
        frame = self._now()
        while not self._stop.is_set():
            now = self._now()
            if now >= frame:
                self._look(now)
                frame += self._frame * max(1, int((now - frame) / self._frame))
            while self._queue and self._queue[0][0] <= now:
                self._send(self._queue.popleft()[1])
            due = min(frame, self._queue[0][0]) if self._queue else frame
            self._stop.wait(max(0.0, due - self._now()))

    def _look(self, now: float) -> None:
        """Take a frame and schedule what it makes the screen send."""
        shares = (self._calibration.screen(*place) for place in self._ball())
        seen = [
            Spot(x, y, name)
            for name, (x, y) in enumerate(shares, start=1)
            if 0 <= x <= 1 and 0 <= y <= 1
        ]
        spots = self._damage.contacts(now, seen)
        lifted = () if self._damage.hides_lift(now) else self._lifted(spots)
        self._down = spots
        for packet in ENCODERS[self.protocol]((*spots, *lifted)):
            for number, part in enumerate(self._damage.packet(now, packet)):
                self._schedule(now + self._dead_time + number * SPLIT_GAP, part)
        if self._damage.active(ScreenFault.FLOOD, now):
            rate = self._baud / 10 if self._byte else 100_000
            self._schedule(now + self._dead_time, self._damage.noise(int(self._frame * rate)))

    def _lifted(self, spots: Sequence[Spot]) -> tuple[Spot, ...]:
        """One last report of every contact that touched a frame ago and does no more."""
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

    def _send(self, part: bytes) -> None:
        with self._lock:
            try:
                written = os.write(self._master, part) if self._master >= 0 else 0
            except OSError:
                written = 0
        self.sent += written
        self.dropped += len(part) - written
