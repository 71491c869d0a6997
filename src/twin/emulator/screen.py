"""An emulated Lumio screen: a pty that carries the bytes of one, at the pace of one."""

from __future__ import annotations

import os
import pty
import tempfile
import threading
import time
import tty
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self

from twin.emulator.screen_faults import ScreenFault
from twin.emulator.screen_line import ScreenLine


class EmulatedScreen:
    """Looks at the ball once a frame and sends what a Lumio screen would, a dead time later.

    A pty knows no baud rate: the bytes of the serial protocols are sent at their pace here, so
    that the last byte of a packet arrives a dead time after the look. HID reports go in one piece.
    A reader that does not read loses the newest bytes, as on a real line.

    Args:
        line: What is sent and when; its ball is looked at in the thread of the screen.
        now: Clock in s.
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
        self._folder = tempfile.TemporaryDirectory(prefix="screen-")
        self.path = Path(self._folder.name) / "lumio"
        """The port to open; stays the same when unplugged and plugged in again."""
        self._master = self._slave = -1
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
                written = os.write(self._master, part) if self._master >= 0 else 0
            except OSError:
                written = 0
        self.sent += written
        self.dropped += len(part) - written
