"""An emulated screen on a pseudo-terminal of its own, served by a thread."""

import threading
import time

from twin.emulator.can_bus import PseudoTerminal


class EmulatedScreen(PseudoTerminal):
    """A context manager; sends what a line says when it is due."""

    def __init__(self, line):
        super().__init__("lumio")
        self.protocol = line.protocol
        self.line = line
        self._stop, self._lock = threading.Event(), threading.RLock()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self):
        self.plug()
        self._thread.start()
        return self

    def plug(self):
        with self._lock:
            super().plug()

    def unplug(self):
        with self._lock:
            super().unplug()

    def write(self, data):
        with self._lock:
            return super().write(data)

    def close(self):
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        super().close()

    def _run(self):
        while not self._stop.is_set():
            for part in self.line.step(time.monotonic()):
                self.write(part)
            self._stop.wait(0.001)
