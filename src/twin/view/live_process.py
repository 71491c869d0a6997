"""A run observed from another process; the control loop only leaves its rows."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Mapping
from time import monotonic
from typing import Any

from numpy.typing import NDArray

from twin.jobs import let_go, program_left_out, undisturbed
from twin.run.record import Recorder
from twin.view.shared_ring_buffer import SharedRingBuffer

ROWS = 32768
"""Rows the buffer holds: a minute of a real-time run at 2 ms."""
WIDTH = 96
"""Most columns per rig."""
FIRST = 60.0
"""Seconds the process may take to start; a shorter run waits for that at its end."""
LAST = 5.0
"""Seconds without progress after which, at the end, the process is taken for dead."""

Address = tuple[int, int, str]


def step_back() -> None:
    """Give this process the lowest priority and leave Ctrl-C to the run."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "nice"):
        os.nice(15)


class LiveProcess:
    """Hands the rows of a run to another process, which may hang, die or fall behind.

    It costs the loop one copy of a row per period and never makes it wait.

    Args:
        work: Body of the process; is given the buffer's address, then ``arguments``.
        arguments: What else it needs.
        rigs: Which of N rigs are observed.
    """

    def __init__(
        self,
        work: Callable[..., None],
        arguments: tuple[Any, ...],
        rigs: tuple[int, ...] = (0,),
    ) -> None:
        self._ring = SharedRingBuffer(ROWS, 1 + WIDTH * len(rigs))
        self._rigs = rigs
        self._plan: list[tuple[str, int, int, int]] = []
        self.dropped = 0
        """Rows that the process missed, known after ``finish``."""
        context = multiprocessing.get_context("spawn")
        self._process = context.Process(
            target=work, args=(self._ring.address, *arguments), daemon=True
        )
        with undisturbed(), program_left_out():
            self._process.start()
        self._started = monotonic()

    def watch(self, recorder: Recorder) -> None:
        """Observe a run that is about to begin."""
        self._channel = recorder.channel
        recorder.observers.append(self.observe)

    def observe(self, time: float, channels: Mapping[str, NDArray[Any]]) -> None:
        """Hand over the channels, shape (N, ...) each, of the control period begun at ``time``."""
        if not self._plan:
            self._arrange(channels)
        row = self._ring.slot()
        row[0] = time
        for name, rig, begin, end in self._plan:
            row[begin:end] = channels[name][rig]
        self._ring.put()

    def _arrange(self, channels: Mapping[str, NDArray[Any]]) -> None:
        names = ["time"]
        for rig in self._rigs:
            for channel, values in channels.items():
                columns = self._channel(channel).columns
                if values[rig].size:
                    self._plan.append((channel, rig, len(names), len(names) + len(columns)))
                    names += columns
        self._ring.name(names)

    def begun(self) -> bool:
        """Wait until the process has opened the buffer; return whether it has."""
        while not self._ring.opened and self.alive and monotonic() < self._started + FIRST:
            self._process.join(0.05)
        return self._ring.opened

    @property
    def alive(self) -> bool:
        """Whether the process still runs."""
        return self._process.is_alive()

    @property
    def failed(self) -> bool:
        """Whether the process ended by itself with an error."""
        return self._process.exitcode not in (None, 0)

    def finish(self, wait: float = LAST) -> bool:
        """Let the process work through the rows left; return whether it has.

        Args:
            wait: Seconds without progress after which it is given up.
        """
        self._ring.finish()
        self.begun()
        taken = -1
        while self.alive and self._ring.taken != taken:
            taken = self._ring.taken
            self._process.join(wait)
        self.dropped = self._ring.dropped
        return self._process.exitcode == 0

    def close(self) -> None:
        """End the process, whatever it does, and free the memory."""
        let_go(self._process)
        self._ring.close()
