"""A port is for one program at a time."""

from __future__ import annotations

import errno
import os


def claim(path: str, flags: int) -> int:
    """Open a port so that other programs which ask for a lock are refused; its descriptor.

    Args:
        path: Path of the device.
        flags: How to open it, as ``os.O_RDWR``; reading and writing never wait.

    Raises:
        ImportError: This is no POSIX system.
        OSError: It cannot be opened, or another program has claimed it.
    """
    import fcntl  # noqa: PLC0415  POSIX only

    handle = os.open(path, flags | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(handle)
        raise OSError(errno.EBUSY, "port is locked") from error
    return handle
