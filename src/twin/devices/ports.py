"""A port is for one program at a time, and why it cannot be opened."""

from __future__ import annotations

import errno
import os

from twin.data_file import packaged


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


def in_words(device: str, number: int, **about: str) -> str | None:
    """What an error of the operating system means, by ``ports.toml``; None if it is not there.

    Args:
        device: ``bus`` or ``screen``.
        number: Of the error.
        about: What its words name.
    """
    known = packaged("twin.devices", "ports.toml")[device].items()
    found = (words for name, words in known if getattr(errno, name, None) == number)
    words = next(found, None)
    return None if words is None else str(words.format(**about))
