"""What the operating system can do for a real-time loop: priority, locked memory, no collector."""

from __future__ import annotations

import ctypes
import gc
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

PRIORITY = 80
SWITCH = 2e-4
"""Longest time in s that another Python thread keeps the loop's from running."""
_MCL_CURRENT, _MCL_FUTURE = 1, 2


class Scheduling(NamedTuple):
    """What was obtained.

    Attributes:
        fifo: Whether the loop's thread runs before all ordinary ones (SCHED_FIFO).
        locked: Whether no page of the process can be swapped out.
        words: The same in words, with what to do where it was refused.
    """

    fifo: bool
    locked: bool
    words: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """For the record of a run."""
        return {"fifo": self.fifo, "locked": self.locked, "words": list(self.words)}


@contextmanager
def real_time(priority: int = PRIORITY) -> Iterator[Scheduling]:
    """Run the calling thread as a real-time loop needs it; all is undone on leaving.

    The garbage collector is off, with everything that exists frozen out of its sight. Threads
    started meanwhile stay ordinary ones.

    Args:
        priority: Of SCHED_FIFO, 1..99.
    """
    policy, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
    collecting, switch = gc.isenabled(), sys.getswitchinterval()
    fifo = _prioritise(priority)
    locked = _lock()
    gc.collect()
    gc.freeze()
    gc.disable()
    sys.setswitchinterval(SWITCH)
    try:
        yield Scheduling(fifo, locked, _words(fifo, locked, priority))
    finally:
        sys.setswitchinterval(switch)
        gc.unfreeze()
        if collecting:
            gc.enable()
        if locked:
            ctypes.CDLL(None).munlockall()
        if fifo:
            os.sched_setscheduler(0, policy, parameter)


def _prioritise(priority: int) -> bool:
    # Reset on fork: threads and processes begun from this thread do not inherit the priority.
    policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    try:
        os.sched_setscheduler(0, policy, os.sched_param(priority))
    except OSError:
        return False
    return True


def _lock() -> bool:
    library = ctypes.CDLL(None, use_errno=True)
    return bool(library.mlockall(_MCL_CURRENT | _MCL_FUTURE) == 0)


def _words(fifo: bool, locked: bool, priority: int) -> tuple[str, ...]:
    return (
        f"real-time priority {priority} (SCHED_FIFO)"
        if fifo
        else "no real-time priority: add 'rtprio 99' for the user to /etc/security/limits.conf",
        "memory locked"
        if locked
        else "memory not locked: add 'memlock unlimited' for the user to /etc/security/limits.conf",
        "garbage collector off",
    )
