"""A pseudo-terminal that stands for a serial port: it has a path, and can be unplugged."""

from __future__ import annotations

import os
import sys
import tempfile
from contextlib import suppress
from pathlib import Path

from twin.errors import RigError


class PseudoTerminal:
    """A port that another program can open, and the end from which it is served.

    Args:
        name: What the port is called, in a temporary folder.

    Raises:
        RigError: This system has no pseudo-terminals.
    """

    def __init__(self, name: str) -> None:
        check_pseudo_terminals()
        self._folder = tempfile.TemporaryDirectory(prefix=f"{name}-")
        self.path = Path(self._folder.name) / name
        """The port to open; stays the same when unplugged and plugged in again."""
        self.handle = self._port = -1
        """File descriptor to read from and write to, which never blocks; -1 while unplugged."""

    def plug(self) -> None:
        """Bring the port up, freshly."""
        import pty  # noqa: PLC0415  not on every system
        import tty  # noqa: PLC0415

        self.unplug()
        self.handle, self._port = pty.openpty()
        tty.setraw(self._port)
        os.set_blocking(self.handle, False)
        self.path.symlink_to(os.ttyname(self._port))

    def unplug(self) -> None:
        """Take the port away, as when the cable is pulled."""
        self.path.unlink(missing_ok=True)
        handles, self.handle, self._port = (self.handle, self._port), -1, -1
        for handle in handles:
            if handle >= 0:
                with suppress(OSError):
                    os.close(handle)

    def close(self) -> None:
        """Take the port away for good."""
        self.unplug()
        self._folder.cleanup()


def check_pseudo_terminals() -> None:
    """Make sure that this system has pseudo-terminals.

    Raises:
        RigError: It has none.
    """
    try:
        import pty  # noqa: F401, PLC0415
        import tty  # noqa: F401, PLC0415
    except ImportError:
        raise RigError(
            f"emulated rig: its ports are pseudo-terminals, which {sys.platform} does not have; "
            "Linux and macOS have them"
        ) from None
