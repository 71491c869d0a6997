"""Rows of numbers handed to another process without ever waiting for it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from multiprocessing.shared_memory import SharedMemory

import numpy as np

from controllers.arrays import Array

_NAMES = 16384
_COUNTERS = 6
_WRITTEN, _DROPPED, _DONE, _NAMED, _OPENED, _TAKEN = range(_COUNTERS)


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
        size = 8 * _COUNTERS + _NAMES + 8 * rows * width
        self._memory = SharedMemory(name, create=name is None, size=size)
        buffer = self._memory.buf
        assert buffer is not None
        self._text = buffer[8 * _COUNTERS : 8 * _COUNTERS + _NAMES]
        self._counters = np.ndarray(_COUNTERS, np.int64, buffer)
        self._rows: Array = np.ndarray((rows, width), float, buffer, 8 * _COUNTERS + _NAMES)
        self._size = rows
        self._read = 0
        self._own = name is None
        if self._own:
            self._counters[:] = 0
        else:
            self._counters[_OPENED] = 1

    @property
    def address(self) -> tuple[int, int, str]:
        """What another process needs to open it."""
        return (*self._rows.shape, self._memory.name)

    def name(self, columns: Sequence[str]) -> None:
        """Name the columns, once, before the first row."""
        text = json.dumps(list(columns)).encode().ljust(_NAMES)
        self._text[:] = text
        self._counters[_NAMED] = len(columns)

    @property
    def columns(self) -> list[str]:
        """Names of the columns; empty until they are known."""
        if not self._counters[_NAMED]:
            return []
        names: list[str] = json.loads(bytes(self._text))
        return names

    def slot(self) -> Array:
        """The row to fill next; it is handed over by ``put``."""
        row: Array = self._rows[int(self._counters[_WRITTEN]) % self._size]
        return row

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

    @property
    def taken(self) -> int:
        """Rows the reader has taken, or missed, so far."""
        return int(self._counters[_TAKEN])

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
