"""The Lumio touch screen as a device of the rig: read by a thread, asked by the control loop."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import Self

import numpy as np

from controllers.arrays import Array
from twin.devices.lumio.conditions import UNPLUGGED
from twin.devices.lumio.config import LumioConfig
from twin.devices.lumio.stream import TouchState, TouchStream
from twin.devices.lumio.transports import TRANSPORTS, ScreenError, Transport
from twin.devices.scheduling import ahead
from twin.hal.interface import Fault, Touch


class LumioScreen:
    """A touch screen with one ball on it; a TouchScreen and FaultSource of the rig.

    A thread of its own waits for bytes and keeps the newest plausible position with its arrival
    time. No method but ``start`` and ``stop`` ever waits.

    Args:
        config: Port, protocol, calibration, limits.
        now: Clock in s.
        port: What to read from; that of the configuration by default.
    """

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
        self._port = port or TRANSPORTS[config.transport](config.port, config.baud)
        self.stream = TouchStream(config)
        """What is made of the bytes, and counted."""
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()

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
        """Open the port, take over what it says of itself, and know nothing of what was before."""
        self.stream.forget()
        self._port.open()
        try:
            self.stream.begin(self._port.decoder())
        except ScreenError:
            self._port.close()
            raise
        self.connected = True

    def stop(self) -> None:
        """Stop listening and close the port; harmless if stopped already."""
        if self._thread is not None:
            self._stop.set()
            self._thread.join()
            self._thread = None

    def read(self) -> Touch:
        """The newest plausible position; before the first one zeros of infinite age.

        The ball counts as touched until its position is older than ``gate.stale``, lift-off or
        not: that bridges brief dropouts.
        """
        sample, now = self.stream.sample, self._now()
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
        """What has been detected since the last call, oldest first; ask once per period."""
        self.stream.tracker.watch(self._now())
        return tuple(self.stream.faults())

    @property
    def state(self) -> TouchState:
        """What is known of the ball now."""
        return self.stream.tracker.state(self._now())

    @property
    def protocol(self) -> str:
        """The protocol spoken; empty until it has been recognised."""
        return self.stream.decoder.name if self.stream.decoder else ""

    @property
    def hint(self) -> str:
        """What to change if there is no position; empty if nothing is known."""
        if self.stream.looks_like:
            return f"the bytes look like {self.stream.looks_like}: set touch.protocol to that"
        heard = self.stream.stats.bytes
        if not heard:
            return "nothing heard: put the ball on, check the cable and the port"
        if self.stream.stats.reports:
            return ""
        wanted = "known" if self.config.protocol == "auto" else f"{self.config.protocol} nor other"
        return f"{heard} bytes heard, of no {wanted} protocol: check the baud rate"

    def _listen(self) -> None:
        """Read until stopped; a port that has gone is left alone."""
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
            self.stream.report_fault(UNPLUGGED, str(error).partition(": ")[2])
            return 0
        self.stream.take(self._now(), data)
        return len(data)
