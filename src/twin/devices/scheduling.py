"""What the operating system does for a real-time loop: priority, locked memory, no collector.

A processor that sleeps between two periods begins the next one late and with cold caches; Linux
keeps all of them awake while a program holds its request for a latency of zero open.
"""

from __future__ import annotations

import gc
import os
import struct
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Any, NamedTuple

PRIORITY = 80
SWITCH = 2e-4
"""Longest time in s that another Python thread keeps the loop's from running."""
_MCL_CURRENT, _MCL_FUTURE = 1, 2
_LATENCY = "/dev/cpu_dma_latency"


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

    The garbage collector is off, and existing objects are moved to its permanent generation.
    Threads started meanwhile stay ordinary ones. An operating system other than Linux
    grants neither priority nor locked memory, which is no error.

    Args:
        priority: Of SCHED_FIFO, 1..99.
    """
    collecting, switch = gc.isenabled(), sys.getswitchinterval()
    with ExitStack() as undo:
        fifo = _prioritise(priority, undo)
        locked = _lock(undo)
        awake = _keep_awake(undo)
        gc.collect()
        gc.freeze()
        gc.disable()
        sys.setswitchinterval(SWITCH)
        try:
            words = _words(fifo, locked, priority)
            yield Scheduling(fifo, locked, (*words, "processors kept awake") if awake else words)
        finally:
            sys.setswitchinterval(switch)
            gc.unfreeze()
            if collecting:
                gc.enable()


def _prioritise(priority: int, undo: ExitStack) -> bool:
    if sys.platform != "linux":
        return False
    before, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        _come_first(priority)
    except OSError:
        return False
    undo.callback(os.sched_setscheduler, 0, before, parameter)
    return True


def _come_first(priority: int) -> None:
    # Reset on fork: threads and processes begun from this thread do not inherit the priority.
    os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))


def ahead(work: Callable[[], None]) -> Callable[[], None]:
    """The same work, for a thread that must not wait for the calling real-time loop.

    Short work only: where the calling thread has a real-time priority, this one's is just above it.
    """
    if sys.platform != "linux" or not os.sched_getparam(0).sched_priority:
        return work
    priority = os.sched_getparam(0).sched_priority + 1

    def first() -> None:
        _come_first(priority)
        work()

    return first


def _lock(undo: ExitStack) -> bool:
    if sys.platform != "linux":
        return False  # other systems have other flags
    import ctypes  # noqa: PLC0415  # only a real-time run needs it

    library = ctypes.CDLL(None, use_errno=True)
    if library.mlockall(_MCL_CURRENT | _MCL_FUTURE) != 0:
        return False
    undo.callback(library.munlockall)
    return True


def _keep_awake(undo: ExitStack) -> bool:
    with suppress(OSError):
        request = os.open(_LATENCY, os.O_WRONLY)
        undo.callback(os.close, request)
        return os.write(request, struct.pack("i", 0)) > 0
    return False


def _words(fifo: bool, locked: bool, priority: int) -> tuple[str, ...]:
    advice = "add '{}' for the user to /etc/security/limits.conf"
    if sys.platform != "linux":
        advice = "only Linux grants it"
    return (
        f"real-time priority {priority} (SCHED_FIFO)"
        if fifo
        else "no real-time priority: " + advice.format("rtprio 99"),
        "memory locked" if locked else "memory not locked: " + advice.format("memlock unlimited"),
        "garbage collector off",
    )
