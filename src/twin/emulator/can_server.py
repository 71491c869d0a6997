"""Steps an emulated CAN bus in real time, and passes on what host and drives say."""

from __future__ import annotations

import threading
import time
from typing import Protocol, Self

from twin.devices.timing import LatencyHistogram
from twin.emulator.can_bus import EmulatedBus


class CanPort(Protocol):
    """Where the host's adapter is."""

    def wait(self, seconds: float) -> None:
        """Wait until the host sends something, at most for a time in s."""

    def pump(self) -> None:
        """Pass on what has arrived either way; never waits."""


class BusServer:
    """Pumps a port and steps its bus in real time; a context manager that does so in a thread.

    Time that the computer took away is stepped later in whole steps, at most ``BACKLOG`` of it.

    Args:
        bus: What is emulated.
        port: Where the host is.
        step: Step in s.
    """

    BACKLOG = 0.1
    """Longest lag in s that is made up for."""

    def __init__(self, bus: EmulatedBus, port: CanPort, *, step: float = 0.0005) -> None:
        self.bus = bus
        self.port = port
        self.lock = threading.Lock()
        """Hold it to look at, or meddle with, several things at one time."""
        self.lag = LatencyHistogram()
        """How late the bus's time was at each round: an emulator that starves answers late."""
        self._step = step
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def run(self) -> None:
        """Serve until ``stop`` is called; in the calling thread."""
        stepped = time.monotonic()
        while not self._stop.is_set():
            self.port.wait(max(0.0, stepped + self._step - time.monotonic()))
            with self.lock:
                self.port.pump()
                now = time.monotonic()
                self.lag.add(max(0.0, now - stepped - self._step))
                stepped = max(stepped, now - self.BACKLOG)
                while stepped + self._step <= now:
                    stepped += self._step
                    self.bus.step(self._step)
                self.port.pump()

    def stop(self) -> None:
        """End ``run``, wherever it runs."""
        self._stop.set()

    def __enter__(self) -> Self:
        self._thread = threading.Thread(target=self.run, name="emulated CAN", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        if self._thread is not None:
            self._thread.join()
