"""What carries out the generations of a search: processes that stay, or those of a cluster."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager

from twin.jobs import cores
from twin.study.cluster import Cluster


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


@contextmanager
def executors(
    processes: int | None, scheduler: str | None = None
) -> Iterator[tuple[Executor | None, int]]:
    """The executor that was asked for, and how many runs it carries out side by side.

    Args:
        processes: How many; None for the cores there are, or all workers of the scheduler.
        scheduler: Address of a Dask scheduler; None for processes of this machine.

    Raises:
        ScenarioError: If no scheduler answers there.
    """
    if scheduler is None:
        count = processes or cores()
        with workers(count) as executor:
            yield executor, count
    else:
        with Cluster(scheduler) as cluster:
            yield cluster, processes or cluster.workers
