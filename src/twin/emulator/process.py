"""The virtual rig in a process of its own, before every ordinary one."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Iterator, MutableSequence
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection

from twin.emulator.can_slcan import check_pseudo_terminals
from twin.emulator.serve import BEGIN, VirtualRig
from twin.errors import RigError
from twin.jobs import let_go, program_left_out, undisturbed
from twin.scenario.load import Tables
from twin.scenario.schema import Scenario

PRIORITY = 70
"""Of SCHED_FIFO: before every ordinary process, after the host's loop (80)."""
ENDED = "emulated rig: its process has ended; was it killed?"
START = 60.0
"""Longest time in s that the process may take to start."""


class PauseWatch:
    """What two processes in real time know of one another, to tell when their computer paused.

    One that does not come round may have computed for long. Where the other did not come round
    either, the computer had no time for both.

    Args:
        cells: Six numbers that both share.
        side: 0 or 1.
    """

    LONG = 0.004
    """Time in s without coming round that may be a pause."""

    def __init__(self, cells: MutableSequence[float], side: int) -> None:
        self._cells, self._own, self._other = cells, 3 * side, 3 - 3 * side

    def paused(self, begin: float, end: float) -> float:
        """How long, s, neither loop came round; 0 where one's own did within ``LONG``.

        Args:
            begin: When one's own loop came round last, s.
            end: Now, s.
        """
        cells, own = self._cells, self._own
        cells[own] = end
        if end - begin <= self.LONG:
            return 0.0
        cells[own + 1], cells[own + 2] = begin, end
        seen, since, until = (cells[self._other + each] for each in range(3))
        if end - seen <= self.LONG:  # the other goes on already, and has said what it missed
            return max(0.0, min(end, until) - max(begin, since))
        return end - max(begin, seen) if seen else 0.0


@contextmanager
def _apart(process: int) -> Iterator[None]:
    """Meanwhile, keep a process and this one on different processors, where that is possible."""
    allowed = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
    if len(allowed) < 2:
        yield
        return
    own = max(allowed)
    os.sched_setaffinity(process, {own})
    os.sched_setaffinity(0, allowed - {own})
    try:
        yield
    finally:
        os.sched_setaffinity(0, allowed)


def come_forward() -> None:
    """Raise this process's priority where that is permitted: real devices need no processor.

    Its later threads have it, too. Otherwise a busy machine would let the emulated drives answer
    late, which looks like an overloaded host.
    """
    if sys.platform == "linux":
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
            return
    with suppress(OSError, AttributeError):
        os.nice(-10)


def _work(pipe: Connection, scenario: Scenario, cells: MutableSequence[float]) -> None:
    """The body of the process: serve until the pipe is closed, obeying what comes through it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the host
    come_forward()
    with VirtualRig(scenario) as rig:
        try:
            pipe.send(rig.tables())
        except OSError:
            return  # the host has ended meanwhile
        listener = threading.Thread(target=_listen, args=(pipe, rig), daemon=True)
        listener.start()
        rig.server.paused = PauseWatch(cells, 1).paused
        rig.server.run()


def _listen(pipe: Connection, rig: VirtualRig) -> None:
    """Obey what comes through the pipe until its other end is closed."""
    while True:
        try:
            word = pipe.recv()
            answer = rig.obey(word)
            if word != BEGIN:
                pipe.send(answer)
        except (EOFError, OSError):
            rig.server.stop()
            return


class Emulator:
    """A virtual rig in another process.

    Args:
        pipe: The way to it.
        tables: The rig file that a host needs.
        pauses: Tells when the computer paused.
    """

    def __init__(self, pipe: Connection, tables: Tables, pauses: PauseWatch) -> None:
        self._pipe, self.tables, self.pauses = pipe, tables, pauses

    def tell(self, word: str) -> str:
        """Do something to the rig, as ``VirtualRig.obey`` says; what was done.

        Raises:
            RigError: Its process has ended.
        """
        try:
            self._pipe.send(word)
            return str(self._pipe.recv())
        except (EOFError, OSError) as error:
            raise RigError(ENDED) from error

    def lag(self) -> str:
        """How far it lagged behind real time, or that it has ended, in words."""
        try:
            return self.tell("lag")
        except RigError as error:
            return str(error)

    def begin(self) -> None:
        """Say that the run's time is zero now; waits for nothing."""
        with suppress(OSError):  # a rig that has ended shows in its devices
            self._pipe.send(BEGIN)


@contextmanager
def emulated(scenario: Scenario) -> Iterator[Emulator]:
    """A virtual rig in a separate process, for as long as the context lasts.

    Raises:
        RigError: It does not start, or this system has no pseudo-terminals.
    """
    check_pseudo_terminals()
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    cells = context.RawArray("d", 6)
    process = context.Process(target=_work, args=(theirs, scenario, cells), daemon=True)
    with undisturbed(), program_left_out():
        process.start()
    theirs.close()
    try:
        with _apart(process.pid or 0):
            yield Emulator(ours, _rig_file(ours), PauseWatch(cells, 0))
    finally:
        ours.close()
        process.join(2.0)
        let_go(process)


def _rig_file(pipe: Connection) -> Tables:
    """What the process sends when it serves.

    Raises:
        RigError: It has ended, or takes too long.
    """
    with suppress(EOFError):
        if pipe.poll(START):
            tables: Tables = pipe.recv()
            return tables
    raise RigError("emulated rig: its process did not start; run ballplate emulate to see why")
