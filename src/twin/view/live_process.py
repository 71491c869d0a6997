"""A run observed from a second process: the loop only leaves rows, and never waits."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from multiprocessing.shared_memory import SharedMemory
from time import monotonic
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array
from twin.base.jobs import is_orphan, let_go, spawn, start_resource_tracker, wait_until
from twin.run.record import Recorder

_NAMES_BYTES = 16384
_COUNTER_COUNT = 7
_WRITTEN, _DROPPED, _DONE, _NAMED, _OPENED, _TAKEN, _PROCESSED = range(_COUNTER_COUNT)


class SharedRingBuffer:
    """Rows in shared memory: one process writes, one reads, neither waits.

    When the reader falls behind by more than the buffer holds, the oldest rows are overwritten; it
    counts them as dropped.

    Args:
        rows: How many rows it holds.
        width: Most columns a row may have.
        name: Name of an existing buffer to read; None makes a new one.
    """

    def __init__(self, rows: int, width: int, name: str | None = None) -> None:
        size = 8 * _COUNTER_COUNT + _NAMES_BYTES + 8 * rows * width
        if name is None:
            start_resource_tracker()
        self._memory = SharedMemory(name, create=name is None, size=size)
        buffer = self._memory.buf
        assert buffer is not None
        self._text = buffer[8 * _COUNTER_COUNT : 8 * _COUNTER_COUNT + _NAMES_BYTES]
        self._counters = np.ndarray(_COUNTER_COUNT, np.int64, buffer)
        self._rows: Array = np.ndarray(
            (rows, width), float, buffer, 8 * _COUNTER_COUNT + _NAMES_BYTES
        )
        self._size = rows
        self._read = 0
        self._own = name is None
        if self._own:
            self._counters[:] = 0
        else:
            self._counters[_OPENED] = 1

    @property
    def address(self) -> tuple[int, int, str]:
        """The values with which a second process opens it."""
        return (*self._rows.shape, self._memory.name)

    def name(self, columns: Sequence[str]) -> None:
        """Name the columns, once, before the first row."""
        text = json.dumps(list(columns)).encode().ljust(_NAMES_BYTES)
        self._text[:] = text
        self._counters[_NAMED] = len(columns)

    @property
    def columns(self) -> list[str]:
        """Names of the columns; empty until they are known."""
        if not self._counters[_NAMED]:
            return []
        return json.loads(bytes(self._text))

    def slot(self) -> Array:
        """The row to fill next; it is handed over by ``put``."""
        return self._rows[int(self._counters[_WRITTEN]) % self._size]

    def put(self) -> None:
        """Hand over the row that was filled."""
        self._counters[_WRITTEN] += 1

    def take(self, most: int | None = None) -> Array:
        """Copies of the rows written since the last call and not overwritten, shape (K, columns).

        Args:
            most: Take at most this many, the oldest; all by default.
        """
        width = int(self._counters[_NAMED])
        end = int(self._counters[_WRITTEN])
        begin = max(self._read, end - self._size + 1)
        if most is not None:
            end = min(end, begin + most)
        rows = self._rows[np.arange(begin, end) % self._size, :width]
        # those the writer has reached meanwhile are torn
        torn = max(0, int(self._counters[_WRITTEN]) - self._size + 1 - begin)
        rows = rows[torn:]
        self._counters[_DROPPED] += end - self._read - len(rows)
        self._read = self._counters[_TAKEN] = end
        return rows

    def blocks(self, every: float, most: int | None = None) -> Iterator[dict[str, Array]]:
        """Column to new values, shape (K,) each, until the writer or its process has ended.

        Nothing while no column is named, and K may be 0.

        Args:
            every: Seconds from one look for new rows to the next.
            most: Rows taken at a time; if there are as many, the next look comes at once.
        """
        while True:
            done = self.done or is_orphan()
            columns = self.columns
            rows = self.take(most) if columns else np.empty((0, 0))
            yield dict(zip(columns, rows.T, strict=True))
            self._counters[_PROCESSED] += len(rows)
            if most is None or len(rows) < most:
                if done:
                    return
                wait_until(lambda: self.done or is_orphan(), every, min(every, 0.05))

    @property
    def taken(self) -> int:
        """Rows the reader has taken, or missed, so far."""
        return int(self._counters[_TAKEN])

    @property
    def written(self) -> int:
        """Rows that were handed over so far."""
        return int(self._counters[_WRITTEN])

    @property
    def processed(self) -> int:
        """Rows of ``blocks`` that the reader has finished with."""
        return int(self._counters[_PROCESSED])

    @property
    def dropped(self) -> int:
        """Rows that were overwritten before they were read."""
        return int(self._counters[_DROPPED])

    @property
    def opened(self) -> bool:
        """Whether the reader has opened it."""
        return bool(self._counters[_OPENED])

    @property
    def done(self) -> bool:
        """Whether the writer has ended."""
        return bool(self._counters[_DONE])

    def finish(self) -> None:
        """Announce that no further row comes."""
        self._counters[_DONE] = 1

    def close(self) -> None:
        """Detach from the memory; the process that made it also frees it."""
        self._text.release()
        del self._counters, self._rows
        self._memory.close()
        if self._own:
            self._memory.unlink()


BUFFER_ROWS = 32768
"""Rows the buffer holds: a minute of a real-time run at 2 ms."""
MAX_COLUMNS = 96
"""Most columns."""
WRITER_START_TIMEOUT_S = 60.0
"""Seconds the process may take to start; a shorter run waits for that at its end."""
PROGRESS_TIMEOUT_S = 5.0
"""Seconds without progress after which, at the end, a view is taken for dead."""
EVIDENCE_PATIENCE = 60.0
"""The same of what writes a record or a trace: a busy computer may stop it for many seconds."""
VIEW_NICENESS = 15
"""Unix niceness of a process that only shows a run."""
EVIDENCE_NICENESS = 5
"""Unix niceness of one that writes a record or a trace. Four busy programs on two processors leave
15 some 2 % of a processor, less than a trace of two drives at 2 ms needs (some 10 %), and 5 some
14 %."""

Address = tuple[int, int, str]


def step_back(niceness: int = VIEW_NICENESS) -> None:
    """Give this process a lower priority and leave Ctrl-C to the run."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "nice"):
        os.nice(niceness)


class LiveProcess:
    """Passes the rows of a run to a second process, which may hang, die or fall behind.

    It costs the loop one copy of a row per period and never makes it wait.

    Args:
        work: Body of the process; is given the buffer's address, then ``arguments``.
        arguments: What else it needs.
        rows: Rows the buffer holds.
        width: Most columns.
    """

    def __init__(
        self,
        work: Callable[..., None],
        arguments: tuple[Any, ...],
        *,
        rows: int = BUFFER_ROWS,
        width: int = 1 + MAX_COLUMNS,
    ) -> None:
        self._ring = SharedRingBuffer(rows, width)
        self._plan: list[tuple[str, int, int]] = []
        self.dropped = 0
        """Rows that the process missed, known after ``finish``."""
        self.written = 0
        """Rows that were handed over to it, likewise."""
        self.missing = 0
        """Rows that it has not finished with, whatever the reason, likewise."""
        self._process = spawn(work, self._ring.address, *arguments)
        self._started = monotonic()

    def take_rows(self, columns: Sequence[str]) -> Callable[[Sequence[float]], None]:
        """Hand over rows of so many columns; returns what takes one of them."""
        ring, count = self._ring, len(columns)
        ring.name(columns)

        def put(row: Sequence[float]) -> None:
            ring.slot()[:count] = row
            ring.put()

        return put

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
        for name, begin, end in self._plan:
            row[begin:end] = channels[name][0]
        self._ring.put()

    def _arrange(self, channels: Mapping[str, NDArray[Any]]) -> None:
        names = ["time"]
        for channel, values in channels.items():
            columns = self._channel(channel).columns
            if values[0].size:
                self._plan.append((channel, len(names), len(names) + len(columns)))
                names += columns
        self._ring.name(names)

    def begun(self) -> bool:
        """Wait until the process has opened the buffer; return whether it has."""
        while (
            not self._ring.opened
            and self.alive
            and monotonic() < self._started + WRITER_START_TIMEOUT_S
        ):
            self._process.join(0.05)
        return self._ring.opened

    @property
    def alive(self) -> bool:
        """Whether the process still runs."""
        return self._process.is_alive()

    def finish(self, wait: float = PROGRESS_TIMEOUT_S) -> bool:
        """Let the process work through the rows left; return whether it has.

        Args:
            wait: Seconds without progress after which it is given up.
        """
        ring = self._ring
        ring.finish()
        self.begun()
        progress = (-1, -1)
        while self.alive and (ring.taken, ring.processed) != progress:
            progress = ring.taken, ring.processed
            self._process.join(wait)
        self.dropped, self.written = ring.dropped, ring.written
        self.missing = ring.written - ring.processed
        return self._process.exitcode == 0

    def close(self) -> None:
        """End the process, whatever it does, and free the memory."""
        let_go(self._process)
        self._ring.close()
