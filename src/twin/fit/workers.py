"""Processes that stay for all generations of a fit."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager


@contextmanager
def workers(processes: int) -> Iterator[Executor | None]:
    """So many processes as an executor; None for one, which is this."""
    if processes == 1:
        yield None
        return
    context = multiprocessing.get_context("spawn")
    # Ctrl-C reaches every process of the terminal: only this one answers it
    pool = ProcessPoolExecutor(
        processes, context, initializer=signal.signal, initargs=(signal.SIGINT, signal.SIG_IGN)
    )
    before = set(multiprocessing.active_children())
    try:
        yield pool
        pool.shutdown()
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        for child in set(multiprocessing.active_children()) - before:
            child.terminate()
